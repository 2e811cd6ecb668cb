"""Decisions of a team, step by step: the message of each joint step that an agent has applied, and files of them."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias, TypeVar

import msgspec

from mdm.errors import Error
from mdm.messages import Message
from mdm.runtime import Actor
from mdm.runtime.process.writer import Writer

if TYPE_CHECKING:
    from mdm.runtime import Channel

T = TypeVar("T")

Place: TypeAlias = "tuple[str, tuple[int, str, int], int, str | None]"
"""Which step a line tells: of which ensemble, the term, the number, and the command where it is one."""

_TAIL = 4 << 20
"""Bytes at the end of a file whose steps are known; an agent that returns is told a few hundred again at most."""


class Committed(Message, frozen=True, gc=False):
    """A joint step that this agent has applied.

    Args:
        agent: Which agent's copy.
        ensemble: Of which ensemble.
        term: The number of its term, the term's leader, and which life of it.
        step: Counted from 1.
        input: The parts, by agent and in names; agents that saw nothing are left out.
        missing: Agents whose part is not known.
        command: ``start``, ``stop``… where the step is one; else None.
        action: The joint action after it, None where there is none.
        digest: Of the copy after it.
        caught_up: Whether others took it before this agent heard of it, which did nothing of it then; of the last one
            of these it does the action from now on.
    """

    agent: str
    ensemble: str
    term: tuple[int, str, int]
    step: int
    input: dict[str, str | tuple[str | None, ...] | None]
    missing: tuple[str, ...]
    command: str | None
    action: str | None
    digest: str
    caught_up: bool = False

    def line(self) -> bytes:
        """Return it as a line of JSON, with its time in seconds."""
        fields: dict[str, Any] = msgspec.structs.asdict(self) | {"time": self.time / 1e9}
        return msgspec.json.encode(Line(**fields)) + b"\n"


class Line(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A joint step as an agent has written it to its file: a `Committed` with its time in seconds."""

    agent: str
    ensemble: str
    term: tuple[int, str, int]
    step: int
    time: float
    input: dict[str, Any]
    missing: tuple[str, ...]
    command: str | None = None
    action: str | None
    digest: str
    caught_up: bool = False

    @property
    def place(self) -> Place:
        """Which step it is."""
        return self.ensemble, self.term, self.step, self.command


class Decisions(Actor):
    """Appends the decisions of an agent's team to a file, on a thread of its own.

    An agent that returns is told steps that it had applied before: each step is written once. A last line that was
    broken off, as by a crash, is removed.

    Args:
        path: The file, which ends in ``.jsonl``; it is made where there is none.

    Raises:
        Error: If its name ends otherwise, as that of a model or of a configuration does.
    """

    def __init__(self, path: str | Path, *, name: str = "decisions") -> None:
        super().__init__(name)
        self.path_of_file = Path(path)
        if self.path_of_file.suffix != ".jsonl":
            raise Error(f"decisions are lines of JSON: name a file that ends in .jsonl, not {self.path_of_file}")
        self._file: IO[bytes] | None = None
        self._writer = Writer()
        self._known: set[Place] = set()
        self._lost = 0
        self._told = False

    @property
    def lost(self) -> int:
        """How many lines could not be written."""
        return self._lost + self._writer.statistics().lost

    def on_start(self) -> None:
        """Open the file and listen.

        Raises:
            Error: If it cannot be written.
        """
        try:
            self._known = _known(self.path_of_file)
            self._file = self.path_of_file.open("ab", buffering=0)
        except OSError as error:
            raise Error(f"decisions cannot be written to {self.path_of_file}: {error.strerror}") from None
        self._told = False
        self._writer = Writer()
        self._writer.open()
        above = self.parent.path if self.parent is not None else ""
        commits: Channel[Committed] = self.runtime.channel(f"{above}/commits" if above else "commits", Committed)
        self.subscribe(commits, self._write)

    def _write(self, committed: Committed) -> None:
        assert self._file is not None
        place = (committed.ensemble, committed.term, committed.step, committed.command)
        if self._known and place in self._known:
            return
        self._writer.put(self._file.write, committed.line())
        self._report_lost()

    def _report_lost(self) -> None:
        if self.lost and not self._told:
            self._told = True
            self.report("decisions", f"lines cannot be written to {self.path_of_file}: what is decided goes on untold")

    def on_stop(self) -> None:
        """Write the pending lines, and close the file."""
        self._writer.close()
        self._report_lost()
        self._lost, self._writer = self.lost, Writer()
        if self._file is not None:
            self._file.close()
            self._file = None


def _known(path: Path) -> set[Place]:
    """Return the last steps that a file has, and remove a last line that was broken off."""
    if not path.is_file():
        return set()
    with path.open("r+b") as file:
        size = file.seek(0, 2)
        begin = file.seek(max(0, size - _TAIL))
        *lines, rest = file.read().split(b"\n")
        if rest and _decoded(rest, object) is not None:
            file.write(b"\n")
            lines.append(rest)
        elif rest and (begin == 0 or lines):
            file.truncate(size - len(rest))
    return {line.place for text in lines if (line := _decoded(text, Line)) is not None}


def _decoded(text: bytes, kind: type[T]) -> T | None:
    """Return the object of a line; None where it is no such object, or was broken off."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, ValueError):
        return None
