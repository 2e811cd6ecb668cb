"""What is wrong with a map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """Something that is wrong with a map.

    Args:
        kind: What it is about: `greys`, `colours`, `goals`, `rooms`, `ways` or `lifts`.
        text: What is wrong, in a sentence.
        places: The names of the places that it is about.
        cells: Rows and columns of cells where it is seen.
        floor: The floor that it is on, where there are several.
    """

    kind: str
    text: str
    places: tuple[str, ...] = ()
    cells: Sequence[tuple[int, int]] = ()
    floor: str = ""

    def on(self, floor: str) -> Problem:
        """Return the problem as one of a floor, which its sentence names."""
        return replace(self, text=f"{floor}: {self.text}", floor=floor)
