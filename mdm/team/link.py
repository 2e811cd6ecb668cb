"""The link: connects an agent with its team. It owns the transport, and delivers received messages to actors, in turns.

Liveness is by beats: each agent sends the agents that it hears several times a lease, from the event loop itself, so
that an agent whose loop is held is not taken for live, however well its transport keeps the connection. An agent is
live for another where both hear each other.

A beat has the configuration, too, which must be the same at all agents for them to decide together; of each ensemble,
a hash. Agents in which that differs are not live for each other. One of two, that which came later or has less company,
is refused besides: it takes no part until they agree, or the other has gone. No message ends an agent for that.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mdm.errors import Error
from mdm.runtime import Actor, Subscription
from mdm.stimuli import Joined, Opened, Received, Seen, Unsent
from mdm.team.configuration import Configuration
from mdm.team.transport.bounds import UNREADABLE, Life, Name, Number, Text
from mdm.team.transport.keys import join
from mdm.team.transport.transport import DOUBLE, LONGEST_CLOSE

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping

    from mdm.messages import Tick
    from mdm.runtime import Work
    from mdm.team.team import Team
    from mdm.team.transport.transport import Priority, Sample, Transport

FAREWELL = "leaving"
"""The channel on which an agent announces that it leaves in order."""

BEAT = "beat"
"""The channel of beats."""

BEATS = 5
"""Beats in a lease."""

_DOUBLED = 30_000_000_000
_FIRST_WAIT, _LONGEST_WAIT = 0.1, 1.0
_MOST_STRANGERS = 8

_SETTLED = 4.0
"""Seconds, beside a lease, after which an agent has been there longer than one that has just come."""


_TIME = struct.Struct("<q")
_CLOCK_PERIOD = 5.0
_CLOCK_ANSWER = 1.0

T = TypeVar("T")


class Beat(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A message that an agent sends several times a lease.

    Args:
        agents: The agents of its team.
        hears: The agents that it hears, by incarnation.
        facts: The configuration that must be the same at all agents.
        settled: Whether it has been there for some time.
        company: How many agents are live for it, itself included.
    """

    agents: tuple[Name, ...]
    hears: dict[Name, Life]
    facts: dict[Text, Text]
    settled: bool
    company: Number


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Beat).decode
_facts = msgspec.msgpack.Decoder(dict[Text, Text]).decode
_double = msgspec.msgpack.Decoder(tuple[Name, Life, Text]).decode


class Link(Actor):
    """The actor around a transport: opens it, hears it in turns, says farewell and closes it.

    It starts first and stops last of a member's actors, so that the others can still send at their end.

    Args:
        team: The team.
        transport: The transport of one of its agents.
        facts: The configuration, by name: facts that must be the same at all agents that have them.

    Attributes:
        live: The agents that this one hears and that hear it, by incarnation, itself included; without those who said
            that they leave.
        left: Those who have left in order, with the incarnation that has.
        joined: The agents that have been live, with the incarnation that was last, and have not left in order since.
        opened: Whether the transport is open.
        leaving: Whether this agent has said that it leaves.
        met: Whether more than half of the agents, this one included, have been live at once in this life; or a person
            has said that it goes on without them.
        configuration: Which agents have another configuration.
    """

    def __init__(
        self, team: Team, transport: Transport, facts: Mapping[str, str] | None = None, *, name: str = "link"
    ) -> None:
        super().__init__(name)
        self.team = team
        self.transport = transport
        self.agent = transport.agent
        self.live: dict[str, int] = {}
        self.left: dict[str, int] = {}
        self.joined: dict[str, int] = {}
        self.opened = self.met = False
        self._puts = 0
        self.configuration = Configuration(transport.agent, facts or {})
        self._left_at: dict[str, int] = {}
        self._doubles: dict[str, tuple[str, int]] = {}
        self._since = 0
        self.leaving = False
        self._refused: set[str] = set()
        self._strangers: set[str] = set()
        self._seen: Mapping[str, int] = {}
        self._heard_at: dict[str, int] = {}
        self._beats: dict[str, tuple[int, bool]] = {}
        self._lease = round(team.lease * 1e9)
        self._heard: dict[str, list[Subscription[Any]]] = {}
        self._watching: list[Subscription[Any]] = []
        self._opening: Work | None = None
        transport.serve(self.key(DOUBLE), self._on_double)

    def key(self, *rest: str) -> str:
        """Return a key of this agent."""
        return join(self.team.name, self.agent, *rest)

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Take failures of the transport's handlers as this actor's, and report dropped messages."""
        transport, facts = self.transport, dict(self.configuration.facts)
        joined = (self.agent, transport.incarnation, facts, transport.protocol)
        self.runtime.observers.tell(Joined, self.runtime.now(), *joined)
        self.transport.supervise(self.fail, self.report)
        turn: Subscription[Any] = Subscription(None, self, self._on_seen)
        self.transport.watch(lambda message: self.runtime.dispatcher.deliver(turn, message))
        self.listen(join(self.team.name, "*", FAREWELL), self._on_farewell, self)
        self.listen(join(self.team.name, "*", BEAT), self._on_beat, self)
        self.every(BEATS / self.team.lease, self._on_tick)

    def connect(self) -> None:
        """Open the transport, beside the loop; a failure to open is this actor's failure."""
        self._opening = self.spawn(self._open(), name="open")

    async def _open(self) -> None:
        await self.transport.open()
        self.runtime.dispatcher.deliver(Subscription(None, self, self._on_open), None)

    def _on_open(self, _: None) -> None:
        self.opened = True
        self.runtime.observers.tell(Opened, self.runtime.now(), self.agent)
        self._since = self.runtime.now()
        self._beat()
        self._notify()

    def send_farewell(self) -> None:
        """Announce that this agent leaves in order: it sends nothing more, and the others do not wait for it."""
        if self.opened and not self.leaving:
            self.transport.put(self.key(FAREWELL), b"", priority="step")
        self.leaving = True

    @property
    def ages(self) -> dict[str, float]:
        """For how many seconds nothing was heard of each other agent that ever was, by the loop's time."""
        now = self.runtime.now()
        return {agent: (now - at) / 1e9 for agent, at in self._heard_at.items() if agent in self.team.names}

    @property
    def refusal(self) -> str | None:
        """Why this agent takes no part in the team now; None where it does."""
        return self.configuration.refusal

    def is_live(self, sample: Sample) -> bool:
        """Return whether a message is of an agent that is live, in this life: it has the same configuration."""
        return self.live.get(sample.owner) == sample.incarnation

    @property
    def patience(self) -> float:
        """Seconds within which the transport closes."""
        return LONGEST_CLOSE

    async def on_stopping(self) -> None:
        """Close the transport."""
        if self._opening is not None and not self._opening.done:
            self._opening.cancel()
        self.opened = False
        await self.transport.close()

    def on_stop(self) -> None:
        """Bring nothing more to anybody."""
        self.drop([*self._watching, *(one for known in self._heard.values() for one in known)])

    # -- Messages ------------------------------------------------------------------------------------------------

    def send(self, key: str, body: bytes, *, priority: Priority = "value") -> bool:
        """Send a message under a key of this agent; False where it was not sent.

        One that is too large for every receiver is reported, once for each key.
        """
        if not self.opened or self.leaving:
            return False
        self._puts += 1
        try:
            sent = self.transport.put(key, body, priority=priority)
        except Error as error:
            sent = False
            if key not in self._refused:
                self._refused.add(key)
                self.report("oversize", str(error))
        if not sent:
            self.runtime.observers.tell(Unsent, self.runtime.now(), self.agent, self._puts)
        return sent

    def refuse_sample(self, sample: Sample, reason: str) -> None:
        """Drop a message whose fields are none that can be, and count it by its sender."""
        self.transport.refuse(sample.owner, f"a message under {sample.key} {reason}")

    def listen(self, expression: str, handler: Callable[[Sample], None], actor: Actor) -> Subscription[Sample]:
        """Handle each message under the keys of an expression in a turn of an actor, until it is cancelled."""
        subscription: Subscription[Sample] = Subscription(None, actor, handler)
        known = self._heard.get(expression)
        if known is None:
            known = self._heard[expression] = []
            self.transport.subscribe(expression, self._hand_on(expression, known))
        known.append(subscription)
        return subscription

    def _hand_on(self, expression: str, heard: list[Subscription[Any]]) -> Callable[[Sample], None]:
        """Return a function that hands on a message in a turn of its own, to all who listen to an expression."""
        dispatcher, heard_at = self.runtime.dispatcher, self._heard_at
        queue, clock = dispatcher.queue, dispatcher.clock

        def take(sample: Sample) -> None:
            time = dispatcher.time
            if dispatcher.observed:
                life, sent, body = sample.incarnation, sample.time, sample.body
                dispatcher.observers.stimulus(
                    Received(time, self.agent, expression, sample.key, sample.owner, life, sent, bytes(body))
                )
            heard_at[sample.owner] = time
            for one in heard:
                queue.append((one, sample))

        turn: Subscription[Sample] = Subscription(None, self, take)

        def receive(sample: Sample) -> None:
            # Each message of a step comes here. It begins a turn as `Dispatcher.deliver` does, whose first handler is
            # already the listener's: that takes a third less than a turn of the link's from which others are called.
            if dispatcher.time >= 0 or dispatcher.active or dispatcher.observed:
                dispatcher.deliver(turn, sample)
                return
            time = dispatcher.now()
            if time >= clock.due and clock.firing < 0:
                clock.fire_before(time)
            dispatcher.time = dispatcher.last = heard_at[sample.owner] = time
            for one in heard:
                queue.append((one, sample))
            dispatcher.run()

        return receive

    def drop(self, subscriptions: Iterable[Subscription[Any]]) -> None:
        """Bring no more to these."""
        for subscription in subscriptions:
            subscription.cancel()
            for known in (self._watching, *self._heard.values()):
                if subscription in known:
                    known.remove(subscription)

    def ask(self, expression: str, body: bytes = b"", *, seconds: float = 1.0) -> Awaitable[dict[str, bytes]]:
        """Ask all who serve the keys of an expression; the answers come by agent."""
        return self.transport.ask(expression, body, timeout=seconds)

    async def ask_one(self, agent: str, key: str, body: bytes, decode: Callable[[bytes], T]) -> T:
        """Ask an agent until its answer can be decoded, at first soon again, then once a second."""
        clock, wait = self.runtime.clock, _FIRST_WAIT
        while True:
            until = clock.now() + round(wait * 1e9)
            answers = await self.ask(key, body, seconds=wait)
            with suppress(KeyError, *UNREADABLE):
                return decode(answers[agent])
            await clock.sleep(max(until - clock.now(), 0) / 1e9)  # where nobody was there to wait for
            wait = min(2 * wait, _LONGEST_WAIT)

    # -- Liveness ------------------------------------------------------------------------------------------------

    def watch(self, handler: Callable[[Link], None], actor: Actor) -> Subscription[Link]:
        """Call in a turn of an actor when `live` has changed, and now where the link is open."""
        subscription: Subscription[Link] = Subscription(None, actor, handler)
        self._watching.append(subscription)
        if self.opened:
            self.runtime.dispatcher.deliver(subscription, self)
        return subscription

    def _on_seen(self, seen: Mapping[str, int]) -> None:
        self.runtime.observers.tell(Seen, self.runtime.now(), self.agent, dict(seen))
        self._seen = seen
        self.left = {agent: life for agent, life in self.left.items() if seen.get(agent, life) == life}
        if self.opened:
            self._beat()
            self._notify()

    def _beat(self) -> None:
        """Send the agents that this one hears."""
        hears = {agent: life for agent, (life, _) in self._beats.items()}
        settled, company = self._standing()
        beat = Beat(self.team.names, hears, self.configuration.facts, settled, company)
        self.send(self.key(BEAT), _encode(beat), priority="step")

    def _standing(self) -> tuple[bool, int]:
        return self.runtime.now() - self._since > self._lease + _SETTLED * 1e9, max(len(self.live), 1)

    def _opened(self, sample: Sample) -> Beat | None:
        if self._seen.get(sample.owner, sample.incarnation) != sample.incarnation:
            return None  # of a life that is not here, or not yet: it beats again
        try:
            return _decode(sample.body)
        except UNREADABLE:
            if sample.owner in self.team.names:
                self.refuse_sample(sample, "is no beat")
            return None

    def _on_beat(self, sample: Sample) -> None:
        beat = self._opened(sample)
        stranger = sample.owner not in self.team.names
        if stranger:
            self._report_stranger(sample.owner)
        many = len(self.configuration.differing) > _MOST_STRANGERS
        if beat is None or (stranger and (many or self.agent not in beat.agents)):
            return
        told = self.configuration.difference(sample.owner, beat.facts)
        if told is not None:
            if self._beats.get(sample.owner, (None, False))[0] == sample.incarnation:
                self.refuse_sample(sample, f"says what its agent did not say before in this life: {told}")
            else:
                self._part(sample, beat, told)
        if stranger or told is not None:
            return
        if self.configuration.agree(sample.owner):
            self._notify(changed=True)
        back = self.left.get(sample.owner) == sample.incarnation and sample.time > self._left_at[sample.owner]
        if back:
            del self.left[sample.owner]  # who beats has not left: another said so in its name
        old = self._beats.get(sample.owner)
        new = (sample.incarnation, beat.hears.get(self.agent) == self.transport.incarnation)
        self._beats[sample.owner] = new
        if old is None or old[0] != new[0]:
            self._beat()  # so that it soon knows that it is heard
        if old != new or back:
            self._notify()

    def _report_stranger(self, name: str) -> None:
        """Say once that there is one who takes himself for an agent of this team; nobody lives for him here."""
        self._heard_at.pop(name, None)
        if name not in self._strangers and len(self._strangers) < _MOST_STRANGERS:
            self._strangers.add(name)
            self.report(
                "stranger",
                f"agent {name!r} says that it is of team {self.team.name!r}, whose agents are "
                f"{', '.join(self.team.names)} here: the team's name, or the file, is another one there",
            )

    def _on_double(self, question: bytes) -> bytes:
        """Return where a live agent listens whose name another process has; it asks where it has met nobody."""
        with suppress(*UNREADABLE):
            agent, life, endpoint = _double(question)
            if self.live.get(agent, life) != life:
                self.tell_double(agent, endpoint, told=agent == self.agent)  # the transport has reported it then
                return self.team.endpoints()[agent].encode()
        return b""

    def tell_double(self, agent: str, endpoint: str, *, told: bool = False) -> None:
        """Know of a second process of an agent's name; report it, once while it is there."""
        told = told or agent in self.doubles
        self._doubles[agent] = endpoint, self.runtime.now()
        if not told:
            known = self.team.endpoints()[agent]
            self.report("duplicate", f"two robots are called {agent!r}: at {known} and {endpoint}")

    @property
    def doubles(self) -> dict[str, str]:
        """Where other processes listen that have the names of agents, by the agent."""
        since = self.runtime.now() - _DOUBLED
        return {agent: endpoint for agent, (endpoint, time) in self._doubles.items() if time > since}

    def _part(self, sample: Sample, beat: Beat, told: str) -> None:
        """Part with an agent of another configuration, and have the difference reported."""
        other, life, configuration = sample.owner, sample.incarnation, self.configuration
        if not self.opened or self.left.get(other) == life:
            return
        theirs = (beat.settled, beat.company)
        if configuration.part(other, life, told, self._standing(), theirs, self.runtime.now()):
            self._beats.pop(other, None)
            self.spawn(self._report_difference(other, life, beat.facts), name="compare")
            self._notify(changed=True)

    async def _report_difference(self, other: str, life: int, facts: Mapping[str, str]) -> None:
        """Report in words the first difference to another agent; of an ensemble, the fact behind its hash."""
        configuration = self.configuration
        told = configuration.difference(other, facts) or ""
        ensemble = configuration.ensemble(facts)
        if ensemble is not None:
            answers = await self.ask(join(self.team.name, other, ensemble, "configuration"))
            with suppress(KeyError, *UNREADABLE):
                told = configuration.explain(other, ensemble, _facts(answers[other])) or told
        if configuration.differing.get(other) == life:
            refused = configuration.refuses(other)
            if refused:
                configuration.refuse(other, told)
            self.report("refused", f"{self.agent if refused else other} cannot take part in the team: {told}")
            self._notify(changed=refused)

    def _on_tick(self, tick: Tick) -> None:
        if not tick.missed:  # else messages that came meanwhile have yet to be heard
            now = self.runtime.now()
            silent = [agent for agent in self._beats if now - self._heard_at.get(agent, 0) > self._lease]
            for agent in silent:
                del self._beats[agent]
            gone = self.configuration.expire(now - self._lease)
            if silent or gone:
                self._notify(changed=gone)
        if self.opened:
            self._beat()

    def _on_farewell(self, sample: Sample) -> None:
        if sample.incarnation != self._seen.get(sample.owner):
            self.refuse_sample(sample, "is a farewell of a life that is not here")
            return
        self.left[sample.owner] = sample.incarnation
        self._left_at[sample.owner] = min(sample.time, self.runtime.now())
        differed = self.configuration.agree(sample.owner)
        joined = self.joined.get(sample.owner) == sample.incarnation
        if joined:  # else it was refused or never live, and its former life is lost as before
            del self.joined[sample.owner]
        self._notify(changed=differed or joined)

    def go_without(self) -> None:
        """Take a person's word that the agents which were never met are not to be waited for."""
        self.met = True
        self._notify(changed=True)

    def whereabouts(self, agent: str) -> str:
        """Return in words where an agent is that is not live."""
        if agent in self.joined:
            return "is lost"
        if agent in self.left:
            return "has left"
        return "was not seen so far"

    def _notify(self, *, changed: bool = False) -> None:
        """Notify watchers if the live agents have changed; or who is refused or has left, which the caller knows."""
        if not self.opened:
            return
        live = {
            agent: life
            for agent, life in self._seen.items()
            if self.left.get(agent) != life and self._beats.get(agent) == (life, True)
        }
        if self.refusal is not None:
            live.clear()
        live[self.agent] = self.transport.incarnation
        live = {agent: live[agent] for agent in self.team.names if agent in live}
        self.joined |= live
        self.met = self.met or 2 * len(live) > len(self.team.names)
        if len(live) > 1:
            self.configuration.last_refusal = None
        if live != self.live or changed:
            self.live = live
            for subscription in tuple(self._watching):
                self.runtime.dispatcher.deliver(subscription, self)


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

    An agent asks another for its time. The answer was given somewhere between question and answer, so that half of the
    time of both is how much the offset may be wrong.

    Ticks are at multiples of the period on each agent's own clock. Where a clock is off by more than half a period, or
    by more than a step waits, its agent's input comes too late or counts for another step: it reports a fault
    ``clock``, once until it agrees again, and once more where the time of day of its own machine was put right
    meanwhile. Where that is ahead at two measurements, one after the other, and no other agent has the old time, this
    one goes on by it; it never goes back.

    Args:
        link: The connection of the agent to the others.

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
        # Of agents that are too far off: whether this one's own clock had been put right when that was told.
        self._off: dict[str, bool] = {}
        self._behind = False
        link.transport.serve(link.key("clock"), lambda _: _TIME.pack(self.time()))

    def on_start(self) -> None:
        """Ask the others for their time."""
        self._lives.clear()
        self._watching = self._link.watch(self._on_live, self)
        self.every(1 / _CLOCK_PERIOD, self._on_tick)

    def on_stop(self) -> None:
        """Ask no more."""
        self._link.drop([self._watching])

    def time(self) -> int:
        """Return the time by this agent's clock, in nanoseconds."""
        return self.runtime.now()

    def _on_live(self, link: Link) -> None:
        new = [agent for agent, life in link.live.items() if agent != link.agent and self._lives.get(agent) != life]
        self._lives = dict(link.live)
        self.offsets = {agent: offset for agent, offset in self.offsets.items() if agent in link.live}
        self._off = {agent: told for agent, told in self._off.items() if agent in link.live}
        self._ask(new)

    def _on_tick(self, _: Tick) -> None:
        clock, agree = self.runtime.clock, any(abs(each.seconds) <= self.limit for each in self.offsets.values())
        corrected = clock.corrected() / 1e9
        lasts, self._behind = self._behind, corrected > self.limit and not agree
        if lasts and self._behind:
            self._behind = False
            clock.catch_up()
            self.report(
                "clock", f"the clock of {self._link.agent} went on by {corrected:.3f} s, to the time of day here"
            )
        self._ask([agent for agent in self._link.live if agent != self._link.agent])

    def _ask(self, agents: list[str]) -> None:
        if self._link.opened:
            for agent in agents:
                self.spawn(self._measure(agent), name=f"clock of {agent}")

    async def _measure(self, agent: str) -> None:
        began, answers = self.time(), {}
        with suppress(Error):  # the transport has closed meanwhile
            answers = await self._link.ask(join(self._link.team.name, agent, "clock"), seconds=_CLOCK_ANSWER)
        ended = self.time()
        answer = answers.get(agent, b"")
        if len(answer) == _TIME.size and agent in self._link.live:
            [theirs] = _TIME.unpack(answer)
            self._note(agent, Offset((theirs - (began + ended) / 2) / 1e9, (ended - began) / 2e9))

    def _note(self, agent: str, offset: Offset) -> None:
        self.offsets[agent] = offset
        off = abs(offset.seconds)
        if off + offset.error <= self.limit:
            self._off.pop(agent, None)
            return
        corrected = self.runtime.clock.corrected() / 1e9
        own = abs(corrected) > self.limit
        if off - offset.error > self.limit and self._off.get(agent) is not own:
            self._off[agent] = own
            way = "ahead of" if offset.seconds > 0 else "behind"
            cure = "synchronise the clocks"
            if own:
                cure = (
                    f"the time of day here was put right by {corrected:.3f} s since the start: start this agent again"
                )
                cure += ", unless it takes that up within 10 s" if corrected > 0 else ""
            self.report(
                "clock",
                f"the clock of {agent} is {off:.3f} s {way} that of {self._link.agent}, and the team allows for "
                f"{self.limit:g} s: what they see counts for other steps, or for none: {cure}",
            )
