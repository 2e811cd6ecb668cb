"""Named arrays and a JSON header in one ``.npz`` file, uncompressed and without pickle.

Members are aligned, so that they can be mapped into memory without a copy. Sizes are checked against the file, and a
digest of all names and contents, kept as the archive's comment, tells damage. Equal arrays give equal bytes.
``numpy.load`` reads these files too.
"""

from __future__ import annotations

import hashlib
import math
import mmap
import re
import struct
import zipfile
import zlib
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.errors import FormatError, ModelError
from mdm.formats.target import replacing
from mdm.models import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path
    from typing import BinaryIO

MAGIC = b"PK\x03\x04"
_DAMAGE = (
    ValueError,
    OSError,
    EOFError,
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    OverflowError,
    struct.error,
)
_START = b"\x93NUMPY\x01\x00"
_HEAD = re.compile(
    rb"\{'descr': '(<f8|<i8|<i4|\|u1)', 'fortran_order': (True|False), 'shape': \(([0-9, ]{0,99})\), \} *\n"
)
_ALIGNED = 64
_KINDS = {"model": "it is a model", "policy": "it is a policy", "durations": "it holds durations"}
_PADDING = 0xD935
"""Tag of the extra header field that pads a member (the one of Android's zipalign)."""


class Names(msgspec.Struct, omit_defaults=True):
    """A factor's name and symbols; symbols that are a prefix and their index are stored as prefix and count."""

    name: str
    names: list[str] = []
    count: int = 0
    prefix: str = ""


def names_of(space: Space) -> list[Names]:
    """Return a space's factors as a header holds them."""
    return [_names(factor) for factor in space.factors]


def _names(factor: Factor) -> Names:
    prefix = factor.names[0].removesuffix("0")
    counted = all(name == f"{prefix}{index}" for index, name in enumerate(factor.names))
    if counted:
        return Names(factor.name, count=len(factor), prefix=prefix)
    return Names(factor.name, list(factor.names))


def space_of(factors: Iterable[Names]) -> Space:
    """Return the space of a header's factors.

    Raises:
        ModelError: If there are no factors, or symbols are missing, repeated or too many.
    """
    made = []
    for factor in factors:
        if not 0 <= factor.count <= _MOST:
            raise ModelError(f"{factor.count} symbols of {factor.name!r}: the count must be 0 to {_MOST}")
        made.append(Factor(factor.name, factor.count or factor.names, prefix=factor.prefix))
    return Space(made)


_MOST = 50_000_000


def is_archive(path: Path) -> bool:
    """Whether a file begins like an archive."""
    if not path.is_file():  # a pipe would be waited on
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False  # the reader reports it


def read(path: Path, opened: BinaryIO | None = None) -> tuple[bytes, dict[str, npt.NDArray[Any]]]:
    """Return the header and the arrays of a file, which are mapped into memory.

    Args:
        path: The file.
        opened: The same file, where it is open already. The arrays are then not read-only, but writing to them
            is for this process alone: compiled functions take them for such that were made.

    Raises:
        FormatError: If the file is missing, damaged, or not an archive of mdm's.
    """
    if opened is None and path.exists() and not path.is_file() and not path.is_dir():
        raise FormatError("this is a pipe or a device, not a file", file=path)
    access = mmap.ACCESS_READ if opened is None else mmap.ACCESS_COPY
    try:
        with path.open("rb") if opened is None else nullcontext(opened) as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if any(member.compress_type or member.flag_bits & 1 for member in members):
                raise FormatError("the archive is compressed or encrypted, so mdm did not write it", file=path)
            data = memoryview(mmap.mmap(file.fileno(), 0, access=access))
            contents = {member.filename: _content(data, member) for member in members}
            if len(contents) < len(members):
                raise ValueError("two members have one name")
            found = {name.removesuffix(".npy"): _array(content) for name, content in contents.items()}
            _verify(archive, contents)
    except FileNotFoundError:
        raise FormatError("there is no such file", file=path) from None
    except IsADirectoryError:
        raise FormatError("this is a folder, not a file", file=path) from None
    except _DAMAGE as error:
        message = " ".join(str(error).split())[:80]
        raise FormatError(f"the archive is damaged, or not of numpy's kind: {message}", file=path) from None
    if "header" not in found:
        raise FormatError("mdm did not write this archive: it has no header", file=path)
    return found.pop("header").tobytes(), found


def kind(path: Path) -> str | None:
    """Return the kind of an archive of mdm's: ``"model"``, ``"policy"`` or ``"durations"``; None for anything else.

    Raises:
        FormatError: If the file is not an archive of mdm's.
    """
    return _kind(read(path)[0])


def _kind(header: bytes) -> str | None:
    return next((kind for kind in _KINDS if f'"mdm {kind} 1"'.encode() in header), None)


def what_else(header: bytes, wanted: str, error: Exception) -> str:
    """Return in words which kind an archive is in place of the wanted one; of the wanted kind, the error."""
    found = _kind(header)
    return str(error) if found in (wanted, None) else _KINDS[found]


def _verify(archive: zipfile.ZipFile, contents: Mapping[str, memoryview]) -> None:
    """Compare an archive's contents with its digest; with their checksums, if it was written by numpy alone."""
    if not archive.comment:
        if any(zlib.crc32(contents[member.filename]) != member.CRC for member in archive.infolist()):
            raise ValueError("a checksum is wrong")
        return
    digest = hashlib.blake2b(digest_size=16)
    for name, content in contents.items():
        _tell(digest, name, content)
    if archive.comment != _comment(digest):
        raise ValueError("its contents do not have the digest that was written with them")


def _tell(digest: hashlib.blake2b, name: str, *parts: memoryview | bytes) -> None:
    """Add a member to a digest of names and contents."""
    digest.update(f"{name} {sum(map(len, parts))}\n".encode())
    for part in parts:
        digest.update(part)


def _comment(digest: hashlib.blake2b) -> bytes:
    return f"blake2b {digest.hexdigest()}".encode()


def _content(data: memoryview, member: zipfile.ZipInfo) -> memoryview:
    head = data[member.header_offset : member.header_offset + 30]
    if head[:4] != MAGIC:
        raise ValueError(f"{member.filename} has no header")
    begin = member.header_offset + 30 + sum(struct.unpack("<HH", head[26:30]))
    if begin + member.file_size > len(data):
        raise ValueError(f"{member.filename} is truncated")
    return data[begin : begin + member.file_size]


def _array(data: memoryview) -> npt.NDArray[Any]:
    """Read an array in numpy's format, after checking its header against the size of the data."""
    # numpy's own reader evaluates the header as Python, and allocates the claimed size before reading data.
    start = len(_START) + 2
    end = start + int.from_bytes(data[len(_START) : start], "little")
    head = _HEAD.fullmatch(data, start, end)
    if bytes(data[: len(_START)]) != _START or head is None:
        raise ValueError("an array is not one of integers or floats in version 1.0 of numpy's format")
    dtype = np.dtype(head[1].decode())
    shape = tuple(int(size) for size in head[3].split(b",") if size.strip())
    if math.prod(shape) * dtype.itemsize != len(data) - end:
        raise ValueError("an array's size differs from its header")
    array = np.frombuffer(data, dtype, offset=end).reshape(shape, order="F" if head[2] == b"True" else "C")
    return array if array.flags.aligned else array.copy()


def write(path: Path, header: Any, arrays: Mapping[str, npt.NDArray[Any]], *, mode: int | None = None) -> None:
    """Write a header (anything that msgspec encodes as JSON) and arrays.

    Args:
        path: The file.
        header: The header.
        arrays: The arrays.
        mode: The permissions of a new file; by default those that files have.

    Raises:
        FormatError: If the file cannot be written.
    """
    members = {"header": np.frombuffer(msgspec.json.encode(header), dtype=np.uint8), **arrays}
    with replacing(path, mode) as file, zipfile.ZipFile(file, "w") as archive:
        digest = hashlib.blake2b(digest_size=16)
        for name, array in members.items():
            little = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(array.shape)
            head = _head(little)
            info = zipfile.ZipInfo(f"{name}.npy")
            info.file_size = len(head) + little.nbytes
            padding = -(file.tell() + 30 + len(info.filename) + 4) % _ALIGNED
            info.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
            parts = (head, little.data.cast("B") if little.size else b"")
            _tell(digest, info.filename, *parts)
            with archive.open(info, "w") as member:
                for part in parts:
                    member.write(part)
        archive.comment = _comment(digest)


def _head(array: npt.NDArray[Any]) -> bytes:
    sizes = "".join(f"{size}, " for size in array.shape).removesuffix(" " if array.ndim == 1 else ", ")
    text = f"{{'descr': '{array.dtype.str}', 'fortran_order': False, 'shape': ({sizes}), }}"
    padding = -(len(_START) + 2 + len(text) + 1) % _ALIGNED
    body = text.encode() + b" " * padding + b"\n"
    return _START + len(body).to_bytes(2, "little") + body
