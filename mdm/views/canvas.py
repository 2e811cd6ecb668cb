"""Access to matplotlib: without a window, imported for the first picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mdm.errors import Error
from mdm.formats.target import check_place, replacing

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
        raise Error("pictures need matplotlib: pip install matplotlib") from None
    return plt


def check_picture(path: str, *sources: str) -> None:
    """Check, before anything is drawn, that a picture's file can be written and is not an input.

    Raises:
        Error: If the suffix is not that of a picture, or the file is an input or not writable.
    """
    check_place(path, *sources)
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise Error(f"{Path(path)}: the picture cannot be written: its file ends in {', '.join(_SUFFIXES)}")


def keep(figure: Any, path: str) -> None:
    """Write a figure in the format of the file's suffix: .png, .svg or .pdf.

    Raises:
        FormatError: If the file cannot be written.
    """
    try:
        with replacing(path) as file:
            figure.savefig(file, format=Path(path).suffix[1:].lower(), dpi=120, bbox_inches="tight")
    finally:
        pyplot().close(figure)
