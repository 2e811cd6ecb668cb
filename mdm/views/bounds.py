"""Plot of the bounds of solver runs over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from mdm.errors import FormatError
from mdm.formats.source import content
from mdm.views.canvas import pyplot

__all__ = ["bounds_figure"]


class _Entry(msgspec.Struct):
    seconds: float
    lower: float | None
    upper: float | None


class _Run(msgspec.Struct):
    solver: str
    history: list[_Entry]


def bounds_figure(paths: list[str]) -> Any:
    """Draw the histories in some files.

    Raises:
        FormatError: If a file is not a history.
    """
    runs = [_read(Path(path)) for path in paths]
    figure, axes = pyplot().subplots(figsize=(8, 5))
    settled: list[float] = []
    for place, (path, run) in enumerate(zip(paths, runs, strict=True)):
        label, entries = f"{Path(path).stem} ({run.solver})", run.history
        for side in ("lower", "upper"):
            points = [(entry.seconds, value) for entry in entries if (value := getattr(entry, side)) is not None]
            if points:
                seconds, values = zip(*points, strict=True)
                style = {"marker": "."} if len(points) == 1 else {}
                axes.step(seconds, values, where="post", color=f"C{place}", label=label, **style)
                label = "_"  # one of the two lines is enough for the legend
                settled += values[len(values) // 2 :]
        both = [entry for entry in entries if None not in {entry.lower, entry.upper}]
        sides = ([getattr(entry, side) for entry in both] for side in ("lower", "upper"))
        axes.fill_between([entry.seconds for entry in both], *sides, step="post", color=f"C{place}", alpha=0.12)
    if settled:  # the first bounds are so loose that they would hide the last ones
        margin = 0.05 * (max(settled) - min(settled)) or 1.0
        axes.set_ylim(min(settled) - margin, max(settled) + margin)
        axes.legend(frameon=False)
    axes.set_xscale("log")
    axes.set_xlabel("seconds")
    axes.set_ylabel("value of the initial belief")
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _read(path: Path) -> _Run:
    try:
        run = msgspec.json.decode(content(path), type=_Run)
    except msgspec.MsgspecError as error:
        raise FormatError(f"a history written by mdm solve --history was expected: {error}", file=path) from None
    if not run.history:
        raise FormatError("the history is empty", file=path)
    return run
