"""matplotlib, where it is installed: without a window, imported when the first picture is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mdm.errors import Error
from mdm.formats.target import check_place, replacing

__all__ = ["check_picture", "keep", "pyplot"]

_SUFFIXES = (".png", ".svg", ".pdf")


def pyplot() -> Any:
    """Return matplotlib's pyplot.

    Raises:
        Error: If matplotlib is not installed.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - an extra

        mpl.use("Agg")
        from matplotlib import pyplot as plt  # noqa: PLC0415
    except ImportError:
        raise Error("pictures need matplotlib: pip install 'markov-decision-making[plot]'") from None
    return plt


def check_picture(path: str, *sources: str) -> None:
    """Refuse a picture's file that could not be written, or that is read from, before there is something to draw.

    Raises:
        Error: If its suffix is none of a picture, or the file cannot be written or is one of the sources.
    """
    check_place(path, *sources)
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise Error(f"{Path(path)}: the picture cannot be written: its file ends in {', '.join(_SUFFIXES)}")


def keep(figure: Any, path: str) -> None:
    """Write a figure into a file, whose suffix says of which kind: .png, .svg or .pdf.

    Raises:
        FormatError: If the file cannot be written.
    """
    try:
        with replacing(path) as file:
            figure.savefig(file, format=Path(path).suffix[1:].lower(), dpi=120, bbox_inches="tight")
    finally:
        pyplot().close(figure)
