"""Numbers that users give: Python's and numpy's alike; truth values are none."""

from __future__ import annotations

from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    from typing import TypeAlias

    import numpy as np

    Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
    Whole: TypeAlias = int | np.integer[Any]

__all__ = ["is_number", "is_whole"]


def is_number(given: object) -> TypeGuard[float]:
    """Whether something is a real number; nan and infinities are."""
    return isinstance(given, Real) and not isinstance(given, bool)


def is_whole(given: object) -> TypeGuard[int]:
    """Whether something is an integer."""
    return isinstance(given, Integral) and not isinstance(given, bool)
