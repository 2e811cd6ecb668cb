"""The storage: an agent's memory of commands and safe modes over the end of its process, in one small file.

The file is written before a command is confirmed: whole, synchronised to disk, and put in the place of the last one.
It is there only while there is something to remember.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.errors import Error
from mdm.messages import Cause
from mdm.models.digest import of_bytes
from mdm.runtime import Actor, Subscription
from mdm.runtime.process.writer import Writer
from mdm.runtime.time.virtual import VirtualClock
from mdm.team.transport.bounds import UNREADABLE, Name, Number

if TYPE_CHECKING:
    from collections.abc import Iterable

_VERSION = 1
_CLOSE = 5.0
"""Seconds within which the last change is written at the end."""


class StoredStop(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The stop that an agent obeys.

    Args:
        by: The agent that was asked for it.
        term: The number of the term in which it was, or of the episode, or of the controller's life.
        since: When the agent stopped, in nanoseconds since 1970.
        memory: The stop as the team's layer needs it to obey, in a form of its own.
    """

    by: Name
    term: Number
    since: Number
    memory: bytes = b""

    def __str__(self) -> str:
        """Return since when the agent is stopped, in words."""
        if not self.since:
            return "stopped since a time that is not known"
        day = datetime.fromtimestamp(self.since / 1e9, UTC).astimezone()
        by = f", asked for at {self.by} in term {self.term}" if self.by else ""
        return f"stopped since {day:%Y-%m-%d %H:%M:%S}{by}"


class Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The memory of an ensemble.

    Args:
        stop: The stop that it obeys; None where it obeys none.
        causes: The causes of its safe mode that nothing but a release ends.
    """

    stop: StoredStop | None = None
    causes: tuple[Cause, ...] = ()


NOTHING = Stored()
UNKNOWN = Stored(StoredStop("", 0, 0))


class _Head(msgspec.Struct):
    """The beginning of a file, in any version."""

    content: Literal["mdm team state"]
    version: int
    team: str
    agent: str


class _File(_Head, forbid_unknown_fields=True):
    ensembles: dict[str, Stored]
    digest: str

    def sealed(self) -> _File:
        """Return it with the digest of all else."""
        bare = msgspec.structs.replace(self, digest="")
        return msgspec.structs.replace(self, digest=of_bytes(msgspec.json.encode(bare)))


def path_of(folder: str | Path, team: str, agent: str) -> Path:
    """Return the path of an agent's file in a folder."""
    return Path(folder) / f"{agent}@{team}.state"


def read(path: Path, team: str, agent: str, ensembles: Iterable[str]) -> dict[str, Stored]:
    """Return the memory of a file, by ensemble; nothing where there is no file.

    Raises:
        Error: If it cannot be read, is another's, of a newer program, or damaged.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise Error(f"it cannot be read: {error.strerror}") from None
    try:
        head = msgspec.json.decode(data, type=_Head)
        if (head.team, head.agent) != (team, agent):
            raise Error(f"it belongs to agent {head.agent!r} of team {head.team!r}")
        if head.version > _VERSION:
            raise Error("a newer version of the program has written it")
        file = msgspec.json.decode(data, type=_File)
    except UNREADABLE as error:
        raise Error(f"it is damaged: {error}") from None
    if file.digest != file.sealed().digest:
        raise Error("it is damaged: its content is not what was written")
    if strangers := file.ensembles.keys() - set(ensembles):
        raise Error(f"it remembers ensemble {min(strangers)!r}, which this agent does not have")
    return file.ensembles


def write(path: Path, team: str, agent: str, ensembles: dict[str, Stored]) -> None:
    """Remember this from now on, and nothing else; it is on disk when this returns.

    Raises:
        OSError: If it cannot be written.
    """
    if ensembles:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _File("mdm team state", _VERSION, team, agent, ensembles, "").sealed()
        _replace(path, msgspec.json.encode(file) + b"\n")
    else:
        path.unlink(missing_ok=True)
    if hasattr(os, "O_DIRECTORY") and path.parent.is_dir():
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _replace(path: Path, data: bytes) -> None:
    """Put a whole file in the place of another."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=".mdm-")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def forget(folder: str | Path, team: str, agent: str) -> str | None:
    """Remove an agent's file; return its content in words, None where there is nothing.

    Raises:
        Error: If it cannot be removed.
    """
    path = path_of(folder, team, agent)
    try:
        stored = msgspec.json.decode(path.read_bytes(), type=_File).ensembles
        told = [f"{name} {one.stop or 'waited for a release'}" for name, one in stored.items()]
    except FileNotFoundError:
        return None
    except (OSError, *UNREADABLE):
        told = [f"{path}, which could not be read"]
    try:
        write(path, team, agent, {})
    except OSError as error:
        raise Error(f"{path} cannot be removed: {error.strerror}") from None
    return ", ".join(told)


class Storage(Actor):
    """Reads an agent's file when it starts, and writes changes on a thread of its own; in virtual time at once.

    Args:
        folder: Where the file is; it is made where there is none.
        team: The name of the team.
        agent: Whose file it is.
        ensembles: The agent's ensembles.

    Attributes:
        file: The file.
        problem: Why the last change is not on disk; None where it is, or is under way.
    """

    def __init__(
        self, folder: str | Path, team: str, agent: str, ensembles: Iterable[str], *, name: str = "storage"
    ) -> None:
        super().__init__(name)
        self.file = path_of(folder, team, agent)
        self.problem: str | None = None
        self._whose = team, agent
        self._ensembles = tuple(ensembles)
        self._stored: dict[str, Stored] = {}
        self._asked = self._done = 0
        self._repeats = self._virtual = False
        self._writer = Writer()

    def on_start(self) -> None:
        """Read the file, and report one that cannot be: then nobody knows that this agent was not stopped."""
        self._repeats = self.runtime.dispatcher.choices.repeats
        if self._repeats:
            return
        try:
            self._stored = read(self.file, *self._whose, self._ensembles)
        except Error as error:
            self._stored = dict.fromkeys(self._ensembles, UNKNOWN)
            self.report("storage", f"{self.file}: {error}: {self._whose[1]} starts stopped")
        self._loop = asyncio.get_running_loop()
        self._writer = Writer()
        self._virtual = isinstance(self.runtime.clock, VirtualClock)
        if not self._virtual:
            self._writer.open()

    def on_stop(self) -> None:
        """Wait for the last change to be written."""
        self._writer.close(_CLOSE)

    def recall(self, ensemble: str) -> Stored:
        """Return the memory of an ensemble."""
        return NOTHING if self._repeats else self._stored.get(ensemble, NOTHING)

    def keep(self, ensemble: str, stored: Stored) -> None:
        """Remember this of an ensemble from now on."""
        if self._repeats or (self.problem is None and self.recall(ensemble) == stored):
            return
        self._stored.pop(ensemble, None)
        if stored != NOTHING:
            self._stored[ensemble] = stored
        self._asked += 1
        self.problem = None
        self._writer.put(self._write, (self._asked, dict(self._stored)))

    @property
    def unkept(self) -> str | None:
        """Why not everything that is to be remembered is on disk; None where it is."""
        if self.problem is not None:
            return f"not kept: {self.problem}"
        return None if self._done == self._asked else "not kept yet: it is being written"

    def _write(self, change: tuple[int, dict[str, Stored]]) -> None:
        """Write a change, on the thread."""
        number, stored = change
        problem = None
        try:
            write(self.file, *self._whose, stored)
        except OSError as error:
            problem = f"{self.file}: {error.strerror}"
        if self._virtual:
            self._note((number, problem))
            return
        with suppress(RuntimeError):  # the loop has ended
            done: Subscription[tuple[int, str | None]] = Subscription(None, self, self._note)
            self._loop.call_soon_threadsafe(self.runtime.dispatcher.deliver, done, (number, problem))

    def _note(self, done: tuple[int, str | None]) -> None:
        """Take note of a change that was written, or not."""
        self._done, problem = done
        if self._done == self._asked:
            self.problem = problem
        if problem is not None:
            self.report("storage", f"what {self._whose[1]} obeys is not kept over the end of its process: {problem}")
