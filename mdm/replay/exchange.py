"""The messages of a team whose agents are replayed together: each comes once the replay of its sender has sent it.

Their records have clocks of their own, which may show different times. An order there is all the same: each message was
sent before it was received. So an agent's replay waits, at a message that the record says it received, until the
sender's replay has sent it. Where all wait, none of these messages will be sent any more.

With another configuration (`Otherwise`), the message of a number stands in place of the one that had it. As long as the
agents send under the same keys at the same times as they did, this is a run that the team would have had on the same
network: with the same delays and losses, and the same input of its sensors. Once an agent sends otherwise, nothing says
when its teammates would receive that, and how they would answer: `Traffic.limits` says up to when each of them cannot
have received any of it.
"""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from mdm.errors import Error
from mdm.runtime.statistics import Latencies
from mdm.stimuli import Finished, Received
from mdm.team.link import FAREWELL
from mdm.team.transport.transport import PROTOCOL, Sample, TransportStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.stimuli import Asked, Stimulus
    from mdm.team.transport.transport import Priority

Life = tuple[str, int]
"""An agent, and the number of its life."""


class Sent(NamedTuple):
    """A message that was sent.

    Attributes:
        time: When, by the clock of the sender's record.
        key: Under which key.
        body: Its content.
        answer: Whether it is the answer to a request.
    """

    time: int
    key: str
    body: bytes
    answer: bool = False


class Side(NamedTuple):
    """One record of several that are replayed together.

    Attributes:
        stimuli: Those of the record.
        lives: The agents in it.
        until: When its run began to end.
    """

    stimuli: Sequence[Stimulus]
    lives: tuple[Life, ...]
    until: int


class Limit(NamedTuple):
    """From when on nothing can be told of a replay.

    Attributes:
        time: By the clock of the record, in nanoseconds.
        reason: Why, in words: a message that an agent would not have sent so, and that others may have received.
    """

    time: int
    reason: str


class Traffic:
    """The messages of a replay in which everything came as it was recorded.

    Args:
        sides: The records by their names.
        sent: The messages of each agent until its run began to end, in its order.
    """

    def __init__(self, sides: Mapping[str, Side], sent: Mapping[Life, Sequence[Sent]]) -> None:
        self.sides, self.sent = sides, sent
        self.side_of = {life: name for name, side in sides.items() for life in side.lives}
        self._places: dict[Life, dict[tuple[str, bytes], list[int]]] = {}
        for life, messages in sent.items():
            places = self._places[life] = defaultdict(list)
            for number, message in enumerate(messages):
                if not message.answer:
                    places[message.key, message.body].append(number)

    def number(self, received: Received) -> int | None:
        """Return which of its sender's messages was received; None where the replay has not sent it.

        Of several that are the same it is the last that was sent by then.
        """
        life = life_of(received)
        places = self._places.get(life, {}).get((received.key, bytes(received.body)))
        if not places:
            return None
        sent = self.sent[life]
        return places[max(bisect_right(places, received.sent, key=lambda place: sent[place].time) - 1, 0)]

    def limits(self, known: Mapping[str, Limit]) -> dict[str, Limit]:
        """Return from when on nothing can be told of each record, where that is so.

        Of an agent whose messages are not known from some time on, another one received the last that is known; the
        next one, which is not known, may have come at any time behind it, for messages keep their order.

        Args:
            known: From when on an agent sends otherwise, or receives messages that are not known, by the record.
        """
        heard = {name: self._heard(side) for name, side in self.sides.items()}
        limits: dict[str, Limit] = {}
        for name, limit in known.items():
            for other, each in self._following(name, limit, heard).items():
                if other not in limits or each.time < limits[other].time:
                    limits[other] = each
        return limits

    def _following(
        self, first: str, limit: Limit, heard: Mapping[str, Mapping[Life, list[tuple[int, int]]]]
    ) -> dict[str, Limit]:
        """Return the limits of all records that follow from one; before that, nothing comes back to its own agents."""
        limits = {first: limit}
        changed = True
        while changed:
            changed = False
            for name, side in self.sides.items():
                for life, received in heard[name].items():
                    other = self.side_of[life]
                    if name in {first, other} or other not in limits:
                        continue
                    sent = bisect_left(self.sent[life], limits[other].time, key=lambda message: message.time)
                    last = None
                    for place, number in received:
                        if number >= sent:
                            break
                        last = place
                    time = side.stimuli[0].time if last is None else _behind(side.stimuli, last)
                    if name not in limits or time < limits[name].time:
                        limits[name] = Limit(time, limit.reason)
                        changed = True
        return limits

    def _heard(self, side: Side) -> dict[Life, list[tuple[int, int]]]:
        """Return by sender the places of received messages among the stimuli, with their numbers."""
        found: dict[Life, list[tuple[int, int]]] = defaultdict(list)
        for place, stimulus in enumerate(side.stimuli):
            if isinstance(stimulus, Received) and life_of(stimulus) in self.side_of:
                number = self.number(stimulus)
                if number is not None:
                    found[life_of(stimulus)].append((place, number))
        return found


def life_of(received: Received) -> Life:
    """Return whose message it is."""
    return received.owner, received.incarnation


def _behind(stimuli: Sequence[Stimulus], place: int) -> int:
    """Return the time behind a stimulus; its own where the next one has that, too."""
    time = stimuli[place].time
    return time if place + 1 < len(stimuli) and stimuli[place + 1].time == time else time + 1


_Content = tuple[str, bytes]
_Way = tuple[str, "Life", _Content]


class PartedError(Error):
    """Nothing can be told of a replay from here on: its next message is not known."""


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
        """Bring a message to those who wait for it; an answer is in the record of who asked."""
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
        """All messages that were sent."""
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


class _Waiting(NamedTuple):
    side: str
    received: Received
    life: Life
    number: int
    permit: asyncio.Future[None]


class Otherwise:
    """Carries messages between agents of another configuration, in place of those that were sent.

    Args:
        traffic: The messages that were sent with the configuration that the agents had.
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
        """Let the agents of a record send nothing more: messages that they sent only then never come."""
        self._running -= 1
        for life in self._traffic.sides[name].lives:
            sent, then = self._sent[life], self._traffic.sent[life]
            if name in self._stopped:
                self._part(life)
            elif life not in self._parted and len(sent) < len(then):
                self._miss(life)
        self._look_whether_all_wait()

    def send(self, agent: str, incarnation: int, key: str, body: bytes, *, answer: bool = False) -> None:
        """Bring a message in place of the one of its number; behind one that is not like that, nothing comes."""
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
        """Return the message in place of one that was received, once it was sent.

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
        """Note that no further message of an agent is known."""
        self._parted.add(life)
        for waiting in [each for each in self._waiting if each.life == life]:
            self._waiting.remove(waiting)
            waiting.permit.set_exception(self._parting(waiting.side))

    def _look_what_was_missed(self, side: str) -> None:
        """Find agents of a record whose next message is overdue."""
        for life in self._traffic.sides[side].lives:
            sent, then = self._sent[life], self._traffic.sent[life]
            if life not in self._parted and len(sent) < len(then) and then[len(sent)].time < self._now[life]():
                self._miss(life)

    def _miss(self, life: Life) -> None:
        """Note that an agent does not send its next message."""
        old = self._traffic.sent[life][len(self._sent[life])]
        side = self._traffic.side_of[life]
        self._limit(side, Limit(old.time, f"{life[0]} sent a message under {old.key}, and does not"))
        self._part(life)

    def _look_whether_all_wait(self) -> None:
        """Stop one that waits for ever, where all do."""
        if self._waiting and len(self._waiting) == self._running:
            first = min(self._waiting, key=lambda waiting: waiting.received.sent)
            self._waiting.remove(first)
            told = f"{first.received.agent} received a message of {first.received.owner} that is not sent by then"
            first.permit.set_exception(self._parting(first.side, Limit(first.received.time, told)))


class ReplayTransport:
    """Carries the messages of a record to one agent.

    Args:
        agent: The agent.
        incarnation: The number of its recorded life.
        unsent: The numbers of its messages that were held back.
        protocol: The version of its messages.

    Attributes:
        exchange: Brings its messages to other agents that are replayed together with it, where there are any.
    """

    def __init__(
        self, agent: str, incarnation: int, unsent: frozenset[int] = frozenset(), protocol: int = PROTOCOL
    ) -> None:
        self.agent = agent
        self.incarnation = incarnation
        self.protocol = protocol
        self._unsent = unsent
        self._puts = 0
        self.exchange: Exchange | Otherwise | None = None
        self._answering: dict[str, Callable[[bytes], bytes]] = {}
        self._handlers: dict[str, Callable[[Sample], None]] = {}
        self._watchers: list[Callable[[Mapping[str, int]], None]] = []
        self._opened = asyncio.Event()

    @property
    def life(self) -> Life:
        """The agent, and the number of its recorded life."""
        return self.agent, self.incarnation

    async def open(self) -> None:
        """Wait until the record's link was open."""
        await self._opened.wait()

    async def close(self) -> None:
        """Leave."""

    def release(self) -> None:
        """Let it be open."""
        self._opened.set()

    def hears(self, expression: str) -> bool:
        """Whether anything listens to the keys of an expression."""
        return expression in self._handlers

    def receive(self, received: Received) -> None:
        """Hand a recorded message on."""
        handler = self._handlers.get(received.expression)
        if handler is not None:
            sample = Sample(received.key, received.owner, received.incarnation, received.body, received.sent)
            handler(sample)

    def see(self, live: Mapping[str, int]) -> None:
        """Tell which agents were live."""
        for watcher in self._watchers:
            watcher(live)

    def put(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send to agents that are replayed together with this one; return whether it was sent then."""
        self._puts += 1
        if self._puts in self._unsent:
            return False
        if self.exchange is not None:
            self.exchange.send(*self.life, key, bytes(body))
        return True

    def subscribe(self, expression: str, handler: Callable[[Sample], None]) -> None:
        """Call a handler with each recorded message under the keys of an expression."""
        self._handlers[expression] = handler

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Call a function with each recorded request under a key; nobody hears the answer."""
        self._answering[key] = answer

    def serves(self, key: str) -> bool:
        """Whether requests under a key are answered."""
        return key in self._answering

    def request(self, asked: Asked) -> None:
        """Hand a recorded request on."""
        answer = self._answering.get(asked.key)
        if answer is not None:
            told = answer(asked.body)
            if self.exchange is not None:
                self.exchange.send(*self.life, asked.key, bytes(told), answer=True)

    async def ask(self, expression: str, body: bytes = b"", *, timeout: float = 1.0) -> dict[str, bytes]:  # noqa: ASYNC109
        """Wait for ever: answers that count are in the record by themselves."""
        await asyncio.get_running_loop().create_future()
        return {}

    def watch(self, handler: Callable[[Mapping[str, int]], None]) -> None:
        """Call a handler with the live agents."""
        self._watchers.append(handler)

    def supervise(self, failed: Callable[[BaseException], None], report: Callable[[str, str], None]) -> None:
        """Report nothing."""

    def refuse(self, sender: str, reason: str) -> None:
        """Take note of nothing."""

    def statistics(self) -> TransportStatistics:
        """Return no counts."""
        return TransportStatistics({}, {}, {}, {}, {}, Latencies().snapshot(), {})
