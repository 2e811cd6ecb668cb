"""Writing a file whole or not at all."""

from __future__ import annotations

import gzip
import os
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["check_place", "replacing", "write_text"]


def write_text(path: str | Path, text: str) -> None:
    """Write a text, compressed where the path ends in ``.gz``.

    Raises:
        FormatError: If the file cannot be written; what was there before is then still there.
    """
    data = text.encode()
    if Path(path).suffix.lower() == ".gz":
        data = gzip.compress(data, mtime=0)  # the same text makes the same file
    with replacing(path) as file:
        file.write(data)


def check_place(path: str | Path) -> None:
    """Refuse a file that could not be written, before there is something to write.

    Raises:
        FormatError: If it is a folder, or nothing can be written beside it.
    """
    with suppress(_Unwritten), replacing(path):
        raise _Unwritten


class _Unwritten(Exception):
    """Nothing is to be written after all."""


@contextmanager
def replacing(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a neighbour of a file, which takes its place when all is written.

    Raises:
        FormatError: If the file cannot be written; what was there before is then still there.
    """
    path = Path(path)
    if path.is_dir():
        raise FormatError("this is a folder, not a file", file=path)
    try:
        if path.exists() and not path.is_file():  # a device, such as /dev/null, keeps its place
            with path.open("wb") as file:
                yield file
            return
        descriptor, neighbour = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(descriptor, "wb") as file:
                yield file
            Path(neighbour).chmod(path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_mask())
            Path(neighbour).replace(path)
        except BaseException:
            Path(neighbour).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise FormatError(f"the file cannot be written: {error.strerror}", file=path) from None


def _mask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
