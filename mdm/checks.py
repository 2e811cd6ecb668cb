"""Checks of users' arguments: numbers (Python's and numpy's alike; truth values are none), choices, seeds, lengths."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard

from mdm.errors import ConfigError, MapError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TypeAlias

    import numpy as np

    Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
    Whole: TypeAlias = int | np.integer[Any]

__all__ = ["check_choice", "check_flag", "check_metres", "check_seed", "is_number", "is_whole"]


def check_choice(given: object, choices: Sequence[str], what: str, *, key: str | None = None) -> None:
    """Refuse a value that is none of several words.

    Raises:
        ConfigError: If it is none of them.
    """
    if not isinstance(given, str) or given not in choices:
        *most, last = map(repr, choices)
        raise ConfigError(f"{what} is {', '.join(most)} or {last}, not {given!r}", key=key)


def check_flag(given: object, what: str, *, key: str | None = None) -> None:
    """Refuse a value that is neither True nor False.

    Raises:
        ConfigError: If it is something else, such as the text ``"no"``, which would count as True.
    """
    if not isinstance(given, bool):
        raise ConfigError(f"{what} is True or False, not {given!r}", key=key)


def check_seed(given: object) -> None:
    """Refuse a value that is no seed of random numbers: neither a whole number from 0 on, nor None.

    Raises:
        ConfigError: If it is something else.
    """
    if given is not None and not (is_whole(given) and given >= 0):
        raise ConfigError(f"a seed is a whole number from 0 on, not {given!r}", key="seed")


def is_number(given: object) -> TypeGuard[float]:
    """Whether something is a real number; nan and infinities are."""
    return isinstance(given, Real) and not isinstance(given, bool)


def is_whole(given: object) -> TypeGuard[int]:
    """Whether something is an integer."""
    return isinstance(given, Integral) and not isinstance(given, bool)


def check_metres(metres: object, what: str) -> None:
    """Check that a length is one.

    Raises:
        MapError: If it is no finite number of 0 or more; `what` names it.
    """
    if not is_number(metres) or not 0 <= metres < math.inf:
        raise MapError(f"{what} is a number of metres, 0 or more, not {metres!r}")
