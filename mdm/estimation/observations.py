"""Observations: how often each was made after an action, and how often the model expected it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.estimation.hidden import Matrices, moves, passes

if TYPE_CHECKING:
    from mdm.estimation.hidden import Evidence
    from mdm.models.pomdp import POMDP

__all__ = ["Frequencies", "frequencies"]


class Frequencies(msgspec.Struct, frozen=True):
    """How often each observation was made after an action, wherever it led.

    Attributes:
        action: The action.
        counts: How often each was made: O numbers.
        expected: How often the model expected each, under the belief before each action: O numbers.
        missing: How often nothing was observed, or a part of it.
    """

    action: int
    counts: npt.NDArray[np.float64]
    expected: npt.NDArray[np.float64]
    missing: int


def frequencies(model: POMDP, evidence: Evidence) -> tuple[Frequencies, ...]:
    """Return how often each observation was made after each action that was done.

    Args:
        model: The model in use.
        evidence: See `mdm.estimation.hidden.evidence_of`.
    """
    size = len(model.observation_space)
    matrices = Matrices.of(model)
    before, _ = passes(evidence, moves(matrices, evidence.masks))
    single = evidence.masks.sum(axis=1) == 1
    symbols = evidence.masks.argmax(axis=1)
    acted, seen = evidence.actions, evidence.symbols
    every = moves(matrices, np.eye(size, dtype=bool))
    result = []
    for action in np.unique(acted).tolist():
        which = (acted == action) & single[seen]
        told = np.bincount(symbols[seen[which]], minlength=size).astype(np.float64)
        # A x O x S x S', summed over S': what is observed after each state
        expected = before[which].sum(axis=0) @ every[action].sum(axis=2).T
        missing = int(((acted == action) & ~single[seen]).sum())
        result.append(Frequencies(action, told, np.asarray(expected), missing))
    return tuple(result)
