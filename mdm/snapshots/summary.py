"""The summary of a record: all that its pictures need but for beliefs, so that it is shown without being read.

It is all that the reducer makes of a record's messages, as columns: of each track the times, and the entries in blocks
that are decompressed where one of them is looked at. It costs some bytes a decision, in a file and in memory. Beside a
record that has none in itself, ``run.mcap.summary`` keeps it, which is only taken for a record of the same bytes.
"""

from __future__ import annotations

import os
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import Error
from mdm.version import __version__

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.recording import Record
    from mdm.snapshots.reducer import Track

ATTACHED = "mdm.summary"
"""The name of the summary among the attached files of its record."""
_START = b"mdm.summary 1\n"
_BLOCK = 64
_KEPT = 16
"""Blocks of a track that are kept decompressed."""


class Column(msgspec.Struct, frozen=True, array_like=True):
    """A track: the differences of its times as compressed 64-bit numbers, and its entries in compressed blocks."""

    times: bytes
    blocks: tuple[bytes, ...]


class Summary(msgspec.Struct, frozen=True, array_like=True):
    """A summary.

    Attributes:
        of: The sizes and checksums of the record's files; none where it is within the record.
        columns: The tracks, by the ensemble's path, or none for those of the run, and by name.
        facts: Further facts, by name.
    """

    of: tuple[str, ...]
    columns: dict[str, dict[str, Column]]
    facts: dict[str, msgspec.Raw]

    def encoded(self) -> bytes:
        """Return it as the bytes of a file."""
        content = msgspec.msgpack.encode((__version__, self))
        return b"".join((_START, zlib.crc32(content).to_bytes(4, "little"), content))


def decoded(data: bytes) -> Summary:
    """Return a summary of such bytes.

    Raises:
        Error: If they are damaged, no summary, or one of another version.
    """
    start = len(_START) + 4
    if not data.startswith(_START) or int.from_bytes(data[len(_START) : start], "little") != zlib.crc32(data[start:]):
        raise Error("it is damaged, or no summary")
    try:
        version, rest = msgspec.msgpack.decode(data[start:], type=tuple[str, msgspec.Raw])
        if version != __version__:
            raise Error(f"it is of mdm {version}")
        return msgspec.msgpack.decode(rest, type=Summary)
    except msgspec.MsgspecError as error:
        raise Error(f"it is no summary: {error}") from None


def beside(record: Record) -> Path:
    """Return where the summary is kept of a record that has none in itself."""
    return record.path.with_name(f"{record.path.name}.summary")


def summary_of(record: Record) -> Summary | None:
    """Return the summary of a record, or None where there is none of it: beside it, else in itself.

    That within a record holds where none of it is damaged or torn, that beside it where no byte has changed since.
    """
    with suppress(OSError, Error):
        found = decoded(beside(record).read_bytes())
        if found.of == record.checksums:
            return found
    if not record.flaws and not record.grows:
        for attached in record.attachments:
            if attached.name == ATTACHED:
                with suppress(Error):
                    return decoded(attached.data)
    return None


def keep(summary: Summary, record: Record) -> bool:
    """Keep a summary beside its record; return whether that could be written."""
    path = beside(record)
    part = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        part.write_bytes(summary.encoded())
        part.replace(path)
    except OSError:
        with suppress(OSError):
            part.unlink()
        return False
    return True


def packed(track: Track) -> Column:
    """Return a track as a column."""
    encode, entries = msgspec.msgpack.Encoder(enc_hook=np.ndarray.tolist).encode, track.entries
    times = np.diff(np.array(track.times, dtype=np.int64), prepend=0)
    blocks = [zlib.compress(encode(entries[place : place + _BLOCK]), 3) for place in range(0, len(entries), _BLOCK)]
    return Column(zlib.compress(times.tobytes(), 3), tuple(blocks))


def unpack(column: Column, track: Track, kind: Any) -> None:
    """Fill a track from a column, whose entries are of a kind."""
    times = array("q")
    times.frombytes(np.cumsum(np.frombuffer(zlib.decompress(column.times), dtype=np.int64)).tobytes())
    track.times, track.entries = times, Packed(column.blocks, len(times), kind)


class Packed(Sequence[Any]):
    """The entries of a track, of which a block is decompressed where one of it is looked at.

    Args:
        blocks: The blocks.
        size: How many entries there are.
        kind: Their type.
    """

    def __init__(self, blocks: Sequence[bytes], size: int, kind: Any) -> None:
        self._blocks, self._size = blocks, size
        self._decode = msgspec.msgpack.Decoder(list[kind], dec_hook=lambda _, value: np.array(value)).decode
        self._kept: OrderedDict[int, list[Any]] = OrderedDict()

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return [self[each] for each in range(*place.indices(self._size))]
        if place < 0:
            place += self._size
        if not 0 <= place < self._size:
            raise IndexError(place)
        number, at = divmod(place, _BLOCK)
        block = self._kept.get(number)
        if block is None:
            block = self._kept[number] = self._decode(zlib.decompress(self._blocks[number]))
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return block[at]
