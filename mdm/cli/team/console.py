"""The console: the output of a team's processes in one place, each line with its agent."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Literal

import msgspec

from mdm.runtime.process.rendering import Rendering
from mdm.runtime.process.writer import Stream, Writer

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Console"]

_COLOURS = (36, 33, 32, 35, 34, 31)
_RESET = "\x1b[0m"


class Console:
    """Prints lines of agents, on a thread: a console that nobody reads delays no agent.

    Args:
        agents: The agents, each of which has a colour where a terminal is written to.
        json: Print JSON lines: the agents' logs on standard error, their other output on standard output.
    """

    def __init__(self, agents: Sequence[str], *, json: bool) -> None:
        self._json = json
        self._writer = Writer()
        self._width = max(map(len, agents))
        self._colours = {agent: _COLOURS[place % len(_COLOURS)] for place, agent in enumerate(agents)}
        self._streams = {
            "output": Stream(sys.stdout, lambda: self._writer.given_up),
            "log": Stream(sys.stderr, lambda: self._writer.given_up),
        }
        self._render = Rendering(colours=self._streams["log"].colours)

    def open(self) -> None:
        """Begin to print."""
        self._writer.open()

    def close(self) -> int:
        """Print the waiting lines; return how many lines were lost because nobody read them."""
        self._writer.close()
        return self._writer.statistics().lost

    def line(self, agent: str, stream: Literal["output", "log"], text: str) -> None:
        """Print the lines of an agent."""
        if self._json:
            self._put(stream, msgspec.json.encode({"agent": agent, "event": stream, "text": text}).decode())
        else:
            self._put(stream, f"{self._name(agent, self._streams[stream])} {text}")

    def record(self, agent: str, record: dict[str, object]) -> None:
        """Print a record of an agent's log."""
        if self._json:
            self._put("log", msgspec.json.encode({"agent": agent, **record}).decode())
        else:
            self.line(agent, "log", self._render(None, "", record))

    def tell(self, agent: str, event: str, text: str, **facts: object) -> None:
        """Print a change of an agent's process."""
        if self._json:
            self.record(agent, {"event": event, "text": text, **facts})
        else:
            self.line(agent, "log", f"* {text}")

    def _put(self, stream: Literal["output", "log"], text: str) -> None:
        self._writer.put(self._streams[stream].write, text)

    def _name(self, agent: str, stream: Stream) -> str:
        name = f"{agent:{self._width}} |"
        return f"\x1b[{self._colours[agent]}m{name}{_RESET}" if stream.colours else name
