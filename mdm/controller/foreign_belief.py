"""Beliefs of a user's own tracker, which may be anything."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError

if TYPE_CHECKING:
    from mdm.models.matrices import Vector

__all__ = ["checked_belief", "copied"]


def checked_belief(belief: Any, size: int | None) -> Vector:
    """Return a copy of the belief of a user's tracker, which may change its own in place; refuse an invalid one."""
    try:
        array = copied(belief)
    except (TypeError, ValueError):
        raise ModelError(f"the tracker's belief is not an array of numbers, but {belief!r}") from None
    if array.shape != (array.size if size is None else size,):
        raise ModelError(f"the tracker's belief has the shape {array.shape}, but there are {size} states")
    if not (np.isfinite(array).all() and (array >= 0).all() and abs(array.sum() - 1) < 1e-6):
        raise ModelError(
            "the tracker's belief is not a distribution: its numbers are negative, not finite, or do not sum to 1"
        )
    return array


def copied(belief: Any) -> Vector:
    """Return a belief as an immutable array of its own."""
    array = np.array(belief, dtype=np.float64)
    array.flags.writeable = False
    return array
