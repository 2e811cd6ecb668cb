"""The panel beside or below the floor: rows with a label, in the colour of what they are about."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mdm.maps.picture import Ink
    from mdm.views.palette import Palette

LABEL = 14  # columns
INKS = {"robot": (30, 80, 220), "person": (16, 120, 50), "intruder": (150, 40, 160), "fire": (196, 52, 8)}
SIGNS = {"person": "P", "intruder": "I", "fire": "F"}
WHO = {  # the colour of what is told, which can be read on black and on white
    "world": (7, 131, 131), "senses": (152, 110, 4), "top": (175, 71, 202), "patrol": (44, 110, 238),
    "action": (7, 136, 43), "fault": (234, 12, 26),
}  # fmt: skip
WHITE: Ink = (255, 255, 255)


@dataclass(frozen=True)
class Row:
    """A row: its label, whom it is about, and what it says."""

    label: str
    who: str
    text: str

    def lines(self, wide: int, most: int, palette: Palette) -> list[str]:
        """Return it in at most so many lines of so many columns, with an ellipsis where there is more to say."""
        room = max(wide - LABEL - 2, 1)
        texts = textwrap.wrap(self.text, room, max_lines=most, placeholder=" …") or [""]
        label = palette.inked(self.label.rjust(LABEL)[:LABEL], WHO[self.who], bold=True)
        return [f"{' ' * LABEL if number else label}  {text[:room]}" for number, text in enumerate(texts)]


def happened(seconds: float, who: str, text: str, wide: int, palette: Palette) -> str:
    """Return a line on what has happened, wholly in its colour."""
    line = told(seconds, who, text)
    return palette.inked(line if len(line) <= wide else line[: wide - 1] + "…", WHO[who], bold=who == "fault")


def told(seconds: float, who: str, text: str) -> str:
    """Return what has happened, and when."""
    return f"{seconds:7.1f} s {who:>7}  {text}"


def legend(seconds: float, wide: int, palette: Palette) -> list[str]:
    """Return the time, and what the signs on the floor stand for, in as many lines as it takes."""
    lines, long = [f"{seconds:{LABEL - 2}.1f} s"], LABEL
    for sign, name in (("→", "robot"), ("•", "trail"), ("X", "goal"), *((sign, kind) for kind, sign in SIGNS.items())):
        if long + 5 + len(name) > wide:
            lines.append(" " * LABEL)
            long = LABEL
        back = INKS.get(name, INKS["robot"])
        dot = palette.inked(sign, WHO["patrol"], bold=True)
        lines[-1] += f"  {dot if name == 'trail' else palette.inked(sign, WHITE, back, bold=True)} {name} "
        long += 5 + len(name)
    return lines
