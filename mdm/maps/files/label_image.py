"""Images of labels, written to be corrected in a paint program: a colour for each place, black where there is none."""

from __future__ import annotations

import colorsys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import FormatError, MapError
from mdm.formats.target import replacing

if TYPE_CHECKING:
    from os import PathLike

    from mdm.maps.labels import Labels

__all__ = ["save_labels"]

_HUES = 12


def save_labels(labels: Labels, path: str | PathLike[str]) -> None:
    """Write labels as a PNG of plain colours, one cell a pixel.

    A place's name is not in it: read again with the same graph, a place is what has the colour under its goal.

    Raises:
        FormatError: If the file cannot be written, or its name does not end in ``.png``.
        MapError: If Pillow is not installed.
    """
    if Path(path).suffix.lower() != ".png":
        raise FormatError("images of labels are written as .png", file=str(path))
    try:
        from PIL import Image  # noqa: PLC0415 - an extra
    except ImportError:
        raise MapError("PNG images need Pillow: pip install 'markov-decision-making[maps]'") from None
    colours = np.array([(0, 0, 0), *_colours(len(labels.names))], dtype=np.uint8)
    image: Any = Image.fromarray(colours[labels.raster])
    with replacing(Path(path)) as file:
        image.save(file, format="PNG", optimize=True)


def _colours(count: int) -> list[tuple[int, int, int]]:
    """Return so many colours, none twice: hues first, then the same darker."""
    colours: dict[tuple[int, int, int], None] = {}
    while len(colours) < count:
        turn, hue = divmod(len(colours), _HUES)
        parts = colorsys.hsv_to_rgb((5 * hue % _HUES) / _HUES, 0.75, 1.0 - 0.05 * (turn % 15))
        red, green, blue = (round(255 * part) for part in parts)
        while (red, green, blue) in colours:
            red, green = (red + 1) % 256, (green + (red == 255)) % 256
        colours[red, green, blue] = None
    return list(colours)
