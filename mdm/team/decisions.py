"""Files of decisions: each joint step that an agent has applied, as a line of JSON."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING

from mdm.errors import Error
from mdm.runtime import Actor
from mdm.runtime.writer import Writer
from mdm.team.commits import Committed

if TYPE_CHECKING:
    from mdm.runtime import Channel

__all__ = ["Decisions"]


class Decisions(Actor):
    """Writes what an agent's team decides to a file, on a thread of its own; what was there before stays.

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

    def on_start(self) -> None:
        """Open the file and listen.

        Raises:
            Error: If it cannot be written.
        """
        try:
            self._file = self.path_of_file.open("ab", buffering=0)
        except OSError as error:
            raise Error(f"decisions cannot be written to {self.path_of_file}: {error.strerror}") from None
        self._writer = Writer()
        self._writer.open()
        above = self.parent.path if self.parent is not None else ""
        commits: Channel[Committed] = self.runtime.channel(f"{above}/commits" if above else "commits", Committed)
        self.subscribe(commits, self._write)

    def _write(self, committed: Committed) -> None:
        assert self._file is not None
        self._writer.put(self._file.write, committed.line())

    def on_stop(self) -> None:
        """Write what waits, and close the file."""
        self._writer.close()
        lost = self._writer.statistics().lost
        if lost:
            self.report("decisions", f"{lost} lines could not be written to {self.path_of_file}")
        if self._file is not None:
            self._file.close()
            self._file = None
