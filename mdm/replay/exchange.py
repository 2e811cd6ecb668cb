"""The messages of a team whose agents are replayed together: each comes once the replay of its sender has sent it.

Their records have clocks of their own, which may show different times. An order there is all the same: each message was
sent before it was received. So an agent's replay waits, at a message that the record says it received, until the
sender's replay has sent it. Where all wait, none of these messages will be sent any more: one is handed on as it was
recorded, and told of.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.replay.traffic import Sent, Side, Traffic, life_of
from mdm.stimuli import Finished

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.replay.traffic import Life
    from mdm.replay.transport import ReplayTransport
    from mdm.stimuli import Received, Stimulus

__all__ = ["Exchange", "PartedError"]

_Content = tuple[str, bytes]
_Way = tuple[str, "Life", _Content]


class PartedError(Error):
    """Of a replay nothing can be told from here on: what it receives is not known."""


class Exchange:
    """Carries messages between the agents of a team that are replayed together."""

    def __init__(self) -> None:
        self._carried = 0
        self._missed: list[Received] = []
        self._sides: dict[str, Side] = {}
        self._until: dict[Life, int] = {}
        self._now: dict[Life, Callable[[], int]] = {}
        self._transports: dict[Life, ReplayTransport] = {}
        self._sent: dict[Life, Counter[_Content]] = {}
        self._log: dict[Life, list[Sent]] = {}
        self._taken: Counter[_Way] = Counter()
        self._relayed: list[Received] = []
        self._strange: Counter[str] = Counter()
        self._waiting: list[tuple[Received, asyncio.Future[None]]] = []
        self._running = 0

    def add(
        self,
        name: str,
        stimuli: Sequence[Stimulus],
        transports: Mapping[str, ReplayTransport],
        now: Callable[[], int],
    ) -> None:
        """Let the agents of a record take part, before any of them is replayed: up to where its run began to end.

        Args:
            name: The record's name.
            stimuli: Those of the record.
            transports: Of its agents.
            now: Returns the time of its replay.

        Raises:
            Error: If an agent has taken part in that life, by another record.
        """
        end = next((stimulus for stimulus in stimuli if isinstance(stimulus, Finished)), None)
        last = end.time if end is not None else max((stimulus.time for stimulus in stimuli), default=0)
        for transport in transports.values():
            life = transport.life
            if life in self._until:
                other = next(known for known, side in self._sides.items() if life in side.lives)
                raise Error(
                    f"{name} and {other} are both of agent {transport.agent!r} in the same life: records of one run "
                    f"have one for each agent"
                )
            self._until[life], self._transports[life], self._sent[life] = last, transport, Counter()
            self._now[life], self._log[life] = now, []
            transport.exchange = self
        self._sides[name] = Side(stimuli, tuple(transport.life for transport in transports.values()), last)
        self._running += 1

    def leave(self, name: str) -> None:
        """Let the agents of a record send nothing more."""
        self._running -= 1
        self._look_whether_all_wait()

    def send(self, agent: str, incarnation: int, key: str, body: bytes, *, answer: bool = False) -> None:
        """Have a message that was sent come to those who wait for it; an answer is in the record of who asked."""
        life = agent, incarnation
        if (time := self._now[life]()) < self._until[life]:
            self._log[life].append(Sent(time, key, body, answer))
        if answer:
            return
        self._sent[life][key, body] += 1
        for waiting in [*self._waiting]:
            if self._is_sent(waiting[0]):
                self._waiting.remove(waiting)
                waiting[1].set_result(None)

    async def comes(self, received: Received, incarnation: int, *, heard: bool = True) -> Received:
        """Return a message that an agent is about to receive, once the replay of its sender has sent it.

        Args:
            received: The message.
            incarnation: The number of the agent's life.
            heard: Whether anything in the agent's replay listens to it.
        """
        life = life_of(received)
        if received.owner == received.agent:
            return received
        if life not in self._until:
            self._strange[received.owner] += 1
            return received
        if received.sent >= self._until[life]:
            return received
        if not heard or self._transports[life].serves(received.key):  # on a channel, maybe by users' code
            self._relayed.append(received)
            return received
        self._carried += 1
        if not self._is_sent(received):
            permit = asyncio.get_running_loop().create_future()
            self._waiting.append((received, permit))
            self._look_whether_all_wait()
            await permit
        self._taken[_way(received)] += 1
        return received

    @property
    def traffic(self) -> Traffic:
        """What was sent."""
        return Traffic(self._sides, self._log)

    @property
    def strange(self) -> dict[str, int]:
        """How many messages came from agents in lives of which there is no record, by agent."""
        return dict(self._strange)

    @property
    def received(self) -> int:
        """How many messages came from agents that are replayed, too, as long as their records go."""
        return self._carried + len(self._repeated())

    @property
    def unlike(self) -> list[Received]:
        """Those of them that the replay of their sender has not sent, or not by then."""
        return [*self._missed, *(each for each in self._repeated() if not self._sent[life_of(each)][_content(each)])]

    @property
    def unrepeated(self) -> int:
        """How many more came on channels on which the replay of their sender says nothing: users' code did."""
        return len(self._relayed) - len(self._repeated())

    def _repeated(self) -> list[Received]:
        keys = {life: {key for key, _ in sent} for life, sent in self._sent.items()}
        return [each for each in self._relayed if each.key in keys[life_of(each)]]

    def _is_sent(self, received: Received) -> bool:
        """Whether it was sent, once more than this agent has received it."""
        return self._sent[life_of(received)][_content(received)] > self._taken[_way(received)]

    def _look_whether_all_wait(self) -> None:
        if self._waiting and len(self._waiting) == self._running:
            first = min(self._waiting, key=lambda waiting: waiting[0].sent)
            self._waiting.remove(first)
            self._missed.append(first[0])
            first[1].set_result(None)


def _content(received: Received) -> _Content:
    return received.key, bytes(received.body)


def _way(received: Received) -> _Way:
    return received.agent, life_of(received), _content(received)
