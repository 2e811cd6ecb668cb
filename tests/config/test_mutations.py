"""Mutated configuration files: each is loaded, or refused with an error of the library."""

from __future__ import annotations

import random

import pytest
from loading import written
from mutation import mutated
from robot_file import GOOD

from mdm import Error, load_system

PIECES = [*"[]{}='\".\n", "1e999", "nan", "-1", "0", "é", "true", "A", "Up", "below", "Rest"]


def spoilt(chance):
    """Return the file with lines swapped, repeated or left out, or with pieces put in and characters changed."""
    lines = GOOD.splitlines(keepends=True)
    if chance.random() < 0.5:
        for _ in range(chance.randint(1, 4)):
            first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
            how = chance.choice(["swap", "repeat", "leave out"])
            if how == "swap":
                lines[first], lines[second] = lines[second], lines[first]
            elif how == "repeat":
                lines.insert(first, lines[second])
            else:
                del lines[first]
        return "".join(lines)
    return mutated(GOOD, chance, PIECES)


@pytest.mark.parametrize("seed", range(4))
def test_every_mutation_is_loaded_or_refused_in_words(folder, seed):
    chance = random.Random(seed)
    for _ in range(30):
        path = written(folder, spoilt(chance), "robot.toml")
        try:
            load_system(path, callbacks=chance.random() < 0.5)
        except Error as error:
            assert str(error).startswith(str(path))
