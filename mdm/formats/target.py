"""Atomic writing of files."""

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


def write_text(path: str | Path, text: str) -> None:
    """Write a text atomically, gzipped if the path ends in ``.gz``.

    Raises:
        FormatError: If the file cannot be written; a previous file is then left as it was.
    """
    data = text.encode()
    if Path(path).suffix.lower() == ".gz":
        data = gzip.compress(data, mtime=0)  # reproducible: equal texts give equal files
    with replacing(path) as file:
        file.write(data)


def check_place(path: str | Path, *sources: str | Path | None) -> None:
    """Check, before anything is computed, that a file can be written and is not an input.

    Args:
        path: The file.
        sources: The input files, compared by identity and not by path; None is skipped.

    Raises:
        FormatError: If the path is an input or a folder, or its folder is not writable.
    """
    for source in sources:
        if source is not None and _same(Path(path), Path(source)):
            raise FormatError("this file is an input and would be overwritten: write to another", file=path)
    if _is_device(Path(path)):  # opening and closing a pipe would end it for its reader
        return
    with suppress(_Unwritten), replacing(path):
        raise _Unwritten


class _Unwritten(Exception):
    """Leaves `replacing` without replacing the file."""


@contextmanager
def replacing(path: str | Path, mode: int | None = None) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces the given one once it is complete and synchronised to disk.

    Permissions are kept. Of a link, the target is replaced. Devices and pipes are written in place.

    Args:
        path: The file.
        mode: The permissions of a new file; by default those that files have.

    Raises:
        FormatError: If the file cannot be written; a previous file is then left as it was.
    """
    path = Path(path)
    if path.is_dir():
        raise FormatError("this is a folder, not a file", file=path)
    try:
        if _is_device(path):
            with path.open("wb") as file:
                yield file
            return
        with _temporary(Path(os.path.realpath(path)), mode) as file:
            yield file
    except OSError as error:
        raise FormatError(f"the file cannot be written: {error.strerror}", file=path) from None


def _same(path: Path, other: Path) -> bool:
    return path.is_file() and other.is_file() and path.samefile(other)


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


@contextmanager
def _temporary(path: Path, mode: int | None) -> Iterator[IO[bytes]]:
    before = path.stat() if path.exists() else None
    if before is not None and not os.access(path, os.W_OK):  # renaming checks only the folder's permissions
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=".mdm-")
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if before is None:
            Path(name).chmod(0o666 & ~_mask() if mode is None else mode)
        else:
            with suppress(PermissionError):  # only root may change the owner
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
