"""Films: pictures of a floor, one after the other, as an animation or on one sheet."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.formats.target import check_place, replacing

if TYPE_CHECKING:
    from collections.abc import Iterable
    from os import PathLike

    from mdm.views.floor import FloorView, Mark

__all__ = ["Film"]

_SHEET = 12
"""Pictures on a sheet, at most."""
_GAP = 8


class Film:
    """A film of a floor: ``.gif`` for an animation, ``.png`` for a sheet of pictures from it.

    Args:
        view: The floor.
        path: Its file.
        size: How long the longer side of a picture is, in pixels.

    Raises:
        Error: If the file's name ends otherwise, or it cannot be written.
    """

    def __init__(self, view: FloorView, path: str | PathLike[str], *, size: int = 900) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in {".gif", ".png"}:
            raise Error(f"{self.path}: a film ends in .gif, or in .png for a sheet of its pictures")
        check_place(str(path))
        self._view, self._size = view, size
        self._pictures: list[Any] = []

    def __len__(self) -> int:
        return len(self._pictures)

    def add(self, marks: Iterable[Mark], title: str, *, trail: Iterable[tuple[float, float]] = ()) -> None:
        """Add a picture, with lines below it, and a robot's trail on it.

        Raises:
            MapError: If Pillow is not installed.
        """
        self._pictures.append(self._view.image(marks, trail=trail, title=title, size=self._size))

    def save(self, seconds: float) -> None:
        """Write the film; an animation shows each picture for so many seconds.

        Raises:
            Error: If there is no picture, or the file cannot be written.
        """
        if not self._pictures:
            raise Error(f"{self.path}: there is no picture to make a film of")
        with replacing(self.path) as file:
            if self.path.suffix.lower() == ".png":
                self._sheet().save(file, format="PNG", optimize=True)
                return
            high = max(picture.height for picture in self._pictures)
            first, *rest = (self._filled(picture, high).convert("P", palette=1) for picture in self._pictures)
            milliseconds = max(20, round(1000 * seconds))
            first.save(file, format="GIF", save_all=True, append_images=rest, duration=milliseconds, loop=0)

    def _filled(self, picture: Any, high: int) -> Any:
        from PIL import Image  # noqa: PLC0415 - an extra

        whole = Image.new("RGB", (picture.width, high), "white")
        whole.paste(picture, (0, 0))
        return whole

    def _sheet(self) -> Any:
        from PIL import Image  # noqa: PLC0415 - an extra

        count = min(_SHEET, len(self._pictures))
        last = len(self._pictures) - 1
        chosen = [self._pictures[round(index * last / max(1, count - 1))] for index in range(count)]
        across = math.ceil(math.sqrt(count))
        wide, high = max(one.width for one in chosen) + _GAP, max(one.height for one in chosen) + _GAP
        sheet = Image.new("RGB", (across * wide - _GAP, math.ceil(count / across) * high - _GAP), "white")
        for index, picture in enumerate(chosen):
            sheet.paste(picture, (index % across * wide, index // across * high))
        return sheet
