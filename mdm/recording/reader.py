"""Reads records: every message that was written and is whole, of a file or of those into which a run was split."""

from __future__ import annotations

import importlib.util
import math
import typing
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np

from mdm import messages
from mdm.errors import Error, FormatError
from mdm.recording import schemas
from mdm.recording.part import PART, SYSTEM, Gap, Part, number_in
from mdm.recording.process import File
from mdm.stimuli import Said, Stimulus
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

FORMAT = 1
"""The newest format of records that is known here."""

_HEAD, _END, _REPAIRED = "mdm", "mdm.end", "mdm.repaired"
_STRUCTS = {
    each: kind
    for each in messages.__all__
    if isinstance(kind := getattr(messages, each), type) and issubclass(kind, messages.Message)
}


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
        metadata: The named strings. ``mdm`` has the head: the format, versions, clock and epoch; ``ensemble NAME``
            the digests, names and seed of an ensemble.
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
        damaged_files: The names of attached files that are damaged, or were when the record was repaired.

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
        self._files = [_checked(Part(each)) for each in paths]
        if len(paths) == 1:
            self._files += _following(self._files[0])
        for before, file in pairwise(self._files):
            if before.record != file.record:
                raise FormatError(f"this file is of another record than {before.path}", file=file.path)
            if file.number != before.number + 1:
                raise FormatError("give the files of a record in their order, without a gap", file=file.path)
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
        self.number = self._files[0].number
        self.lost = self._lost()
        self.gap = self._gap()
        self.damage = tuple(self._sentences())
        left_out = self.metadata.get(_REPAIRED, {}).get("files", "").splitlines()
        self.damaged_files = [*left_out, *(name for file in self._files for name in file.damaged_files)]

    @property
    def flaws(self) -> tuple[str, ...]:
        """The flaws of the record, a sentence each: where it is torn or damaged, and losses without a place."""
        told = [] if self.torn is None else [self.torn if self.grows else f"{self.torn}: what follows is not there"]
        told += self.damage
        left_out = [name for name in self.damaged_files if repr(name) not in "".join(self.damage)]
        told += [f"{self.path}: the attached file {name!r} was damaged, and is not there" for name in left_out]
        if self.lost > sum(hole.lost or 0 for file in self._files for hole in file.holes):
            told.append(f"{self.path}: {self.lost:,} messages are lost")
        return tuple(told)

    @property
    def head(self) -> dict[str, str]:
        """The metadata ``mdm``, with those of the description of a program's run."""
        told = [each for file in self._files for name, each in file.metadata.items() if name == SYSTEM]
        return self.metadata[_HEAD] | (told[-1] if told else {})

    @property
    def cannot(self) -> tuple[str, ...]:
        """The parts of a program's run that the record does not hold, a sentence each."""
        try:
            return msgspec.json.decode(self.head.get("cannot", "[]"), type=tuple[str, ...])
        except msgspec.MsgspecError:
            return ()

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
    def checksums(self) -> tuple[str, ...]:
        """Of each file its size and the checksum of all of its bytes."""
        return tuple([file.checksum for file in self._files])

    @property
    def unread(self) -> int:
        """Bytes that could not be read, since a file is torn or damaged."""
        return sum(file.size - file.whole + sum(hole.size for hole in file.holes) for file in self._files)

    def _missing(self) -> str | None:
        """Return which file of a split record is not there, None where the last one that is there has the run's end."""
        first, last = self._files[0], self._files[-1]
        if number := first.number:
            return f"{first.path}: this is file {number + 1} of a split record alone: give the first one"
        if PART not in last.metadata or not last.metadata.keys().isdisjoint((_END, _REPAIRED)):
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
        lost = number_in(self.metadata, _END, "lost")
        if "messages" in end and not self.number:
            lost += max(0, number_in(self.metadata, _END, "messages") - self.counts.total())
        return max(gaps, lost)

    def _gap(self) -> Gap | None:
        """Return the first place at which numbers are left out, within files or between them."""
        before: Part | None = None
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
            if file.doubtful:
                yield f"{file.path}: its data has not its checksum: a byte is damaged where no chunk's checksum tells"
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
        for topic, time, sequence, data in self.raw(topics, since, until):
            yield Recorded(topic, time, sequence, self.decode(topic, data))

    def decode(self, topic: str, data: bytes) -> Any:
        """Return a message of `raw`, of a topic: a struct, or plain JSON where its type is unknown."""
        return self._decoding.decode(self.topics[topic].schema_name, data)

    def raw(
        self, topics: Iterable[str] | None = None, since: int | None = None, until: int | None = None
    ) -> Iterator[tuple[str, int, int, bytes]]:
        """Yield the same as `messages` as tuples, messages as the bytes of their JSON."""
        names = None if topics is None else set(topics)
        for name in names or ():
            if name not in self.topics:
                raise Error(f"{self.path}: there is no topic {name!r}; there are {', '.join(self.topics)}")
        latest = float("inf") if until is None else until
        for file in self._files:
            yield from file.messages(names, since or 0, latest)


def _checked(file: Part) -> Part:
    """Check that a file is a record of ours, of a format that is known."""
    head = file.metadata.get(_HEAD)
    if head is None:
        if file.holes:
            raise FormatError(f"the head of the record is damaged ({file.holes[0].reason})", file=file.path)
        if not file.library.startswith("mdm/") and file.library:
            raise FormatError(f"this file of another program ({file.library}) is not a record of mdm", file=file.path)
        raise FormatError("the file ends before the head of the record: nothing of the run is in it", file=file.path)
    version = head.get("format", "")
    if not version.isascii() or not version.isdecimal():
        raise FormatError(f"the record's format is not a number: {version!r}", file=file.path)
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


def _following(first: Part) -> Iterator[Part]:
    """Yield the files of the same record that follow one, as they are named."""
    if PART not in first.metadata or first.number:
        return
    number = 1
    while True:
        path = _part(first.path, number)
        if not path.is_file():
            return
        try:
            file = _checked(Part(path))
        except FormatError:  # of something else, or torn in its head
            return
        if file.record != first.record or file.number != number:
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


class Decoding:
    """Decodes messages as structs, by the names of their schemas.

    Args:
        types: Types by the names of schemas, beside those of `mdm.messages` and the stimuli.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        kinds: dict[str, Any] = {schemas.name(kind): kind for kind in _STRUCTS.values()}
        kinds |= {schemas.name(Stimulus): Stimulus, **types}
        self._kinds = kinds
        self._decoders: dict[str, msgspec.json.Decoder[Any]] = {}

    def decode(self, schema_name: str, data: bytes) -> Any:
        """Return a message: a struct, or plain JSON where its type is unknown or has other fields."""
        kind = self._kinds.get(schema_name)
        if kind is None:
            return msgspec.json.decode(data)
        decoder = self._decoders.get(schema_name)
        if decoder is None:
            decoder = self._decoders[schema_name] = msgspec.json.Decoder(kind, dec_hook=_restore)
        try:
            message = decoder.decode(data)
        except msgspec.ValidationError:
            return _converted(msgspec.json.decode(data), kind)
        if isinstance(message, Said) and message.type in _STRUCTS:
            said = _converted(message.message, _STRUCTS[message.type])
            return msgspec.structs.replace(message, message=said)
        return message


def _restore(kind: Any, value: Any) -> Any:
    """Return an array from a list, in which JSON has null for what is no number."""
    if (typing.get_origin(kind) or kind) is np.ndarray:
        array = np.array([math.nan if each is None else each for each in value], dtype=float)
        array.flags.writeable = False
        return array
    raise NotImplementedError


def _converted(value: Any, kind: Any) -> Any:
    """Return a struct made of plain JSON; without one that fits, the value as it is.

    JSON has null for numbers that are none, or infinite: they are restored as not a number.
    """
    try:
        return msgspec.convert(value, kind, dec_hook=_restore)
    except msgspec.ValidationError:
        pass
    if isinstance(value, dict) and isinstance(kind, type):
        numbers = {field for field, hint in typing.get_type_hints(kind).items() if hint is float}
        restored = {key: math.nan if each is None and key in numbers else each for key, each in value.items()}
        try:
            return msgspec.convert(restored, kind, dec_hook=_restore)
        except msgspec.ValidationError:
            pass
    return value


def repair(record: Record, file: IO[bytes]) -> int:
    """Write all that can be read of a record to one file; return the number of messages.

    Args:
        record: The record; of a split one, all files become one.
        file: A file that is open for writing bytes.

    Raises:
        Error: If mcap is not installed.
    """
    if importlib.util.find_spec("mcap") is None:
        raise Error("records need mcap: pip install mcap threadpoolctl")
    written = File(file, f"mdm/{__version__}")
    for name, mapping in record.metadata.items():
        if name == "mdm.file":  # a whole of its own, which other files do not follow
            written.metadata(name, {"record": f"{mapping.get('record', '')} repaired", "number": "0"})
        else:
            written.metadata(name, mapping)
    for attachment in record.attachments:
        if attachment.name != "mdm.summary":  # of all that there was
            written.attach(*attachment)
    topics = {name: written.topic(*topic) for name, topic in record.topics.items()}
    count = 0
    for topic, time, sequence, data in record.raw():
        written.add_message(topics[topic], time, data, time, sequence)
        count += 1
    if record.torn is not None or record.damage:
        facts = {"torn": record.torn or "", "damage": "\n".join(record.damage), "unread": str(record.unread)}
        facts["files"] = "\n".join(record.damaged_files)
        written.metadata("mdm.repaired", {name: fact for name, fact in facts.items() if fact})
    written.finish()
    return count
