"""Texts with pieces lost, moved, doubled or replaced."""

from __future__ import annotations


def mutated(text, chance, pieces, most=4):
    """Return a text after some mutations.

    Args:
        text: The text.
        chance: A `random.Random`.
        pieces: What may be put in.
        most: How many mutations there may be.
    """
    for _ in range(chance.randint(1, most)):
        begin = chance.randrange(len(text) + 1)
        end = min(len(text), begin + chance.choice([0, 1, 5, 30]))
        lost, doubled, replaced = (
            text[:begin] + text[end:],
            text[:end] + text[begin:],
            text[:begin] + chance.choice(pieces),
        )
        text = chance.choice([lost, doubled, replaced + text[end:]])
    return text
