"""The colours of actions, in every picture; and the colours that a terminal has, with the codes for them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from mdm.maps.picture import contrast

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from mdm.maps.picture import Ink

ACTIONS = ("#77aadd", "#eedd88", "#ffaabb", "#bbcc33", "#99ddff", "#ee8866", "#aaaa00", "#44bb99")
"""Actions in their order, and parts of other wholes: on the page, which has them in `page.css`, and in plots.

The scheme *light* of Paul Tol, Colour Schemes (SRON/EPS/TN/09-002, 2021): distinct to the colour-blind, and light
enough for dark text on them.
"""

_READABLE = 4.5
_LEVELS = (0, 95, 135, 175, 215, 255)
_FIXED = [(red, green, blue) for red in _LEVELS for green in _LEVELS for blue in _LEVELS]
_FIXED += [(grey, grey, grey) for grey in range(8, 248, 10)]
"""The colours with the numbers 16 to 255 of a terminal with 256; themes choose the first 16."""
_WITHOUT = re.compile(r"|dumb|unknown|ansi|vt\d.*")
"""Terminals, as TERM names them, that have no 256 colours."""


@dataclass(frozen=True)
class Palette:
    """The colours of a terminal.

    Args:
        colours: How many there are: 2²⁴, 256, or none.
    """

    colours: int = 1 << 24

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Palette:
        """Return the colours of the terminal that an environment names; none where ``NO_COLOR`` is set."""
        if environment.get("NO_COLOR") or _WITHOUT.fullmatch(environment.get("TERM", "")):
            return cls(0)
        return cls(1 << 24 if environment.get("COLORTERM") in {"truecolor", "24bit"} else 256)

    def __bool__(self) -> bool:
        return self.colours > 0

    def front(self, ink: Ink | None) -> str:
        """Return the code that makes text of a colour; None is the terminal's own."""
        return self._code(38, ink)

    def back(self, ink: Ink | None) -> str:
        """Return the code that makes the background of a colour; None is the terminal's own."""
        return self._code(48, ink)

    def inked(self, text: str, ink: Ink | None = None, back: Ink | None = None, *, bold: bool = False) -> str:
        """Return a text in colours, where there are any."""
        if not self:
            return text
        codes = ("\x1b[1m" if bold else "", self.front(ink) if ink else "", self.back(back) if back else "")
        return f"{''.join(codes)}{text}\x1b[0m"

    @cache  # noqa: B019 - there are few palettes, and few inks
    def _code(self, kind: int, ink: Ink | None) -> str:
        if not self:
            return ""
        if ink is None:
            return f"\x1b[{kind + 1}m"
        if self.colours == 256:
            return f"\x1b[{kind};5;{_nearest(ink)}m"
        return f"\x1b[{kind};2;{ink[0]};{ink[1]};{ink[2]}m"


@cache
def _nearest(ink: Ink) -> int:
    """Return the number of the nearest of 256 colours that can be read on black and on white where this one can."""
    fixed: NDArray[np.int64] = np.array(_FIXED)
    distances = ((fixed - ink) ** 2).sum(axis=1)
    for other in ((0, 0, 0), (255, 255, 255)):
        if contrast(ink, other) >= _READABLE:
            distances[[contrast(one, other) < _READABLE for one in _FIXED]] = 1 << 20
    return 16 + int(distances.argmin())
