"""The process that writes a record: frames in by a pipe, a file out, and failures by a second pipe.

It runs apart from the robot, so that compression and slow disks cost the robot nothing, and so that the frames that it
has are kept where the robot's process is killed. `RecordWriter` runs this file, which loads neither numpy nor other
parts of the library. It has a session of its own, and ends when the pipe does: signals that end programs are for the
robot.

A frame is a byte that tells its kind, the length of the rest in four bytes, and the rest. Numbers are little-endian.
"""

from __future__ import annotations

import fcntl
import importlib
import json
import os
import select
import signal
import struct
import sys
import tempfile
import time
import uuid
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of a file."""

HEADER = struct.Struct("<BI")
"""Of a frame: its kind, and the number of bytes after these."""
MESSAGE_HEADER = struct.Struct("<HQ")
"""Of a message's frame: topic and time; then the message."""
TOPIC, MESSAGE, METADATA, ATTACHMENT, LOST, END = range(1, 7)
"""Kinds of frames. After a length of its own, an attachment's description in JSON; `LOST` has a count of messages."""

_CHUNK = 256 * 1024
"""Bytes of messages that are compressed together, at most: what is lost where this process is killed, too."""
_LONG, _LARGE = 20_000, 2_000_000
"""Messages from which on, and up to which, a record gets a summary as it is closed."""
_SYNC = 1.0
"""Seconds after which what was written is on the disk."""
_READ = 1 << 20


class Claimed(OSError):
    """A file is being written by another program, or is none that may be replaced; its text is a sentence."""


class Gone(Claimed):
    """A file has lost some of its content."""


class Kept(Claimed):
    """A file is a record, and is to be kept."""


def claim(path: str, *, keep: bool = False) -> int:
    """Open a file for a record and lock it; a record that is there already is replaced, or kept.

    Raises:
        Kept: If it is to be kept.
        Claimed: If another program records to it, or it is something else than a record.
        OSError: If it cannot be written.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Claimed("another program records to this file: give each a file of its own") from None
        start = os.read(descriptor, len(MAGIC))
        if start and start != MAGIC[: len(start)]:
            raise Claimed("this file is not a record, and would be overwritten: name another one")
        if start and keep:
            raise Kept("this file is a record")
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


class _Stream:
    """A file to which whole records are written: one that does not fit leaves no trace.

    Args:
        descriptor: The open file.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._position = 0

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        self.check()
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self.descriptor, view) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self.descriptor, self._position)
                os.lseek(self.descriptor, self._position, os.SEEK_SET)
            raise
        self._position += len(data)
        return len(data)

    def check(self) -> None:
        """Look whether the file is there; a name of another kind is fine.

        Raises:
            Gone: If it was removed, or has less than was written.
        """
        found = os.fstat(self.descriptor)
        if not found.st_nlink:
            raise Gone("the file was removed")
        if found.st_size < self._position:
            raise Gone("another program has cut the file short")

    def flush(self) -> None:
        pass  # there is no buffer

    def close(self) -> None:
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


class _Indexes:
    """The indexes of chunks, of which a day has 100,000s: kept in a nameless file until the summary takes them.

    Args:
        folder: Where the file is.
        builder: Encodes one of them.
    """

    def __init__(self, folder: Path, builder: Any) -> None:
        self._builder = builder
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - for as long as the record

    def append(self, index: Any) -> None:
        index.write(self._builder)
        self._file.write(self._builder.end())

    def __iter__(self) -> Iterator[_Indexes]:
        yield self  # whose `write` writes them all

    def write(self, builder: Any) -> None:
        self._file.seek(0)
        builder.write(self._file.read())

    def close(self) -> None:
        with suppress(OSError):  # of a full disk
            self._file.close()


class File:
    """One file of a record, written by the official library.

    Args:
        stream: Its bytes go there.
        library: The program that writes it, and its version.
        chunk: Bytes of messages that are compressed together.
        folder: Where indexes are kept until the file is complete; in memory where none is given.
    """

    def __init__(self, stream: Any, library: str, chunk: int = _CHUNK, folder: Path | None = None) -> None:
        mcap: Any = importlib.import_module("mcap.writer")  # an extra
        compression = mcap.CompressionType.NONE if mcap.zstandard is None else mcap.CompressionType.ZSTD
        self._writer = mcap.Writer(stream, chunk_size=chunk, compression=compression, enable_data_crcs=True)
        self.leave: Callable[[], object] = lambda: None
        if folder is not None:
            builder: Any = importlib.import_module("mcap.data_stream").RecordBuilder()
            with suppress(OSError):  # a folder in which nothing else may be made
                indexes = self._writer._Writer__chunk_indices = _Indexes(folder, builder)  # noqa: SLF001 - else 900 bytes each
                self.leave = indexes.close
        self._writer.start(library=library)
        self._schemas: dict[str, int] = {}
        self.add_message = self._writer.add_message
        self.metadata = self._writer.add_metadata
        self.flush = self._writer.flush
        self.finish = self._writer.finish

    def topic(self, name: str, schema_name: str, schema: bytes) -> int:
        """Add a topic; return its number, counted from 1."""
        if schema_name not in self._schemas:
            self._schemas[schema_name] = self._writer.register_schema(schema_name, "jsonschema", schema)
        return int(self._writer.register_channel(name, "json", self._schemas[schema_name]))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file of its own."""
        self._writer.add_attachment(0, 0, name, media_type, data)


class _Output:
    """The files of a record: one after the other, each of which can be read alone.

    Args:
        path: The path of the first one; ``-1`` and so on before the suffix makes those of the others.
        descriptor: The first one, open and locked.
        library: The program that writes it, and its version.
        split_bytes: The size from which on another file begins.
        split_time: Nanoseconds of messages, likewise.
        summary: The function, as ``module:name``, that returns a summary of a record by its path, to be attached when
            that is closed; empty where there is none.
    """

    def __init__(
        self,
        path: str,
        descriptor: int,
        library: str,
        split_bytes: int | None,
        split_time: int | None,
        summary: str = "",
    ) -> None:
        self.messages = 0
        self.lost = 0
        self.closed = False
        self.dirty = False
        self._path = path
        self._summary = summary
        self._library = library
        self._split_bytes = split_bytes
        self._split_time = split_time
        self._chunk = _CHUNK if split_bytes is None else max(1, min(_CHUNK, split_bytes // 4))
        self._record = uuid.uuid4().hex
        self._number = 0
        self._sequence = 0
        self._first: int | None = None
        self._topics: list[tuple[str, str, bytes]] = []
        self._metadata: list[tuple[str, dict[str, str]]] = []
        self._attachments: list[tuple[str, str, bytes]] = []
        self._open(descriptor)

    def _open(self, descriptor: int) -> None:
        self._stream = _Stream(descriptor)
        self._file = File(self._stream, self._library, self._chunk, Path(self._path).parent)
        self._first = None
        self._file.metadata("mdm.file", {"record": self._record, "number": str(self._number)})
        for metadata in self._metadata:
            self._file.metadata(*metadata)
        for attachment in self._attachments:
            self._file.attach(*attachment)
        for topic in self._topics:
            self._file.topic(*topic)
        _synchronise_folder(self._path)

    def topic(self, name: str, schema_name: str, schema: bytes) -> None:
        self._topics.append((name, schema_name, schema))
        self._file.topic(name, schema_name, schema)

    def metadata(self, name: str, mapping: dict[str, str]) -> None:
        self._metadata.append((name, mapping))
        self._file.metadata(name, mapping)
        self.dirty = True

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        if self._split_bytes is not None or self._split_time is not None:
            self._attachments.append((name, media_type, data))
        self._file.attach(name, media_type, data)
        self.dirty = True

    def skip(self, count: int) -> None:
        """Leave out the numbers of messages that were lost, so that it can be seen where they were."""
        self._sequence += count
        self.lost += count

    def message(self, topic: int, stamp: int, data: bytes) -> None:
        if self._first is None:
            self._first = stamp
        elif (self._split_time is not None and stamp - self._first >= self._split_time) or (
            self._split_bytes is not None and self._stream.tell() >= self._split_bytes
        ):
            self._finish()
            self._number += 1
            path = Path(self._path)
            self._open(claim(str(path.with_name(f"{path.stem}-{self._number}{path.suffix}"))))
            self._first = stamp
        self._file.add_message(topic, stamp, data, stamp, self._sequence & 0xFFFFFFFF)
        self._sequence += 1
        self.messages += 1
        self.dirty = True

    def check(self) -> None:
        """Raise `Gone` where the file has lost some of its content."""
        self._stream.check()

    def _finish(self) -> None:
        try:
            self._file.finish()
            os.fsync(self._stream.descriptor)
        finally:
            self.leave()

    def leave(self) -> None:
        """Let go of the file, which gives back the room of one that was removed, and of its indexes."""
        self._file.leave()
        self._stream.close()

    def synchronise(self) -> None:
        """Put all on the disk."""
        self.dirty = False
        self._file.flush()
        os.fsync(self._stream.descriptor)

    def close(self) -> None:
        """Complete the last file."""
        end = {"closed": "yes" if self.closed else "no", "messages": str(self.messages), "lost": str(self.lost)}
        self._file.flush()
        self._file.metadata("mdm.end", end)
        if self.is_summarised:
            with suppress(Exception):  # of a record that is none of a system, or too large for the memory
                module, name = self._summary.split(":")
                summary = getattr(importlib.import_module(module), name)(self._path)
                self.attach("mdm.summary", "application/octet-stream", summary)
        self._finish()

    @property
    def is_summarised(self) -> bool:
        """Whether it gets a summary as it is closed, which takes some microseconds a message."""
        return bool(self._summary) and self.closed and _LONG <= self.messages <= _LARGE


def _synchronise_folder(path: str) -> None:
    """Put on the disk that there is a new file."""
    with suppress(OSError):
        folder = os.open(Path(path).parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class _Recorder:
    """Takes frames, and goes on without a file when it cannot be written any more.

    Args:
        make: Makes the files.
        report: Sends a dictionary to the robot's process.
    """

    def __init__(self, make: Callable[[], _Output], report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self._taken = 0
        self._written = 0
        self._output: _Output | None = None
        self._try(lambda: setattr(self, "_output", make()))

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except Exception as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        output, self._output = self._output, None
        if output is not None:
            output.leave()
        if isinstance(error, Gone):
            self._written = 0
        text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        self._report({"failure": text or type(error).__name__})

    def take(self, frames: bytearray) -> int:
        """Take the whole frames at the start of some bytes; return how many bytes these are."""
        position, size = 0, len(frames)
        header, start = HEADER.size, HEADER.size + MESSAGE_HEADER.size
        while size - position >= header:
            kind, length = HEADER.unpack_from(frames, position)
            end = position + header + length
            if end > size:
                break
            output = self._output
            self._taken += kind == MESSAGE
            if output is not None:
                if kind == MESSAGE:
                    topic, stamp = MESSAGE_HEADER.unpack_from(frames, position + header)
                    data = bytes(frames[position + start : end])
                    try:
                        output.message(topic, stamp, data)
                    except Exception as error:
                        self._give_up(error)
                else:
                    self._try(partial(_apply, output, kind, bytes(frames[position + header : end])))
            position = end
        return position

    def second(self) -> None:
        """Do the work of every second."""
        if self._output is not None:
            self._try(self._output.synchronise if self._output.dirty else self._output.check)
        self._tell()

    def close(self) -> None:
        """Complete the file."""
        if self._output is not None:
            if self._output.is_summarised:
                self._report({"summarises": True})
            self._try(self._output.close)
        self._tell(finished=self._output is not None)

    def _tell(self, **more: object) -> None:
        """Report how many messages are on the disk, and, if that is all there will be, how many are not."""
        if self._output is not None:
            self._written = self._taken
        else:
            more["lost"] = self._taken - self._written
        self._report({"written": self._written, **more})


def _apply(output: _Output, kind: int, data: bytes) -> None:
    """Carry out a frame that is no message."""
    if kind == TOPIC:
        name, schema_name, schema = json.loads(data)
        output.topic(name, schema_name, schema.encode())
    elif kind == METADATA:
        output.metadata(*json.loads(data))
    elif kind == ATTACHMENT:
        (length,) = struct.unpack_from("<I", data)
        name, media_type = json.loads(data[4 : 4 + length])
        output.attach(name, media_type, data[4 + length :])
    elif kind == LOST:
        output.skip(*struct.unpack("<Q", data))
    elif kind == END:
        output.closed = True


def main() -> None:
    """Write the frames of standard input until it ends; report on standard output."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    settings = json.loads(sys.argv[1])
    robot = settings.pop("robot")
    os.set_blocking(1, False)

    def report(told: dict[str, Any]) -> None:
        with suppress(OSError):  # nobody listens, or has for long
            os.write(1, json.dumps(told).encode() + b"\n")

    recorder = _Recorder(lambda: _Output(**settings), report)
    ready = select.poll()
    ready.register(0, select.POLLIN | select.POLLHUP)
    frames = bytearray()
    due = time.monotonic() + _SYNC
    while True:
        wait = due - time.monotonic()
        if wait <= 0:
            recorder.second()
            due = time.monotonic() + _SYNC
            continue
        if ready.poll(1000 * wait):
            data = os.read(0, _READ)
            if not data:
                break
            frames += data
            del frames[: recorder.take(frames)]
        elif os.getppid() != robot:  # it was killed, and a child that it had forked holds the pipe open
            break
    recorder.close()


if __name__ == "__main__":
    main()
