"""matplotlib, where it is installed: without a window, imported when the first picture is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mdm.errors import Error
from mdm.formats.target import replacing

__all__ = ["keep", "pyplot"]


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


def keep(figure: Any, path: str) -> None:
    """Write a figure into a file, whose suffix says of which kind: .png, .svg or .pdf.

    Raises:
        Error: If the file cannot be written.
    """
    try:
        with replacing(path) as file:
            figure.savefig(file, format=Path(path).suffix[1:].lower(), dpi=120, bbox_inches="tight")
    except ValueError as error:
        raise Error(f"{Path(path)}: the picture cannot be written: {error}") from None
    finally:
        pyplot().close(figure)
