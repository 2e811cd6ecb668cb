"""The robot's end of a record: encoded messages go through a pipe to the process that writes the file.

Nothing here waits but `RecordWriter.close` and `RecordWriter.drain`, and nothing raises once a record is open: what
fails is told by `RecordWriter.failure`, and the robot goes on.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import select
import struct
import subprocess
import sys
import time as times
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from mdm.errors import Error, FormatError
from mdm.options import Options
from mdm.recording import process
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping

SILENT = 3.0
"""Seconds after which a process that writes, and reports once a second, has been silent for too long."""
_SUMMARY = 30.0
"""Seconds that a summary may take as a record is closed."""
_STARTS = 30.0
"""The same, of one that has not said its first word."""
_BOUND = 16 * 1024 * 1024
_PIPE = 1 << 20
"""Bytes that a pipe is asked to hold, where the system lets programs say so."""
_F_SETPIPE_SZ = 1031
_LONGEST = 2**32 - 256

_PACK = struct.Struct("<BIHQ").pack
_FRAME = process.HEADER.pack


class RecordStatistics(msgspec.Struct, frozen=True):
    """Counts of the messages of a record.

    Args:
        messages: Those that were taken, to be written.
        bytes: Their size.
        pending: Bytes that wait in this process.
        written: Messages known to be on the disk, about once a second.
        dropped: Messages that were not taken since too much was waiting, or that could not be written.
    """

    messages: int
    bytes: int
    pending: int
    written: int
    dropped: int


class FileSettings(Options, frozen=True, kw_only=True):
    """How many files a record has; see `RecorderSettings`, which also say what is kept."""

    split_bytes: Annotated[int, Meta(gt=0, extra={"unit": "bytes"})] | None = None
    split_seconds: Annotated[float, Meta(gt=0, lt=1e9, extra={"unit": "seconds"})] | None = None
    keep: bool = False


class RecordWriter:
    """Writes a record in a process of its own.

    Args:
        path: The file, an MCAP file.
        files: How many files it has.
        bound: Bytes that may wait in this process; messages beyond are dropped and counted.

    Example::

        record = RecordWriter("run.mcap")
        record.open()
        record.metadata("mdm", {"format": "1"})
        decisions = record.topic("decisions", "mdm.Decision", schema)
        record.write(decisions, decision.time, data)
        record.flush()
        record.close(2.0)
    """

    def __init__(
        self,
        path: str | Path,
        files: FileSettings | None = None,
        *,
        bound: int = _BOUND,
    ) -> None:
        files = FileSettings() if files is None else files
        self.path = Path(path)
        self.kept_files: tuple[Path, ...] = ()
        """The files that are kept, in place of which another one is written."""
        self._keep = files.keep
        self.failure: str | None = None
        """A sentence that says why nothing more is written, None while all is well."""
        self.summary = ""
        """The function, as ``module:name``, that returns the summary of a record by its path."""
        self._summarises = False
        self._split_bytes = files.split_bytes
        self._split_time = None if files.split_seconds is None else round(files.split_seconds * 1e9)
        self._bound = bound
        self._limit = -1  # takes nothing while it is not open
        self._buffer = bytearray()
        self._topics = 0
        self._messages = 0
        self._bytes = 0
        self._dropped = 0
        self._gap = 0
        self._lost = 0
        self._written = 0
        self._finished = False
        self._heard = b""
        self._heard_by = math.inf
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe = -1
        self._ear = -1

    def open(self) -> None:
        """Begin the record; obstacles are told here, before a robot runs.

        Raises:
            Error: If mcap is not installed.
            FormatError: If the file cannot be written, is no record, or another program records to it.
        """
        if importlib.util.find_spec("mcap") is None:
            raise Error("records need mcap: pip install mcap threadpoolctl")
        try:
            if self.path.is_dir():
                raise FormatError("this is a folder, not a file", file=self.path)
            if not self.path.parent.is_dir():
                raise FormatError("the record cannot be written: its folder does not exist", file=self.path)
            descriptor = self._claim(self.path)
        except process.Claimed as error:
            raise FormatError(str(error), file=self.path) from None
        except OSError as error:
            raise FormatError(f"the record cannot be written: {error.strerror}", file=self.path) from None
        except ValueError:
            raise Error(f"{str(self.path)!r} cannot name a file: give the record another name") from None
        try:
            self._start(str(self.path.absolute()), descriptor)
        except OSError as error:
            raise FormatError(f"the record's process cannot be started: {error.strerror}", file=self.path) from None
        finally:
            os.close(descriptor)
        self._limit = self._bound
        self._heard_by = times.monotonic() + _STARTS

    def _claim(self, path: Path) -> int:
        """Open the file, or the first one of the next number that takes the place of no record."""
        kept: list[Path] = []
        for number in count(1):
            if number > 1:
                self.path = path.with_name(f"{path.stem}.{number}{path.suffix}")
            try:
                splits = self._split_bytes is not None or self._split_time is not None
                if self._keep and splits and _parts(self.path):
                    raise process.Kept
                descriptor = process.claim(str(self.path.absolute()), keep=self._keep)
            except process.Kept:
                kept.append(self.path)
                continue
            break
        self.kept_files = tuple(kept)
        return descriptor

    def _start(self, path: str, descriptor: int) -> None:
        settings = {
            "robot": os.getpid(),
            "path": path,
            "descriptor": descriptor,
            "library": f"mdm/{__version__}",
            "split_bytes": self._split_bytes,
            "split_time": self._split_time,
            "summary": self.summary,
        }
        (source, self._pipe), (self._ear, told) = os.pipe(), os.pipe()
        try:
            # A session of its own: Ctrl-C is for the robot, whose last messages are still to be written.
            self._process = subprocess.Popen(  # noqa: S603 - this interpreter
                [sys.executable, "-P", process.__file__, json.dumps(settings)],
                stdin=source,
                stdout=told,
                stderr=subprocess.DEVNULL,
                pass_fds=(descriptor,),
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                start_new_session=True,
            )
        except OSError:
            self._leave()
            raise
        finally:
            os.close(source)
            os.close(told)
        os.set_blocking(self._pipe, False)
        os.set_blocking(self._ear, False)
        with suppress(OSError, ImportError):
            import fcntl  # noqa: PLC0415 - not everywhere

            fcntl.fcntl(self._pipe, _F_SETPIPE_SZ, _PIPE)

    def topic(self, name: str, schema_name: str, schema: Mapping[str, object] | bytes) -> int:
        """Add a topic, before its first message.

        Args:
            name: Its name in the file.
            schema_name: The name of the type of its messages; one name has one schema.
            schema: The JSON schema of its messages, as `mdm.recording.schemas.schema` makes it.

        Returns:
            The number by which `write` knows it.
        """
        text = schema.decode() if isinstance(schema, bytes) else json.dumps(schema)
        self._append(process.TOPIC, json.dumps([name, schema_name, text]).encode())
        self._topics += 1
        return self._topics

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Add named strings, of which each file has a copy."""
        self._append(process.METADATA, json.dumps([name, dict(mapping)]).encode())

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file, such as a model, of which each file of the record has a copy.

        Raises:
            Error: If it has 4 GB or more.
        """
        if len(data) > _LONGEST - _BOUND:
            raise Error(f"{name}: {len(data):,} bytes are too many to attach to a record: attach its digest")
        described = json.dumps([name, media_type]).encode()
        self._append(process.ATTACHMENT, b"".join((struct.pack("<I", len(described)), described, data)))

    def _append(self, kind: int, data: bytes) -> None:
        """Add a frame that is not bounded."""
        if self._limit >= 0:
            self._buffer += _FRAME(kind, len(data))
            self._buffer += data
            self._limit += len(data)  # room for messages is not taken by it

    def write(self, topic: int, time: int, data: bytes) -> None:
        """Add an encoded message, to be sent by the next `flush`; it is dropped where too much waits.

        Args:
            topic: The topic's number.
            time: Of the turn, in nanoseconds of the clock, from 0 on.
            data: The message in JSON.
        """
        buffer = self._buffer
        size = len(data)
        if len(buffer) + size > self._limit:
            self._dropped += 1
            self._gap += 1
            return
        if self._gap:
            buffer += _FRAME(process.LOST, 8)
            buffer += struct.pack("<Q", self._gap)
            self._gap = 0
        buffer += (
            _PACK(process.MESSAGE, size + 10, topic, time) + data
        )  # in one, for there may be no room for the second
        self._messages += 1
        self._bytes += size

    def skip(self, count: int) -> None:
        """Count messages that were lost before they came here, and leave their numbers out."""
        self._dropped += count
        self._gap += count

    @property
    def silent(self) -> bool:
        """Whether the process that writes should have been heard by now."""
        return self.failure is None and times.monotonic() > self._heard_by

    def flush(self) -> None:
        """Send as much as the pipe takes; never waits."""
        if self._buffer and self._pipe >= 0:
            try:
                del self._buffer[: os.write(self._pipe, self._buffer)]
            except BlockingIOError:
                pass
            except OSError:
                self._hear()
                self._fail()
                return
            if not self._buffer:
                self._limit = self._bound
        self._hear()

    def drain(self, seconds: float) -> None:
        """Send all that waits, waiting so many seconds at most: where time is virtual, and waiting costs nothing."""
        if self._pipe < 0:
            return
        deadline = times.monotonic() + seconds
        ready = select.poll()
        ready.register(self._pipe, select.POLLOUT)
        self.flush()
        while self._buffer and (left := deadline - times.monotonic()) > 0:
            ready.poll(1000 * left)
            self.flush()

    def _hear(self) -> None:
        """Take in the process's reports."""
        if self._ear < 0:
            return
        try:
            while data := os.read(self._ear, 65536):
                self._heard += data
                self._heard_by = times.monotonic() + SILENT
        except BlockingIOError:
            pass
        else:  # it has ended
            self._take_in()
            self._fail()
        self._take_in()

    def _take_in(self) -> None:
        *lines, self._heard = self._heard.split(b"\n")
        for line in lines:
            told = json.loads(line)
            self._finished |= told.get("finished", False)
            self._summarises = told.get("summarises", self._summarises)
            self._written = told.get("written", self._written)
            self._lost = told.get("lost", self._lost)
            if self.failure is None and "failure" in told:
                self.failure = f"{self.path}: the record ends here: {told['failure']}"

    def _fail(self) -> None:
        """Take note that the process has ended, and take no more."""
        if self.failure is None and not self._finished and self._process is not None:
            status = self._process.poll()
            how = "" if status is None else f" (status {status})" if status >= 0 else f" (signal {-status})"
            self.failure = f"{self.path}: the record ends here: the process that writes it has ended{how}"
        self._discard()

    def _discard(self) -> None:
        """Drop all that waits."""
        self._buffer.clear()
        self._limit = -1
        self._lost = self._messages - self._written

    def statistics(self) -> RecordStatistics:
        """Return how many messages were taken and dropped."""
        return RecordStatistics(
            messages=self._messages,
            bytes=self._bytes,
            pending=len(self._buffer),
            written=self._written,
            dropped=self._dropped + self._lost,
        )

    def close(self, seconds: float = 2.0) -> None:
        """Send the rest, and wait until the file is complete: for so many seconds, at most.

        Past these seconds, the process still writes all that it has, and the rest is dropped. A summary is waited for,
        too, for half a minute more.
        """
        if self._process is None:
            return
        deadline = times.monotonic() + seconds
        if self._gap:
            self._append(process.LOST, struct.pack("<Q", self._gap))
            self._gap = 0
        self._append(process.END, b"")
        self.drain(seconds)
        if self._buffer:
            self._discard()
        self._limit = -1
        os.close(self._pipe)
        self._pipe = -1
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(0.0, deadline - times.monotonic()))
        self._hear()
        try:
            self._process.wait(more := _SUMMARY if self._summarises else 0.0)
        except subprocess.TimeoutExpired:
            told = f"{self.path}: the record was not complete after {seconds + more:g} s; it is still written"
            self.failure = self.failure or told
        self._hear()
        self._leave()

    def _leave(self) -> None:
        for descriptor in (self._pipe, self._ear):
            if descriptor >= 0:
                os.close(descriptor)
        self._pipe = self._ear = -1


def _parts(path: Path) -> list[Path]:
    """Return the further files of a split record of this name, of which the first one may be elsewhere."""
    part = re.compile(rf"{re.escape(path.stem)}-[1-9][0-9]*{re.escape(path.suffix)}")
    return [each for each in path.absolute().parent.iterdir() if part.fullmatch(each.name)]
