"""Reads records: every message that was written and is whole, and where a torn file ends.

A file is read from its start, record by record as the MCAP specification lays them out, so that what its process could
not complete is read as well. Messages are in chunks with a checksum, and are taken from chunks whose checksum holds
alone. Behind damage it goes on where the next record begins: as the damaged one tells, else as the summary does, else
at the next bytes that are a chunk whose checksum holds. The numbers of messages tell how many are lost.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections import Counter
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from mdm.errors import Error, FormatError
from mdm.recording.compression import decompressor
from mdm.recording.decoding import Decoding
from mdm.recording.process import MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

__all__ = ["FORMAT", "Attachment", "Gap", "Record", "Recorded", "Topic"]

FORMAT = 1
"""The newest format of records that is known here."""

_HEAD, _END, _REPAIRED = "mdm", "mdm.end", "mdm.repaired"
_FILE = "mdm.file"

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = range(1, 8)
_ATTACHMENT, _METADATA, _DATA_END, _LAST = 9, 12, 15, 15
_PLACES = {8: 16, 10: 0, 13: 0}
"""Where the indices of chunks, attachments and metadata, in a summary, tell the place of one."""
_RECORD = struct.Struct("<BQ")
_STAMPED = struct.Struct("<BQHIQQ")
"""Of a message: its kind, length, channel, sequence and two times."""
_LARGEST = 1 << 30
"""Bytes of a chunk, at most: ours have 256 kB, or a message."""
_BLOCK = 1 << 22
_CHUNK_START = re.compile(rb"\x06(?=[\s\S]{5}\x00{3}[\s\S]{28}(?:\x00{4}|\x04\x00{3}zstd)[\s\S]{8})")
"""How a chunk begins, which may be anything else as well: a length below 2**40, and a compression."""
_START_SIZE = 9 + 28 + 8 + 8


class Recorded(NamedTuple):
    """A message of a record.

    Args:
        topic: The topic's name.
        time: The time of its turn, in nanoseconds of the record's clock.
        sequence: Its number in the record. Where numbers are left out, messages were lost.
        message: The message: a struct where its type is known, else as JSON has it.
    """

    topic: str
    time: int
    sequence: int
    message: Any


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
    """Where a chunk is, and what is in it."""

    offset: int
    length: int
    first: int
    last: int
    channels: frozenset[int]


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


class _Hole(NamedTuple):
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


class _File:
    """One file of a record, read through once.

    Args:
        path: The path.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
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
        self.holes: list[_Hole] = []
        self.torn: str | None = None
        self.grows = False
        self.whole = 0
        """Bytes from the start that were read, to the end or to the tear, holes among them."""
        self.size = 0
        self._schemas: dict[int, tuple[str, bytes]] = {}
        self._decompress: Callable[[bytes, int], bytes] | None = None
        self._damaged: list[_Hole] = []
        self._places: list[int] | None = None
        try:
            if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
                raise FormatError("this is a pipe or a device, not a file: save its content to a file first", file=path)
            with path.open("rb") as file:
                self.size = os.fstat(file.fileno()).st_size
                start = file.read(len(MAGIC))
                if start != MAGIC:
                    what = "is empty" if not start else "is no MCAP file, and so no record"
                    raise FormatError(f"the file {what}", file=path)
                try:
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
        if not self._is_record(file, end):
            behind = [place for place in places if place > self.whole]
            found = min(behind) if behind else self._find_chunk(file, self.whole + 1)
            if found is None:
                raise _Torn(str(damage)) from None
            end = found
        file.seek(end)
        self._damaged.append(_Hole(self.whole, end - self.whole, str(damage)))
        return end

    def _is_record(self, file: IO[bytes], place: int) -> bool:
        """Whether a record may begin at a place."""
        if place + _RECORD.size > self.size:
            return False
        file.seek(place)
        kind, length = _RECORD.unpack(file.read(_RECORD.size))
        return bool(0 < kind <= _LAST and length <= self.size - place - _RECORD.size)

    def _places_by_summary(self, file: IO[bytes]) -> list[int]:
        """Return where chunks, metadata, attached files and the end of the data are, as a sound summary has it.

        Schemas and topics of damaged chunks are taken from there, too.
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
        if zlib.crc32(ending[: footer - 4], zlib.crc32(summary)) != crc:
            return []
        position = 0
        with suppress(struct.error, IndexError, UnicodeDecodeError):
            while position < len(summary):
                kind, length = _RECORD.unpack_from(summary, position)
                content = summary[position + _RECORD.size : position + _RECORD.size + length]
                self._describe(kind, content)
                if kind in _PLACES:
                    self._places += struct.unpack_from("<Q", content, _PLACES[kind])
                position += _RECORD.size + length
        self._places.append(begin - _RECORD.size - 4)
        return self._places

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
        try:
            self.unpack(file.read(length))
        except (_Damaged, struct.error, IndexError, UnicodeDecodeError):
            return False
        return True

    def _close_holes(self, next_message: tuple[int, int] | None) -> None:
        """Tell of the damage since the last sound chunk: lost messages, and the time of the next one, if any."""
        if self._damaged:
            reason = " and ".join(dict.fromkeys(hole.reason for hole in self._damaged))
            size = sum(hole.size for hole in self._damaged)
            lost, until = (None, None) if next_message is None else next_message
            self.holes.append(_Hole(self._damaged[0].place, size, reason, lost, self.latest, until))
            self._damaged.clear()

    def _check_end(self, file: IO[bytes], content: bytes, crc: int) -> None:
        """Check what follows the data; no message is there."""
        rest = file.read()
        if content != struct.pack("<I", crc) and not (self.holes or self._damaged):
            if content == bytes(4) or len(content) != 4:
                raise _Torn("its data has no checksum")
            raise _Torn("its data is damaged")
        if not rest.endswith(MAGIC):
            raise _Torn("its summary is cut off")
        checked, (told,) = rest[: -len(MAGIC) - 4], struct.unpack_from("<I", rest.rjust(12), len(rest) - 12)
        if zlib.crc32(checked) != told:
            raise _Torn("its summary is damaged")
        self.whole = self.size

    def _take(self, kind: int, content: bytes) -> None:
        if kind == _CHUNK:
            self._take_chunk(content)
        elif kind == _HEADER:
            _, position = _string(content, 0)
            self.library, _ = _string(content, position)
        elif kind == _METADATA:
            name, position = _string(content, 0)
            self.metadata[name] = _mapping(content, position)
        elif kind == _ATTACHMENT:
            self._take_attachment(content)
        elif kind == _MESSAGE:
            raise _Torn("a message is in no chunk")
        elif kind in {_SCHEMA, _CHANNEL}:
            self._describe(kind, content)

    def _take_attachment(self, content: bytes) -> None:
        (crc,) = struct.unpack_from("<I", content, len(content) - 4)
        if crc != zlib.crc32(content[:-4]):
            raise _Damaged("an attached file is damaged")
        name, position = _string(content, 16)
        media_type, position = _string(content, position)
        (length,) = struct.unpack_from("<Q", content, position)
        position += 8
        if position + length != len(content) - 4:
            raise _Damaged("an attached file is damaged")
        self.attachments.append(Attachment(name, media_type, content[position : position + length]))

    def _take_chunk(self, content: bytes) -> None:
        data = self.unpack(content)
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
                if before is None and self.is_first:
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
        if position != size:
            raise _Damaged("a chunk is damaged")
        if not set(counts) <= set(self.topics):
            raise _Damaged("a chunk is damaged" if not self._damaged else "the names of topics are damaged")
        for channel, count in counts.items():
            self.counts[self.topics[channel].name] += count
        if next_message is not None:
            self._close_holes(next_message)
        self.first, self.last, self.latest, self.gaps, self.gap = begin, before, latest, gaps, gap
        self.chunks.append(_Chunk(self.whole + _RECORD.size, len(content), first, last, frozenset(counts)))

    @property
    def is_first(self) -> bool:
        """Whether it is a whole record or the first file of one, in which messages are counted from 0 on."""
        return not _number(self.metadata, _FILE, "number")

    def unpack(self, content: bytes) -> bytes:
        """Return the records of a chunk, checked."""
        _, _, size, crc = struct.unpack_from("<QQQI", content)
        compression, position = _string(content, 28)
        (length,) = struct.unpack_from("<Q", content, position)
        data = content[position + 8 :]
        if len(data) != length or size > _LARGEST:
            raise _Damaged("a chunk is damaged")
        if compression == "zstd":
            if self._decompress is None:
                self._decompress = decompressor()
            try:
                data = self._decompress(data, size)
            except ValueError:
                raise _Damaged("a chunk is damaged") from None
        elif compression == "lz4":
            raise Error(f"{self.path}: its chunks are compressed by lz4: convert them to zstd by the program that did")
        elif compression:
            raise _Damaged("a chunk is damaged")
        if len(data) != size or zlib.crc32(data) != crc:
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
                try:
                    data = self.unpack(file.read(chunk.length))
                except (_Torn, struct.error):
                    raise FormatError("the file was changed while it was read", file=self.path) from None
                position, size = 0, len(data)
                while position < size:
                    kind, length = _RECORD.unpack_from(data, position)
                    end = position + _RECORD.size + length
                    if kind == _MESSAGE:
                        _, _, channel, sequence, stamp, _ = _STAMPED.unpack_from(data, position)
                        if channel in wanted and since <= stamp < until:
                            yield wanted[channel], stamp, sequence, data[position + _STAMPED.size : end]
                    position = end


def _between(before: int, after: int) -> int:
    """Return how many numbers are left out between those of two messages, which begin anew after 32 bits."""
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


class Record:
    """A record of a run: its head, and its messages in the order in which they were written.

    Args:
        path: The file; where the run was split, its first file, which finds those that follow, or any list of them.
        types: Types of messages by the names of their schemas, beside those of `mdm.messages` and of stimuli.

    Raises:
        FormatError: If a file is no MCAP file, no record, or of a newer format than is known here.

    Attributes:
        path: The path of the first file.
        paths: All files.
        metadata: The named strings. ``mdm`` has the head: the format, versions, clock and epoch; ``ensemble NAME`` what
            an ensemble was made of: digests, names, its seed.
        attachments: The attached files.
        topics: The topics by name.
        counts: How many messages each topic has.
        torn: Why and where the record cannot be read to its end, as a file that is cut off, or one of a split record
            that is missing; None for one that is complete.
        grows: Whether it is still being written.
        closed: Whether the run ended in order; False where its process was killed, None where the file's end is not
            there to tell.
        lost: How many messages are known to be missing: those that were dropped, and those in damaged bytes.
        gap: The first place at which messages are missing, None where none are, or only behind the last one.
        damage: Sentences on bytes that cannot be read though others behind them can: where, how many, and which
            messages are lost by it.

    Example::

        record = Record("run.mcap")
        for each in record.messages(["decisions"]):
            print(each.time, each.message.action_name)
    """

    def __init__(
        self, path: str | Path | Sequence[str | Path], *, types: Mapping[str, type[Any]] | None = None
    ) -> None:
        paths = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
        if not paths:
            raise Error("a record has at least one file")
        self._files = [_checked(_File(each)) for each in paths]
        if len(paths) == 1:
            self._files += _following(self._files[0])
        self._check_set()
        self._decoding = Decoding(types or {})
        self.path = paths[0]
        self.paths = [file.path for file in self._files]
        self.metadata = {name: values for file in self._files[::-1] for name, values in file.metadata.items()}
        self.attachments = list({each.name: each for file in self._files for each in file.attachments}.values())
        self.topics = {topic.name: topic for file in self._files for topic in file.topics.values()}
        self.counts: Counter[str] = sum((file.counts for file in self._files), Counter())
        self.torn = next((f"{file.path}: {file.torn}" for file in self._files if file.torn is not None), None)
        if self.torn is None and isinstance(path, str | Path):
            self.torn = self._missing()
        self.grows = any(file.grows for file in self._files)
        end = self.metadata.get(_END)
        self.closed = None if end is None else end.get("closed") == "yes"
        self.number = _number(self._files[0].metadata, _FILE, "number")
        self.lost = self._lost()
        self.gap = self._gap()
        self.damage = tuple(self._sentences())

    @property
    def head(self) -> dict[str, str]:
        """The metadata ``mdm``."""
        return self.metadata[_HEAD]

    @property
    def span(self) -> tuple[int, int] | None:
        """The first and the last time of messages in nanoseconds, None where there are none."""
        chunks = [chunk for file in self._files for chunk in file.chunks if chunk.channels]
        return (min(chunk.first for chunk in chunks), max(chunk.last for chunk in chunks)) if chunks else None

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self._files)

    @property
    def unread(self) -> int:
        """Bytes that could not be read, since a file is torn or damaged."""
        return sum(file.size - file.whole + sum(hole.size for hole in file.holes) for file in self._files)

    def _check_set(self) -> None:
        """Check that files are of one record, and follow each other."""
        for before, file in pairwise(self._files):
            if _record(before) != _record(file):
                raise FormatError(f"this file is of another record than {before.path}", file=file.path)
            if _number(file.metadata, _FILE, "number") != _number(before.metadata, _FILE, "number") + 1:
                raise FormatError("the files of a record are given in their order, without a gap", file=file.path)

    def _missing(self) -> str | None:
        """Return which file of a split record is not there, None where the last one that is there has the run's end."""
        first, last = self._files[0], self._files[-1]
        if number := _number(first.metadata, _FILE, "number"):
            return f"{first.path}: this is file {number + 1} of a split record alone: give the first one"
        if _FILE not in last.metadata or not last.metadata.keys().isdisjoint((_END, _REPAIRED)):
            return None
        return f"{_part(first.path, len(self._files))}: this file of the record is missing, or is of another record"

    def _lost(self) -> int:
        """Return how many numbers of messages are left out, or how many the end says."""
        gaps, before = 0, None if self.number else -1
        for file in self._files:
            if file.first is not None:
                gaps += file.gaps + (0 if before is None else (file.first - before - 1) % 2**32)
                before = file.last
        end = self.metadata.get(_END, {})
        lost = _number(self.metadata, _END, "lost")
        if "messages" in end and not self.number:
            lost += max(0, _number(self.metadata, _END, "messages") - self.counts.total())
        return max(gaps, lost)

    def _gap(self) -> Gap | None:
        """Return the first place at which numbers are left out, within files or between them."""
        before: _File | None = None
        for file in self._files:
            if file.first is None:
                continue
            if before is not None and before.last is not None and file.first != (before.last + 1) % 2**32:
                return Gap(before.last, before.latest, file.chunks[0].first)
            if file.gap is not None:
                return file.gap
            before = file
        return None

    def _sentences(self) -> Iterator[str]:
        """Yield a sentence on each hole."""
        span = self.span
        for file in self._files:
            for hole in file.holes:
                since = None if hole.since is None or span is None else f"{(hole.since - span[0]) / 1e9:.6f} s"
                until = None if hole.until is None or span is None else f"{(hole.until - span[0]) / 1e9:.6f} s"
                if hole.lost == 0:
                    lost = "no message is lost"
                elif since and until:
                    lost = f"between {since} and {until}"
                elif since:
                    lost = f"behind {since}"
                else:
                    lost = "before the first one that can be read" if until else "all that there were"
                if hole.lost:
                    lost = f"{hole.lost:,} messages are lost, {lost}"
                elif hole.lost is None:
                    lost = f"messages may be lost, {lost}"
                yield f"{file.path}: {hole.reason}, {hole.size:,} bytes at byte {hole.place:,}: {lost}"

    def messages(
        self, topics: Iterable[str] | None = None, since: int | None = None, until: int | None = None
    ) -> Iterator[Recorded]:
        """Yield messages in the order in which they were written.

        Args:
            topics: The names of topics; by default all.
            since: From this time on, in nanoseconds of the record's clock.
            until: Before this time.

        Raises:
            Error: If there is no such topic.
        """
        decode = self._decoding.decode
        schemas = {topic.name: topic.schema_name for topic in self.topics.values()}
        for topic, time, sequence, data in self.raw(topics, since, until):
            yield Recorded(topic, time, sequence, decode(schemas[topic], data))

    def raw(
        self, topics: Iterable[str] | None = None, since: int | None = None, until: int | None = None
    ) -> Iterator[tuple[str, int, int, bytes]]:
        """Yield what `messages` does as tuples, messages as the bytes of their JSON."""
        names = None if topics is None else set(topics)
        for name in names or ():
            if name not in self.topics:
                raise Error(f"{self.path}: there is no topic {name!r}; there are {', '.join(self.topics)}")
        latest = float("inf") if until is None else until
        for file in self._files:
            yield from file.messages(names, since or 0, latest)


def _record(file: _File) -> str | None:
    """Return which record a file is of."""
    return file.metadata.get(_FILE, {}).get("record")


def _number(metadata: Mapping[str, Mapping[str, str]], name: str, key: str) -> int:
    """Return a number of the metadata, 0 where there is none."""
    text = metadata.get(name, {}).get(key, "0")
    return int(text) if text.isascii() and text.isdecimal() else 0


def _checked(file: _File) -> _File:
    """Check that a file is a record of ours, of a format that is known."""
    head = file.metadata.get(_HEAD)
    if head is None:
        if file.holes:
            raise FormatError(f"the head of the record is damaged ({file.holes[0].reason})", file=file.path)
        if not file.library.startswith("mdm/") and file.library:
            raise FormatError(f"this file is of another program ({file.library}) and no record of mdm", file=file.path)
        raise FormatError("the file ends before the head of the record: nothing of the run is in it", file=file.path)
    version = head.get("format", "")
    if not version.isascii() or not version.isdecimal():
        raise FormatError(f"the record's format is no number: {version!r}", file=file.path)
    if int(version) > FORMAT:
        raise FormatError(
            f"the record has format {version}, of a newer mdm ({head.get('mdm', 'unknown')}): this one reads formats "
            f"up to {FORMAT}",
            file=file.path,
        )
    return file


def _part(first: Path, number: int) -> Path:
    """Return the further file of a split record of that number."""
    return first.with_name(f"{first.stem}-{number}{first.suffix}")


def _following(first: _File) -> Iterator[_File]:
    """Yield the files of the same record that follow one, as they are named."""
    if _FILE not in first.metadata or _number(first.metadata, _FILE, "number"):
        return
    number = 1
    while True:
        path = _part(first.path, number)
        if not path.is_file():
            return
        try:
            file = _checked(_File(path))
        except FormatError:  # of something else, or torn in its head
            return
        if _record(file) != _record(first) or _number(file.metadata, _FILE, "number") != number:
            return
        yield file
        number += 1


def records_of(folder: str | Path) -> dict[str, Record]:
    """Return the records in a folder by the names of their files; of one that was split, its first file stands for all.

    Raises:
        Error: If there are none.
        FormatError: If a file is no record.
    """
    found = {path.name: Record(path) for path in sorted(Path(folder).glob("*.mcap"))}
    records = {name: record for name, record in found.items() if not record.number}
    if not records:
        raise Error(f"{folder}: there are no records in this folder: mdm team up --record {folder} makes them")
    return records
