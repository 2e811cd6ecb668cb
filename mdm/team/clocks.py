"""Clocks: how far the other agents' are ahead of one's own.

An agent asks another for its time. The answer was given somewhere between question and answer, so that half of what
both took is how much the offset may be wrong.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from mdm.errors import Error
from mdm.runtime import Actor
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from mdm.messages import Tick
    from mdm.team.link import Link

__all__ = ["Clocks", "Offset"]

_TIME = struct.Struct("<q")
_PERIOD = 5.0
_ANSWER = 1.0


class Offset(msgspec.Struct, frozen=True):
    """How far a clock is ahead of this agent's.

    Args:
        seconds: The offset; negative where it is behind.
        error: By how many seconds it may be wrong.
    """

    seconds: float
    error: float


class Clocks(Actor):
    """Measures the clocks of live agents, at first and then every five seconds.

    Ticks are at multiples of the period on each agent's own clock. Where a clock is off by more than half a period, or
    by more than a step waits, what its agent sees comes too late or counts for another step: it reports a fault
    ``clock``, once until it agrees again.

    Args:
        link: What connects the agent with the others.

    Attributes:
        offsets: The last measurement of each live agent.
        limit: Seconds by which a clock may be off.
    """

    def __init__(self, link: Link, *, name: str = "clocks") -> None:
        super().__init__(name)
        self.offsets: dict[str, Offset] = {}
        team = link.team
        self.limit = team.deadline if team.period is None else min(team.period / 2, team.deadline)
        self._link = link
        self._lives: dict[str, int] = {}
        self._off: set[str] = set()
        self._serves = False

    def on_start(self) -> None:
        """Tell the time to whoever asks, and ask the others."""
        if not self._serves:
            self._serves = True
            self._link.serve(self._link.key("clock"), lambda _: _TIME.pack(self.time()))
        self._lives.clear()
        self._watching = self._link.watch(self._on_live, self)
        self.every(1 / _PERIOD, self._on_tick)

    def on_stop(self) -> None:
        """Ask no more."""
        self._link.drop([self._watching])

    def time(self) -> int:
        """Return the time by this agent's clock, in nanoseconds."""
        return self.runtime.clock.now()

    def _on_live(self, link: Link) -> None:
        new = [agent for agent, life in link.live.items() if agent != link.agent and self._lives.get(agent) != life]
        self._lives = dict(link.live)
        self.offsets = {agent: offset for agent, offset in self.offsets.items() if agent in link.live}
        self._off &= link.live.keys()
        self._ask(new)

    def _on_tick(self, _: Tick) -> None:
        self._ask([agent for agent in self._link.live if agent != self._link.agent])

    def _ask(self, agents: list[str]) -> None:
        if self._link.opened:
            for agent in agents:
                self.spawn(self._measure(agent), name=f"clock of {agent}")

    async def _measure(self, agent: str) -> None:
        began, answers = self.time(), {}
        with suppress(Error):  # the transport has closed meanwhile
            answers = await self._link.ask(join(self._link.team.name, agent, "clock"), seconds=_ANSWER)
        ended = self.time()
        answer = answers.get(agent, b"")
        if len(answer) == _TIME.size and agent in self._link.live:
            [theirs] = _TIME.unpack(answer)
            self._take(agent, Offset((theirs - (began + ended) / 2) / 1e9, (ended - began) / 2e9))

    def _take(self, agent: str, offset: Offset) -> None:
        self.offsets[agent] = offset
        off = abs(offset.seconds)
        if off + offset.error <= self.limit:
            self._off.discard(agent)
        elif off - offset.error > self.limit and agent not in self._off:
            self._off.add(agent)
            way = "ahead of" if offset.seconds > 0 else "behind"
            self.report(
                "clock",
                f"the clock of {agent} is {off:.3f} s {way} that of {self._link.agent}, and the team allows for "
                f"{self.limit:g} s: what they see counts for other steps, or for none: synchronise the clocks",
            )
