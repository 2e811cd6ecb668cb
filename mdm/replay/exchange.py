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

from mdm.recording.stimuli import Finished

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.recording.stimuli import Received, Stimulus
    from mdm.replay.transport import ReplayTransport

__all__ = ["Exchange"]

_Life = tuple[str, int]
_Content = tuple[str, bytes]
_Way = tuple[str, _Life, _Content]


class Exchange:
    """Carries messages between the agents of a team that are replayed together."""

    def __init__(self) -> None:
        self._carried = 0
        self._missed: list[Received] = []
        self._until: dict[_Life, int] = {}
        self._transports: dict[_Life, ReplayTransport] = {}
        self._sent: dict[_Life, Counter[_Content]] = {}
        self._taken: Counter[_Way] = Counter()
        self._relayed: list[Received] = []
        self._waiting: list[tuple[Received, asyncio.Future[None]]] = []
        self._running = 0

    def add(self, stimuli: Sequence[Stimulus], transports: Mapping[str, ReplayTransport]) -> None:
        """Let the agents of a record take part, before any of them is replayed: up to where its run began to end."""
        end = next((stimulus for stimulus in stimuli if isinstance(stimulus, Finished)), None)
        last = end.time if end is not None else max((stimulus.time for stimulus in stimuli), default=0)
        for agent, transport in transports.items():
            life = agent, transport.incarnation
            self._until[life], self._transports[life], self._sent[life] = last, transport, Counter()
            transport.exchange = self
        self._running += 1

    def leave(self) -> None:
        """Let the agents of a record send nothing more."""
        self._running -= 1
        self._look_whether_all_wait()

    def send(self, agent: str, incarnation: int, key: str, body: bytes) -> None:
        """Have a message that was sent come to those who wait for it."""
        self._sent[agent, incarnation][key, body] += 1
        for waiting in [*self._waiting]:
            if self._is_sent(waiting[0]):
                self._waiting.remove(waiting)
                waiting[1].set_result(None)

    async def comes(self, received: Received, *, heard: bool = True) -> None:
        """Wait until the replay of its sender has sent a message that an agent is about to receive.

        Args:
            received: The message.
            heard: Whether anything in the agent's replay listens to it.
        """
        life = _life_of(received)
        if received.owner == received.agent or life not in self._until or received.sent >= self._until[life]:
            return
        if not heard or self._transports[life].serves(received.key):  # on a channel, maybe by users' code
            self._relayed.append(received)
            return
        self._carried += 1
        if not self._is_sent(received):
            permit = asyncio.get_running_loop().create_future()
            self._waiting.append((received, permit))
            self._look_whether_all_wait()
            await permit
        self._taken[_way(received)] += 1

    @property
    def received(self) -> int:
        """How many messages came from agents that are replayed, too, as long as their records go."""
        return self._carried + len(self._repeated())

    @property
    def unlike(self) -> list[Received]:
        """Those of them that the replay of their sender has not sent, or not by then."""
        return [*self._missed, *(each for each in self._repeated() if not self._sent[_life_of(each)][_content(each)])]

    @property
    def unrepeated(self) -> int:
        """How many more came on channels on which the replay of their sender says nothing: users' code did."""
        return len(self._relayed) - len(self._repeated())

    def _repeated(self) -> list[Received]:
        keys = {life: {key for key, _ in sent} for life, sent in self._sent.items()}
        return [each for each in self._relayed if each.key in keys[_life_of(each)]]

    def _is_sent(self, received: Received) -> bool:
        """Whether it was sent, once more than this agent has received it."""
        return self._sent[_life_of(received)][_content(received)] > self._taken[_way(received)]

    def _look_whether_all_wait(self) -> None:
        if self._waiting and len(self._waiting) == self._running:
            first = min(self._waiting, key=lambda waiting: waiting[0].sent)
            self._waiting.remove(first)
            self._missed.append(first[0])
            first[1].set_result(None)


def _life_of(received: Received) -> _Life:
    return received.owner, received.incarnation


def _content(received: Received) -> _Content:
    return received.key, bytes(received.body)


def _way(received: Received) -> _Way:
    return received.agent, _life_of(received), _content(received)
