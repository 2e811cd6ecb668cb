"""What a strict reader finds in a model's file, and whether these are the numbers of a model."""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


class RefusedError(Exception):
    """A file breaks the grammar of its format."""


class Numbers(NamedTuple):
    """The numbers of a model, dense; rewards and observations may have axes of one where nothing depends on them.

    Attributes:
        discount: The discount; None where the format has none.
        start: A number per state.
        transitions: A x S x S'.
        observations: A x S x S' x O; None in an MDP.
        rewards: A x S x S' x O.
        told: Whether rewards depend on the observation, which a single one does not show by its axis; None if the axis
            tells.
    """

    discount: float | None
    start: Any
    transitions: Any
    observations: Any
    rewards: Any
    told: bool | None = None


def need(condition: object, message: str) -> None:
    """Refuse a file unless a condition holds."""
    if not condition:
        raise RefusedError(message)


def number(word: str) -> float:
    """Return the number that a word is."""
    need(NUMBER.fullmatch(word), f"{word!r} is not a number")
    value = float(word)
    need(math.isfinite(value), f"{word!r} is too large")
    return value


def sums(array: Any, within: float, what: str) -> None:
    """Refuse probabilities that do not sum to 1, added one after the other as the original tools do."""
    array = np.asarray(array)
    need((array >= 0).all(), f"{what}: negative probabilities")
    off = abs(np.add.accumulate(array, axis=-1)[..., -1] - 1).max()
    need(off <= within, f"{what}: a sum is off by {off:g}")


def assert_same_numbers(found: Numbers, model: Any, within: float = 1e-12) -> None:
    """Compare what was found in a file with a model."""
    options = {"rtol": within, "atol": within}
    if found.discount is not None:
        assert found.discount == model.discount
    np.testing.assert_allclose(found.start, model.initial_belief, **options)
    seen = model.kind == "POMDP"
    assert (found.observations is not None) == seen
    assert found.transitions.shape == (len(model.action_space), len(model.state_space), len(model.state_space))
    for action in range(len(model.action_space)):
        transition = found.transitions[action]
        np.testing.assert_allclose(transition, dense(model.transition_matrix(action)), **options)
        weights = transition[..., None]
        if seen:
            told = found.observations[action]
            weights = np.broadcast_to(weights * told, (*transition.shape, told.shape[-1]))
            for o in range(len(model.observation_space)):
                np.testing.assert_allclose(weights[..., o], dense(model.joint_matrix(action, o)), **options)
        given = found.rewards[action]
        if not (given.shape[2] > 1 if found.told is None else found.told):
            weights = transition[..., None]  # events may go unseen
        rewards = (given * weights).sum(axis=(1, 2)) if given.shape[1:] != (1, 1) else given[:, 0, 0]
        expected = model.rewards[:, action]
        np.testing.assert_allclose(
            np.broadcast_to(rewards, expected.shape), expected, rtol=max(within, 1e-11), atol=max(within, 1e-11)
        )


def dense(matrix: Any) -> Any:
    """Return a matrix as an array."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
