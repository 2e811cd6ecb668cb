"""What a reader met in a file and did not carry over: noted while it reads, told once, in one form for all readers.

Everything in a file is taken, refused with an error, or noted here.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Inventory"]

_PLACES = 3
"""Places of one thing that are told."""


class Inventory:
    """What was not carried over, each thing with its places, in the order of the file."""

    def __init__(self) -> None:
        self._left: dict[tuple[str, str], list[str]] = {}

    def leave(self, what: str, place: str, why: str = "") -> None:
        """Note something, with its place, such as ``line 3``, and why, where that is not plain."""
        self._left.setdefault((what, why), []).append(place)

    def add(self, other: Inventory) -> None:
        """Note what another reader has noted."""
        for (what, why), places in other._left.items():
            self._left.setdefault((what, why), []).extend(places)

    def lines(self) -> list[str]:
        """Return a line for each thing: what, where and why."""
        return [
            f"{what}, of {', '.join(places[:_PLACES])}"
            + (f" and {len(places) - _PLACES} more" if len(places) > _PLACES else "")
            + (f": {why}" if why else "")
            for (what, why), places in self._left.items()
        ]

    def warn(self, path: Path, kind: type[Warning]) -> None:
        """Warn once of all that was left of a file; not where that is nothing."""
        if self._left:
            warnings.warn(kind(f"{path}: not carried over: {'; '.join(self.lines())}"), stacklevel=2)
