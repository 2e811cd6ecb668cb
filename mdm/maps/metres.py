"""Metres: lengths that somebody gives, checked."""

from __future__ import annotations

import math

from mdm.errors import MapError
from mdm.number import is_number

__all__ = ["check_metres"]


def check_metres(metres: object, what: str) -> None:
    """Check that a length is one.

    Raises:
        MapError: If it is no finite number of 0 or more; `what` names it.
    """
    if not is_number(metres) or not 0 <= metres < math.inf:
        raise MapError(f"{what} is a number of metres, 0 or more, not {metres!r}")
