"""Images: the numbers in portable maps (PGM, PPM), read with numpy alone, and in PNG and BMP, read with Pillow.

Labels are written to be corrected in a paint program: a colour for each place, black where there is none.
"""

from __future__ import annotations

import colorsys
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import FormatError, MapError
from mdm.formats.source import content
from mdm.formats.target import replacing

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    from mdm.maps.raster import Labels
    from mdm.models.matrices import Vector

_MOST = 100_000_000
"""Pixels of an image."""
_PNG = b"\x89PNG\r\n\x1a\n"
_HEADER = re.compile(rb"P([2356])" + rb"(?:\s|#[^\n]*\n)+(\d+)" * 3 + rb"(?:\s|(?=\Z))")
_DEEP = "16 bits per colour channel: save the image with 8"
_HUES = 12


@dataclass(frozen=True, eq=False)
class Image:
    """An image.

    Args:
        channels: The numbers of its pixels, rows x columns x 1 (grey), 3 (red, green, blue) or 4 (and opacity).
        most: The number that stands for full brightness and opacity.
        indices: For an image with a palette the index of each pixel, rows x columns.
    """

    channels: NDArray[np.uint8 | np.uint16]
    most: int
    indices: NDArray[np.uint8] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and of columns."""
        return self.channels.shape[0], self.channels.shape[1]

    @property
    def opacity(self) -> NDArray[Any] | None:
        """For each pixel its opacity from 0 to `most`; None where the image has none."""
        return self.channels[:, :, 3] if self.channels.shape[2] == 4 else None

    @property
    def brightness(self) -> Vector:
        """For each pixel the mean of its colours, from 0 to `most`."""
        mean: Vector = self.channels[:, :, :3].mean(axis=2)
        return mean

    @property
    def numbers(self) -> NDArray[np.uint32]:
        """For each pixel the number of its colour.

        That is red + 256 green + 65,536 blue, and 16,777,216 times the opacity where there is one; the index where
        there is a palette; the number itself where the image is grey.
        """
        if self.indices is not None:
            return self.indices.astype(np.uint32)
        weights = np.array([1, 1 << 8, 1 << 16, 1 << 24], dtype=np.uint32)[: self.channels.shape[2]]
        numbers: NDArray[np.uint32] = (self.channels * weights).sum(axis=2, dtype=np.uint32)
        return numbers


def read_image(path: str | PathLike[str]) -> Image:
    """Read an image: PGM, PPM, PNG or BMP, told by its content.

    Raises:
        FormatError: If it is missing, of another kind, damaged, has more than 100 million pixels, or 16 bits per colour
            channel (16 bits of grey are read).
        MapError: If it is a PNG or BMP, and Pillow is not installed.
    """
    path = Path(path)
    data = content(path)
    if re.match(rb"P[2356][\s#]", data):
        return _portable(data, path)
    if data.startswith((_PNG, b"BM")):
        return _drawn(data, path)
    raise FormatError("this is no PGM, PPM, PNG or BMP image", file=path)


def _portable(data: bytes, path: Path) -> Image:
    header = _HEADER.match(data)
    if header is None:
        raise FormatError("the header of the image is damaged", file=path)
    kind, columns, rows, most = (int(word[:9]) for word in header.groups())
    _check_size(rows, columns, path)
    if not 1 <= most <= 65_535:
        raise FormatError(f"the image says that its brightest pixels are {most}, which is not in 1 … 65535", file=path)
    count = rows * columns * (3 if kind in {3, 6} else 1)
    if kind in {2, 3}:
        try:
            numbers = np.array(re.sub(rb"#[^\n]*", b"", data[header.end() :]).split(), dtype=np.int64)
        except (ValueError, OverflowError):
            raise FormatError("a pixel is not a whole number", file=path) from None
    else:
        kinds = np.dtype(np.uint8 if most < 256 else ">u2")
        rest = len(data) - header.end()
        numbers = np.frombuffer(data, kinds, rest // kinds.itemsize, header.end())
    if len(numbers) != count:
        raise FormatError(f"the image has {len(numbers)} numbers in place of {count}: it is damaged", file=path)
    if numbers.max() > most or numbers.min() < 0:
        raise FormatError(f"a pixel is {numbers.max()}, and the header promises at most {most}", file=path)
    if kind in {3, 6} and most != 255:
        raise FormatError(_DEEP, file=path)
    return Image(numbers.astype(np.uint16).reshape(rows, columns, -1), most)


def _check_size(rows: int, columns: int, path: Path) -> None:
    if rows < 1 or columns < 1:
        raise FormatError(f"an image of {columns} x {rows} pixels has none", file=path)
    if rows * columns > _MOST:
        raise FormatError(f"{columns} x {rows} pixels are more than {_MOST:,}", file=path)


def _drawn(data: bytes, path: Path) -> Image:
    try:
        from PIL import Image as pillow  # noqa: N813, PLC0415 - a module, of an extra
    except ImportError:
        raise MapError(f"{path}: PNG and BMP images need Pillow: pip install pillow pyyaml") from None
    bits, kind = (data[24], data[25]) if data.startswith(_PNG) and len(data) > 25 else (8, -1)
    if bits == 16 and kind != 0:
        raise FormatError(_DEEP, file=path)
    try:
        with pillow.open(io.BytesIO(data), formats=("PNG", "BMP")) as picture:
            _check_size(picture.height, picture.width, path)
            return _pixels(picture, bits, path)
    except FormatError:
        raise
    except Exception as error:  # whatever a damaged image makes of its decoder
        raise FormatError(f"the image is damaged: {error}", file=path) from None


def _pixels(picture: Any, bits: int, path: Path) -> Image:
    match picture.mode:
        case "1":
            return Image(np.asarray(picture).astype(np.uint8)[:, :, None], 1)
        case "L":
            most = 2**bits - 1  # Pillow spreads 2 and 4 bits over 255
            return Image(np.asarray(picture)[:, :, None] // (255 // most), most)
        case "I;16":
            return Image(np.asarray(picture).astype(np.uint16)[:, :, None], 65_535)
        case "P":
            shown = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
            return Image(np.array(shown), 255, np.array(picture))
        case "RGB" | "RGBA":
            return Image(np.array(picture), 255)
        case "LA":
            return Image(np.array(picture.convert("RGBA")), 255)
    raise FormatError(f"images of the kind {picture.mode!r} are not read: save it as grey, RGB or RGBA", file=path)


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
        raise MapError("PNG images need Pillow: pip install pillow pyyaml") from None
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
