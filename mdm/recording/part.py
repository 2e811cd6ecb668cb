"""Reads one file of a record: its sound parts, and where it is damaged or torn.

A file of ours that is whole, by the checksum of its data, is taken in by its index. Any other is read from its start,
record by record as the MCAP specification lays them out, so that a file without its end is read as well. Where a chunk
has a checksum, as ours have, its messages are taken if that holds. Other programs may leave out all that is optional in
MCAP: chunks, checksums (0 means that none is given), indices, a summary. Behind damage it goes on where the next record
begins: as the damaged one tells, else as the summary does, else at the next bytes that are a chunk whose checksum
holds. The numbers of messages tell how many are lost.
"""

from __future__ import annotations

import importlib
import os
import re
import stat
import struct
import zlib
from collections import Counter
from contextlib import suppress
from functools import partial
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from mdm.errors import Error, FormatError
from mdm.recording.process import MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

PART = "mdm.file"
"""The metadata that tell which file of a record it is."""
SYSTEM = "system"
"""The metadata of a program's run: the name of its description, and the gaps of that."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = range(1, 8)
_ATTACHMENT, _METADATA, _DATA_END, _LAST = 9, 12, 15, 15
_CHUNK_INDEX, _ATTACHMENT_INDEX, _STATISTICS, _METADATA_INDEX = 8, 10, 11, 13
_PLACES = {_CHUNK_INDEX: 16, _ATTACHMENT_INDEX: 0, _METADATA_INDEX: 0}
"""Where the indices of chunks, attachments and metadata, in a summary, tell the place of one."""
_RECORD = struct.Struct("<BQ")
_STAMPED = struct.Struct("<BQHIQQ")
"""Of a message: its kind, length, channel, sequence and two times."""
_LARGEST = 1 << 30
"""Bytes of a chunk, at most: ours have 256 kB, or a message."""
_TOGETHER = 1 << 18
"""Bytes of messages without a chunk that are read together."""
_BLOCK = 1 << 22
_CHUNK_START = re.compile(rb"\x06(?=[\s\S]{5}\x00{3}[\s\S]{28}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)[\s\S]{8})")
"""How a chunk begins, which may be anything else as well: a length below 2**40, and a compression."""
_START_SIZE = 9 + 28 + 8 + 8


def number_in(metadata: Mapping[str, Mapping[str, str]], name: str, key: str) -> int:
    """Return a number of the metadata, 0 where there is none."""
    text = metadata.get(name, {}).get(key, "0")
    return int(text) if text.isascii() and text.isdecimal() else 0


class Topic(NamedTuple):
    """A topic of a record: its name, that of its schema, and the schema in JSON."""

    name: str
    schema_name: str
    schema: bytes


class Attachment(NamedTuple):
    """A file within a record."""

    name: str
    media_type: str
    data: bytes


class _Chunk(NamedTuple):
    """The place and the content of a chunk, or of messages that follow each other without one."""

    offset: int
    length: int
    first: int
    last: int
    channels: frozenset[int]
    packed: bool


class Gap(NamedTuple):
    """Where messages of a record are missing.

    Args:
        sequence: The number of the last message before it; -1 where there is none.
        since: The time of that, None where there is none.
        until: The time of the first message behind it.
    """

    sequence: int
    since: int | None
    until: int


class Hole(NamedTuple):
    """Bytes of a file that cannot be read, between others that can.

    Args:
        place: Where they begin.
        size: How many there are.
        reason: Why.
        lost: How many messages were in them, None where that is not known.
        since: The time of the last message before them, if any.
        until: The time of the first one behind them, if any.
    """

    place: int
    size: int
    reason: str
    lost: int | None = None
    since: int | None = None
    until: int | None = None


class _Torn(Exception):
    """A file cannot be read from here on; its text is why."""


class _Damaged(_Torn):
    """A record of a file cannot be read; its text is why."""


class Part:
    """One file of a record: whole by its index, else read through once.

    Args:
        path: The path.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
        self.damaged_files: list[str] = []
        """Names of attached files that are damaged, and so not among the others."""
        self.topics: dict[int, Topic] = {}
        self.chunks: list[_Chunk] = []
        self.counts: Counter[str] = Counter()
        self.first: int | None = None
        self.last: int | None = None
        """The numbers of the first message and of the last one."""
        self.gaps = 0
        """How many numbers between them no message has."""
        self.gap: Gap | None = None
        """The first place at which numbers are left out."""
        self.latest: int | None = None
        """The time of the last message."""
        self.holes: list[Hole] = []
        self.torn: str | None = None
        self.doubtful = False
        """Whether a byte is damaged, and it is not known which."""
        self.grows = False
        self.whole = 0
        """Bytes from the start that were read, to the end or to the tear, holes among them."""
        self.size = 0
        self._schemas: dict[int, tuple[str, bytes]] = {}
        self._decompress: dict[str, Callable[[bytes, int], bytes]] = {}
        self._damaged: list[Hole] = []
        self._places: list[int] | None = None
        self._attached: dict[int, str] = {}
        self._indices: list[tuple[int, bytes]] = []
        try:
            if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
                raise FormatError("this is a pipe or a device, not a file: save its content to a file first", file=path)
            with path.open("rb") as file:
                self.size = os.fstat(file.fileno()).st_size
                start = file.read(len(MAGIC))
                if start != MAGIC:
                    what = "is empty" if not start else "is not an MCAP file, so it cannot be a record"
                    raise FormatError(f"the file {what}", file=path)
                try:
                    if not self._take_by_index(file):
                        file.seek(len(MAGIC))
                        self._scan(file)
                except _Torn as torn:
                    self.grows = _is_written(file)
                    why = "it is still being written" if self.grows else torn
                    self.torn = f"{why}, at byte {self.whole:,} of {self.size:,}"
                self._close_holes(None)
        except FileNotFoundError:
            raise FormatError("there is no such file", file=path) from None
        except IsADirectoryError:
            raise FormatError("this is a folder, not a file", file=path) from None
        except OSError as error:
            raise FormatError(f"the file cannot be read: {error.strerror}", file=path) from None

    def _scan(self, file: IO[bytes]) -> None:
        crc = zlib.crc32(MAGIC)
        self.whole = len(MAGIC)
        while True:
            start = file.read(_RECORD.size)
            if len(start) < _RECORD.size:
                raise _Torn("it ends without its summary")
            kind, length = _RECORD.unpack(start)
            end = self.whole + _RECORD.size + length
            try:
                if not 0 < kind <= _LAST:
                    raise _Damaged("there is no record")
                if end > self.size:
                    raise _Damaged("a record is cut off")
                content = file.read(length)
                if kind != _DATA_END:
                    crc = zlib.crc32(content, zlib.crc32(start, crc))
                    self._take(kind, content)
            except (struct.error, IndexError, UnicodeDecodeError):
                end = self._resume(file, end, _Damaged("a record is damaged"))
            except _Damaged as damage:
                end = self._resume(file, end, damage)
            else:
                if kind == _DATA_END:
                    self._check_end(file, content, crc)
                    return
            self.whole = end

    def _resume(self, file: IO[bytes], end: int, damage: _Damaged) -> int:
        """Go on behind a damaged record, which claims to end there; return where.

        Raises:
            _Torn: If nothing that can be read follows.
        """
        places = self._places_by_summary(file)
        kind, length = 0, 0
        if end + _RECORD.size <= self.size:
            file.seek(end)
            kind, length = _RECORD.unpack(file.read(_RECORD.size))
        if not (0 < kind <= _LAST and length <= self.size - end - _RECORD.size):  # no record may begin there
            behind = [place for place in places if place > self.whole]
            found = min(behind) if behind else self._find_chunk(file, self.whole + 1)
            if found is None:
                raise _Torn(str(damage)) from None
            end = found
        file.seek(end)
        reason = str(damage)
        if self.whole in self._attached:
            self.damaged_files.append(self._attached[self.whole])
            reason = f"the attached file {self._attached[self.whole]!r} is damaged"
        self._damaged.append(Hole(self.whole, end - self.whole, reason))
        return end

    def _places_by_summary(self, file: IO[bytes]) -> list[int]:
        """Return where chunks, metadata, attached files and the end of the data are, as a sound summary has it.

        Schemas and topics of damaged chunks, and names of damaged attached files, are taken from there, too.
        """
        if self._places is not None:
            return self._places
        self._places = []
        footer = _RECORD.size + 20
        at = self.size - len(MAGIC) - footer
        file.seek(max(at, 0))
        ending = file.read(footer + len(MAGIC))
        if at < 0 or not ending.endswith(MAGIC) or _RECORD.unpack_from(ending) != (_FOOTER, 20):
            return []
        begin, _, crc = struct.unpack_from("<QQI", ending, _RECORD.size)
        if not 0 < begin <= at:
            return []
        file.seek(begin)
        summary = file.read(at - begin)
        if crc and zlib.crc32(ending[: footer - 4], zlib.crc32(summary)) != crc:
            return []
        position = 0
        with suppress(struct.error, IndexError, UnicodeDecodeError):
            while position < len(summary):
                kind, length = _RECORD.unpack_from(summary, position)
                content = summary[position + _RECORD.size : position + _RECORD.size + length]
                self._describe(kind, content)
                if kind in _PLACES:
                    self._places += struct.unpack_from("<Q", content, _PLACES[kind])
                if kind == _ATTACHMENT_INDEX:
                    self._attached[self._places[-1]], _ = _string(content, 40)
                elif crc and kind in {_CHUNK_INDEX, _STATISTICS}:
                    self._indices.append((kind, content))
                position += _RECORD.size + length
        self._places.append(begin - _RECORD.size - 4)
        return self._places

    def _take_by_index(self, file: IO[bytes]) -> bool:
        """Take in a file of ours by its index; return whether its data has its checksum, and all numbers.

        A checksum is had at a gigabyte a second, so that nothing is taken unseen: no byte is damaged, no number is left
        out, and the index says the rest.
        """
        places = self._places_by_summary(file)
        if not self._indices:
            return False
        end = places.pop()
        file.seek(0)
        start = file.read(min(end, 1_000))
        crc, left = zlib.crc32(start), end - len(start)
        while left > 0 and (block := file.read(min(left, _BLOCK))):
            crc, left = zlib.crc32(block, crc), left - len(block)
        if file.read(_RECORD.size + 4) != _RECORD.pack(_DATA_END, 4) + struct.pack("<I", crc):
            return self._forget()
        try:
            _, length = _RECORD.unpack_from(start, len(MAGIC))
            self._take(_HEADER, start[len(MAGIC) + _RECORD.size :][:length])
            total = self._take_indices(file)
        except (_Damaged, FormatError, struct.error, LookupError, ValueError, OverflowError, MemoryError):
            return self._forget()
        if not self.library.startswith("mdm/") or self.first is None or self.last is None:
            return self._forget()
        if (self.last - self.first + 1) % 2**32 != total % 2**32 or (self.number == 0 and self.first):
            return self._forget()
        self.whole = self.size
        return True

    def _take_indices(self, file: IO[bytes]) -> int:
        """Take in chunks, counts and the rest by their indices; return how many messages there are."""
        total = 0
        for kind, content in self._indices:
            if kind == _STATISTICS:
                (total,) = struct.unpack_from("<Q", content)
                (length,) = struct.unpack_from("<I", content, 42)
                for channel, count in struct.iter_unpack("<HQ", content[46 : 46 + length]):
                    self.counts[self.topics[channel].name] += count
            else:
                first, last, place, size, length = struct.unpack_from("<QQQQI", content)
                channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", content[36 : 36 + length]))
                if not channels <= set(self.topics):
                    raise IndexError
                self.chunks.append(_Chunk(place + _RECORD.size, size - _RECORD.size, first, last, channels, True))
        chunks = {chunk.offset - _RECORD.size for chunk in self.chunks}
        for place in sorted(set(self._places or ()) - chunks):
            file.seek(place)
            self.whole = place
            kind, length = _RECORD.unpack(file.read(_RECORD.size))
            self._take(kind, file.read(length))
        filled = [chunk for chunk in self.chunks if chunk.channels]
        for chunk in filled[:1] + filled[-1:]:
            numbers = [each[1:3] for each in self.messages(None, chunk.first, chunk.last + 1)]
            self.first = numbers[0][1] if self.first is None else self.first
            self.latest, self.last = numbers[-1]
        return total

    def _forget(self) -> bool:
        """Forget all that was taken in by the index."""
        self.library, self.first, self.last, self.latest = "", None, None, None
        for taken in (self.metadata, self.attachments, self.chunks, self.counts, self.topics, self._attached):
            taken.clear()
        self._indices.clear()
        self._places = None
        return False

    def _find_chunk(self, file: IO[bytes], place: int) -> int | None:
        """Return where the next chunk begins whose checksum holds, from a place on."""
        while place + _START_SIZE <= self.size:
            file.seek(place)
            block = file.read(_BLOCK)
            for match in _CHUNK_START.finditer(block):
                start = place + match.start()
                _, length = _RECORD.unpack_from(block, match.start())
                if length <= self.size - start - _RECORD.size and self._is_chunk(file, start, length):
                    return start
            place += max(len(block) - _START_SIZE, 1)
        return None

    def _is_chunk(self, file: IO[bytes], place: int, length: int) -> bool:
        file.seek(place + _RECORD.size)
        content = file.read(length)
        try:
            if content[24:28] == bytes(4):
                return False  # without a checksum any bytes may look like one
            self.unpack(content)
        except (_Damaged, struct.error, IndexError, UnicodeDecodeError):
            return False
        return True

    def _close_holes(self, next_message: tuple[int, int] | None) -> None:
        """Describe the damage since the last sound chunk: lost messages, and the time of the next one, if any."""
        if self._damaged:
            reason = " and ".join(dict.fromkeys(hole.reason for hole in self._damaged))
            size = sum(hole.size for hole in self._damaged)
            lost, until = (None, None) if next_message is None else next_message
            self.holes.append(Hole(self._damaged[0].place, size, reason, lost, self.latest, until))
            self._damaged.clear()

    def _check_end(self, file: IO[bytes], content: bytes, crc: int) -> None:
        """Check the end of the file, behind the data; no message is there."""
        rest = file.read()
        if content not in {bytes(4), struct.pack("<I", crc)} and not (self.holes or self._damaged):
            self._find_damaged_index(file)
            self.doubtful = not self.holes
        if not rest.endswith(MAGIC) or len(rest) < len(MAGIC) + 4:
            raise _Torn("its summary is cut off")
        checked, (told,) = rest[: -len(MAGIC) - 4], struct.unpack_from("<I", rest, len(rest) - len(MAGIC) - 4)
        if told and zlib.crc32(checked) != told:
            raise _Torn("its summary is damaged")
        self.whole = self.size

    def _find_damaged_index(self, file: IO[bytes]) -> None:
        """Note the indices of messages that differ from the messages of their chunks, none of which is lost by that."""
        for chunk in self.chunks:
            file.seek(chunk.offset)
            data = self.unpack(file.read(chunk.length)) if chunk.packed else b""
            told: dict[int, set[bytes]] = {}
            position = 0
            while position < len(data):
                kind, length = _RECORD.unpack_from(data, position)
                if kind == _MESSAGE:
                    _, _, channel, _, stamp, _ = _STAMPED.unpack_from(data, position)
                    told.setdefault(channel, set()).add(struct.pack("<QQ", stamp, position))
                position += _RECORD.size + length
            while (place := file.tell()) + _RECORD.size <= self.size:
                kind, length = _RECORD.unpack(file.read(_RECORD.size))
                if kind != _MESSAGE_INDEX:
                    break
                content = file.read(length)
                entries = {content[start : start + 16] for start in range(6, length, 16)}
                channel, size = int.from_bytes(content[:2], "little"), int.from_bytes(content[2:6], "little")
                if entries != told.get(channel) or size != length - 6:
                    reason = "an index of messages is damaged"
                    self.holes.append(Hole(place, _RECORD.size + length, reason, 0, chunk.last, chunk.last))

    def _take(self, kind: int, content: bytes) -> None:
        if kind == _CHUNK:
            self._take_records(self.unpack(content), len(content), packed=True)
        elif kind == _HEADER:
            _, position = _string(content, 0)
            self.library, _ = _string(content, position)
        elif kind == _METADATA:
            name, position = _string(content, 0)
            self.metadata[name] = _mapping(content, position)
        elif kind == _ATTACHMENT:
            self._take_attachment(content)
        elif kind == _MESSAGE:
            data = _RECORD.pack(kind, len(content)) + content
            self._take_records(data, len(data), packed=False)
        elif kind in {_SCHEMA, _CHANNEL}:
            self._describe(kind, content)

    def _take_attachment(self, content: bytes) -> None:
        (crc,) = struct.unpack_from("<I", content, len(content) - 4)
        if crc and crc != zlib.crc32(content[:-4]):
            self._attached[self.whole], _ = _string(content, 16)  # where no summary tells it
            raise _Damaged("an attached file is damaged")
        name, position = _string(content, 16)
        media_type, position = _string(content, position)
        (length,) = struct.unpack_from("<Q", content, position)
        position += 8
        if position + length != len(content) - 4:
            raise _Damaged("an attached file is damaged")
        self.attachments.append(Attachment(name, media_type, content[position : position + length]))

    def _take_records(self, data: bytes, length_in_file: int, *, packed: bool) -> None:
        """Take in the records of a chunk, which is packed, or a message that is in none."""
        position, size = 0, len(data)
        counts: Counter[int] = Counter()
        first, last, latest = 2**64, 0, self.latest
        begin, before, gaps, gap = self.first, self.last, self.gaps, self.gap
        next_message: tuple[int, int] | None = None
        while position < size:
            kind, length = _RECORD.unpack_from(data, position)
            if kind == _MESSAGE:
                _, _, channel, sequence, stamp, _ = _STAMPED.unpack_from(data, position)
                counts[channel] += 1
                first, last = min(first, stamp), max(last, stamp)
                if before is None and self.number == 0:
                    before = -1
                lost = 0 if before is None else _between(before, sequence)
                if begin is None:
                    begin = sequence
                else:
                    gaps += lost
                if lost and before is not None and gap is None:
                    gap = Gap(before, latest, stamp)
                next_message = next_message or (lost, stamp)
                before, latest = sequence, stamp
            else:
                self._describe(kind, data[position + _RECORD.size : position + _RECORD.size + length])
            position += _RECORD.size + length
        what = "a chunk is damaged" if packed else "a message is damaged"
        if position != size:
            raise _Damaged(what)
        if not set(counts) <= set(self.topics):
            raise _Damaged(what if not self._damaged else "the names of topics are damaged")
        for channel, count in counts.items():
            self.counts[self.topics[channel].name] += count
        if next_message is not None:
            self._close_holes(next_message)
        self.first, self.last, self.latest, self.gaps, self.gap = begin, before, latest, gaps, gap
        offset = self.whole + (_RECORD.size if packed else 0)
        self._add(_Chunk(offset, length_in_file, first, last, frozenset(counts), packed))

    def _add(self, chunk: _Chunk) -> None:
        """Take note of a chunk; messages without one that follow each other are read together."""
        before = self.chunks[-1] if self.chunks else chunk
        behind = before.offset + before.length == chunk.offset and before.length < _TOGETHER
        if behind and not (before.packed or chunk.packed):
            first, last = min(before.first, chunk.first), max(before.last, chunk.last)
            length, channels = before.length + chunk.length, before.channels | chunk.channels
            self.chunks[-1] = _Chunk(before.offset, length, first, last, channels, packed=False)
        else:
            self.chunks.append(chunk)

    @property
    def record(self) -> str | None:
        """Which record it is of, where that was split."""
        return self.metadata.get(PART, {}).get("record")

    @property
    def checksum(self) -> str:
        """The size and the checksum of all of its bytes."""
        crc = 0
        with self.path.open("rb") as file:
            while block := file.read(_BLOCK):
                crc = zlib.crc32(block, crc)
            return f"{file.tell()}-{crc:08x}"

    @property
    def number(self) -> int:
        """Which file of the record it is, from 0."""
        return number_in(self.metadata, PART, "number")

    def unpack(self, content: bytes) -> bytes:
        """Return the records of a chunk, checked."""
        _, _, size, crc = struct.unpack_from("<QQQI", content)
        compression, position = _string(content, 28)
        (length,) = struct.unpack_from("<Q", content, position)
        data = content[position + 8 :]
        if len(data) != length or size > _LARGEST:
            raise _Damaged("a chunk is damaged")
        if compression:
            if compression not in COMPRESSIONS:
                raise _Damaged("a chunk is damaged")
            if compression not in self._decompress:
                self._decompress[compression] = decompressor(compression)
            try:
                data = self._decompress[compression](data, size)
            except ValueError:
                raise _Damaged("a chunk is damaged") from None
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            raise _Damaged("a chunk is damaged")
        return data

    def _describe(self, kind: int, content: bytes) -> None:
        """Take in a schema or a channel; others have nothing for a reader of messages."""
        if kind == _SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, position = _string(content, 2)
            _, position = _string(content, position)
            (length,) = struct.unpack_from("<I", content, position)
            self._schemas[number] = name, content[position + 4 : position + 4 + length]
        elif kind == _CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            name, _ = _string(content, 4)
            self.topics[number] = Topic(name, *self._schemas.get(schema, ("", b"")))

    def messages(self, names: set[str] | None, since: int, until: float) -> Iterator[tuple[str, int, int, bytes]]:
        """Yield topic, time, sequence and data of messages."""
        wanted = {number: topic.name for number, topic in self.topics.items() if names is None or topic.name in names}
        with self.path.open("rb") as file:
            for chunk in self.chunks:
                if chunk.last < since or chunk.first >= until or wanted.keys().isdisjoint(chunk.channels):
                    continue
                file.seek(chunk.offset)
                content = file.read(chunk.length)
                try:
                    if len(content) < chunk.length:
                        raise _Damaged("a record is cut off")
                    data = self.unpack(content) if chunk.packed else content
                    position, size = 0, len(data)
                    while position < size:
                        kind, length = _RECORD.unpack_from(data, position)
                        end = position + _RECORD.size + length
                        if kind == _MESSAGE:
                            _, _, channel, sequence, stamp, _ = _STAMPED.unpack_from(data, position)
                            if channel in wanted and since <= stamp < until:
                                yield wanted[channel], stamp, sequence, data[position + _STAMPED.size : end]
                        position = end
                except (_Torn, struct.error, IndexError, UnicodeDecodeError):
                    raise FormatError("the file was changed while it was read", file=self.path) from None


def _between(before: int, after: int) -> int:
    """Return how many numbers are left out between those of two messages, which begin again after 32 bits."""
    step = (after - before) % 2**32
    if not 0 < step < 2**31:
        raise _Torn("a chunk is not in its place")
    return step - 1


def _string(content: bytes, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", content, position)
    end = position + 4 + length
    if end > len(content):
        raise IndexError
    return content[position + 4 : end].decode(), end


def _mapping(content: bytes, position: int) -> dict[str, str]:
    (length,) = struct.unpack_from("<I", content, position)
    position, end = position + 4, position + 4 + length
    if end != len(content):
        raise IndexError
    found = {}
    while position < end:
        key, position = _string(content, position)
        found[key], position = _string(content, position)
    return found


def _is_written(file: IO[bytes]) -> bool:
    """Whether a file is being written: its recorder still holds its lock."""
    with suppress(ImportError):
        import fcntl  # noqa: PLC0415 - not everywhere

        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(file, fcntl.LOCK_UN)
    return False


_MODULES = {"zstd": ("compression.zstd", "backports.zstd", "zstandard"), "lz4": ("lz4.frame",)}
COMPRESSIONS = frozenset(_MODULES)
"""The names that MCAP has for them."""


def decompressor(compression: str) -> Callable[[bytes, int], bytes]:
    """Return a function that decompresses a frame to a size.

    Its result is at most a byte longer, for all that the frame claims to hold. It raises `ValueError` where that is
    no whole frame.

    Args:
        compression: Its name, as MCAP has it.

    Raises:
        Error: If there is no module for it.
    """
    for name in _MODULES[compression]:
        try:
            module: Any = importlib.import_module(name)
        except ImportError:
            continue
        return partial(_decompressed, name, module)
    raise Error(
        f"this record is compressed by {compression}, which needs a module for it: pip install mcap threadpoolctl"
    )


def _decompressed(name: str, module: Any, data: bytes, size: int) -> bytes:
    is_lz4 = name == "lz4.frame"
    failures = (RuntimeError if is_lz4 else module.ZstdError, EOFError, MemoryError)
    try:
        frame = module.LZ4FrameDecompressor() if is_lz4 else module.ZstdDecompressor()
        if name == "zstandard":
            with frame.stream_reader(data) as reader:
                return bytes(reader.read(size + 1))
        return bytes(frame.decompress(data, size + 1))
    except failures as error:
        raise ValueError(str(error)) from None
