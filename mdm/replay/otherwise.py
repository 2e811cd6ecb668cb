"""The messages of a team that is replayed with another configuration: each comes as it is sent now, when it came then.

A message has its number among those of its sender. As long as the agents send under the same keys at the same times as
with the configuration that they had, this is a run that the team would have had on the same network: with the same
delays and losses, and the same input of its sensors. Where an agent sends otherwise, nothing is told from there on, of
itself and of all that may have received it.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from mdm.replay.exchange import PartedError
from mdm.replay.traffic import Limit, Sent, life_of
from mdm.team.link import FAREWELL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.replay.traffic import Life, Traffic
    from mdm.replay.transport import ReplayTransport
    from mdm.stimuli import Received, Stimulus

__all__ = ["Otherwise"]


class _Waiting(NamedTuple):
    side: str
    received: Received
    life: Life
    number: int
    permit: asyncio.Future[None]


class Otherwise:
    """Carries messages between agents of another configuration, in place of those that were sent.

    Args:
        traffic: What was sent with the configuration that the agents had.
    """

    def __init__(self, traffic: Traffic) -> None:
        self._traffic = traffic
        self._sent: dict[Life, list[Sent]] = {}
        self._now: dict[Life, Callable[[], int]] = {}
        self._parted: set[Life] = set()
        self._stopped: set[str] = set()
        self._limits: dict[str, Limit] = {}
        self._waiting: list[_Waiting] = []
        self._running = 0

    def add(
        self,
        name: str,
        stimuli: Sequence[Stimulus],
        transports: Mapping[str, ReplayTransport],
        now: Callable[[], int],
    ) -> None:
        """Let the agents of a record take part, before any of them is replayed."""
        for transport in transports.values():
            self._sent[transport.life], self._now[transport.life] = [], now
            transport.exchange = self
        self._running += 1

    def leave(self, name: str) -> None:
        """Let the agents of a record send nothing more: what they sent then, and did not send now, never comes."""
        self._running -= 1
        for life in self._traffic.sides[name].lives:
            sent, then = self._sent[life], self._traffic.sent[life]
            if name in self._stopped:
                self._part(life)
            elif life not in self._parted and len(sent) < len(then):
                self._miss(life)
        self._look_whether_all_wait()

    def send(self, agent: str, incarnation: int, key: str, body: bytes, *, answer: bool = False) -> None:
        """Have a message come in place of the one of its number; behind one that is not like that, nothing does."""
        life = agent, incarnation
        side = self._traffic.side_of[life]
        time = self._now[life]()
        if life in self._parted or side in self._stopped or time >= self._traffic.sides[side].until:
            return
        sent, then = self._sent[life], self._traffic.sent[life]
        old = then[len(sent)] if len(sent) < len(then) else None
        if old is None or (old.time, old.key, old.answer) != (time, key, answer) or (answer and old.body != body):
            until = time if old is None else min(time, old.time)
            self._limit(side, Limit(until, f"{agent} sends a message under {key}, and did not"))
            self._part(life)
            return
        sent.append(Sent(time, key, body, answer))
        for waiting in [each for each in self._waiting if (each.life, each.number) == (life, len(sent) - 1)]:
            self._waiting.remove(waiting)
            waiting.permit.set_result(None)

    async def comes(self, received: Received, incarnation: int, *, heard: bool = True) -> Received:
        """Return what is received in place of a message, once it was sent.

        Raises:
            PartedError: If it is not known.
        """
        if not heard:
            return received
        own = received.agent, incarnation
        side = self._traffic.side_of[own]
        self._look_what_was_missed(side)
        if own in self._parted:
            raise self._parting(side)
        life = life_of(received)
        if life not in self._traffic.side_of:
            told = f"{received.agent} received of {received.owner}, of whose life then no record is here"
            raise self._parting(side, Limit(received.time, told))
        if received.sent >= self._traffic.sides[self._traffic.side_of[life]].until:
            if received.key.endswith(f"/{FAREWELL}"):
                return received  # which says nothing but that its agent ends
            told = f"{received.agent} received what {received.owner} sent when its run, or its record, had ended"
            raise self._parting(side, Limit(received.time, told))
        number = self._traffic.number(received)
        if number is None:  # users' code sent it, on a channel of the program's own
            return received
        if number >= len(self._sent[life]):
            if life in self._parted:
                raise self._parting(side)
            waiting = _Waiting(side, received, life, number, asyncio.get_running_loop().create_future())
            self._waiting.append(waiting)
            self._look_whether_all_wait()
            await waiting.permit
        return msgspec.structs.replace(received, body=self._sent[life][number].body)

    def limits(self) -> dict[str, Limit]:
        """Return from when on nothing can be told of a record, by its name, where that is so."""
        return self._traffic.limits(self._limits)

    def _limit(self, side: str, limit: Limit) -> None:
        if side not in self._limits or limit.time < self._limits[side].time:
            self._limits[side] = limit

    def _parting(self, side: str, limit: Limit | None = None) -> PartedError:
        """Return the error that stops a replay; without a limit it follows from those of the others."""
        self._stopped.add(side)
        if limit is not None:
            self._limit(side, limit)
        return PartedError()

    def _part(self, life: Life) -> None:
        """Take it that no further message of an agent is known."""
        self._parted.add(life)
        for waiting in [each for each in self._waiting if each.life == life]:
            self._waiting.remove(waiting)
            waiting.permit.set_exception(self._parting(waiting.side))

    def _look_what_was_missed(self, side: str) -> None:
        """Find agents of a record that have not sent by now what they had sent before."""
        for life in self._traffic.sides[side].lives:
            sent, then = self._sent[life], self._traffic.sent[life]
            if life not in self._parted and len(sent) < len(then) and then[len(sent)].time < self._now[life]():
                self._miss(life)

    def _miss(self, life: Life) -> None:
        """Take it that an agent does not send its next message."""
        old = self._traffic.sent[life][len(self._sent[life])]
        side = self._traffic.side_of[life]
        self._limit(side, Limit(old.time, f"{life[0]} sent a message under {old.key}, and does not"))
        self._part(life)

    def _look_whether_all_wait(self) -> None:
        """Have one that waits for ever stop, where all do."""
        if self._waiting and len(self._waiting) == self._running:
            first = min(self._waiting, key=lambda waiting: waiting.received.sent)
            self._waiting.remove(first)
            told = f"{first.received.agent} received a message of {first.received.owner} that is not sent by then"
            first.permit.set_exception(self._parting(first.side, Limit(first.received.time, told)))
