"""Random decision processes with rational probabilities, end components, traps and goals, for tests of verification."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models import MDP, POMDP

if TYPE_CHECKING:
    Rows = list[list[dict[int, Fraction]]]

_PARTS = 64


def random_rows(random: np.random.Generator, size: int, actions: int) -> Rows:
    """Return for each state and action the probabilities of the states that follow; many actions stay or go back."""
    rows: Rows = []
    for state in range(size):
        choices = []
        stuck = random.random() < 0.15
        for _ in range(actions):
            count = int(random.integers(1, 4))
            reach = [state] if stuck else random.integers(0, size, count).tolist()
            if random.random() < 0.3:
                reach.append(state)
            cuts = sorted(random.integers(0, _PARTS + 1, len(reach) - 1).tolist())
            chances: dict[int, Fraction] = {}
            for after, low, high in zip(reach, [0, *cuts], [*cuts, _PARTS], strict=True):
                if high > low:
                    chances[after] = chances.get(after, Fraction(0)) + Fraction(high - low, _PARTS)
            choices.append(chances)
        rows.append(choices)
    return rows


def model_of_rows(rows: Rows, seen: list[int] | None = None) -> MDP:
    """Return the model, which begins in state 0; its states are ``s0``, ``s1`` and so on.

    Args:
        rows: As of `random_rows`.
        seen: The observation in each state, of a POMDP.
    """
    size, actions = len(rows), len(rows[0])
    transitions = np.zeros((actions, size, size))
    for state, choices in enumerate(rows):
        for action, chances in enumerate(choices):
            for after, chance in chances.items():
                transitions[action, state, after] = float(chance)
    options: Any = {
        "discount": 0.9,
        "states": [f"s{state}" for state in range(size)],
        "actions": [f"a{action}" for action in range(actions)],
        "initial_belief": np.eye(size)[0],
    }
    if seen is None:
        return MDP(transitions, np.zeros((size, actions)), **options)
    told = np.eye(2)[seen]
    return POMDP(transitions, np.stack([told] * actions), np.zeros((size, actions)), **options)


def under(rows: Rows, actions: list[int]) -> Rows:
    """Return the chain of some actions, as a process of one choice a state."""
    return [[choices[action]] for choices, action in zip(rows, actions, strict=True)]
