"""Writing a file whole or not at all."""

from __future__ import annotations

import errno
import gzip
import os
import stat
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


def check_place(path: str | Path, *sources: str | Path | None) -> None:
    """Refuse a file that could not be written, or that is read from, before there is something to write.

    Args:
        path: The file.
        sources: What is read to write it, by whatever path or link; None for what is not.

    Raises:
        FormatError: If it is one of the sources or a folder, or nothing can be written beside it.
    """
    for source in sources:
        if source is not None and _same(Path(path), Path(source)):
            raise FormatError("this file is read from, and would be lost: write to another", file=path)
    if _is_device(Path(path)):  # a pipe that is opened and closed would have come to its end
        return
    with suppress(_Unwritten), replacing(path):
        raise _Unwritten


class _Unwritten(Exception):
    """Nothing is to be written after all."""


@contextmanager
def replacing(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a neighbour of a file, which takes its place, with its permissions, when all of it is on the disk.

    A link stays, and what it leads to is replaced. A device or a pipe is written as it stands.

    Raises:
        FormatError: If the file cannot be written; what was there before is then still there.
    """
    path = Path(path)
    if path.is_dir():
        raise FormatError("this is a folder, not a file", file=path)
    try:
        if _is_device(path):
            with path.open("wb") as file:
                yield file
            return
        with _neighbour(Path(os.path.realpath(path))) as file:
            yield file
    except OSError as error:
        raise FormatError(f"the file cannot be written: {error.strerror}", file=path) from None


def _same(path: Path, other: Path) -> bool:
    return path.is_file() and other.is_file() and path.samefile(other)


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


@contextmanager
def _neighbour(path: Path) -> Iterator[IO[bytes]]:
    before = path.stat() if path.exists() else None
    if before is not None and not os.access(path, os.W_OK):  # a rename asks only for the folder's permission
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=".mdm-")
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if before is None:
            Path(name).chmod(0o666 & ~_mask())
        else:
            with suppress(PermissionError):  # only an administrator gives files away
                os.chown(name, before.st_uid, before.st_gid)
            Path(name).chmod(stat.S_IMODE(before.st_mode))
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _mask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
