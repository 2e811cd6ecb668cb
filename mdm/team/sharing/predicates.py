"""Predicates and events of other agents: known here as ``agent/Name``.

A subscriber asks their owner for them, once, and is sent each change from then on, and all values four times within
the team's ``max_age``: that repairs losses, without asking again. A predicate is unknown when nothing
was heard of its owner for ``max_age``, or the owner is gone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import msgspec

from mdm.logic import similar
from mdm.messages import EventUpdate, PredicateMap, PredicateUpdate
from mdm.runtime import Actor, Subscription
from mdm.stimuli import Answered, Asked
from mdm.team.transport.bounds import UNREADABLE, Name, Number, Text
from mdm.team.transport.keys import join

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from mdm.actors import PredicateManager
    from mdm.runtime import Channel, Runtime, Timer, Work
    from mdm.team.link import Link
    from mdm.team.transport.transport import Sample

PREDICATES = "predicates"

_MOST_HINTS = 16
"""Names that there are not for which similar ones are looked for: it takes time."""


Names: TypeAlias = Annotated[tuple[Name, ...], msgspec.Meta(max_length=1024)]


class Request(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The predicates and events that a subscriber asks for, by name."""

    predicates: Names
    events: Names


class Reply(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The number of the last change, the values by then, and the names that there are not, each with a hint."""

    number: Number
    values: dict[Name, bool | None]
    unknown: Annotated[dict[Name, Text], msgspec.Meta(max_length=2048)]


class Change(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Changes and events, numbered from 1; or all values by then, with the number of the last change."""

    number: Number
    time: Number
    values: dict[Name, bool | None] = {}
    events: tuple[Name, ...] = ()


_encode = msgspec.msgpack.Encoder().encode
_request = msgspec.msgpack.Decoder(Request).decode
_reply = msgspec.msgpack.Decoder(Reply).decode
_change = msgspec.msgpack.Decoder(Change).decode


def wanted(manager: PredicateManager, agents: Iterable[str]) -> dict[str, Request]:
    """Return the predicates and events that a manager uses of each agent."""
    found: dict[str, tuple[list[str], list[str]]] = {}
    for name in manager.declared.used:
        agent, slash, rest = name.partition("/")
        if slash and agent in agents and manager.declared.knows(name) == "predicate":
            found.setdefault(agent, ([], []))[0].append(rest)
    for name, kind in manager.declared.names.items():
        agent, slash, rest = name.partition("/")
        if slash and agent in agents and kind == "event" and manager.declared.raises(name):
            found.setdefault(agent, ([], []))[1].append(rest)
    return {agent: Request(tuple(names), tuple(events)) for agent, (names, events) in found.items()}


class PredicatePublisher(Actor):
    """Sends this agent's predicates and events to agents that ask for them.

    Args:
        link: The connection of this agent to the others.
        managers: The predicate managers whose they are; of one name the first counts.

    Attributes:
        local: Handlers of this agent itself.
    """

    def __init__(self, link: Link, managers: Iterable[PredicateManager], *, name: str = "told") -> None:
        super().__init__(name)
        self._link = link
        self._managers = tuple(managers)
        self._key = link.key(PREDICATES, "changes")
        self._names: dict[PredicateManager, dict[str, None]] = {}  # in the order of asking, which a replay repeats
        self._topics: list[Subscription[Any]] = []
        self._number = 0
        self.local: list[Callable[[Change], None]] = []
        link.transport.serve(link.key(PREDICATES, "follow"), self._take)

    def on_start(self) -> None:
        """Listen to the predicates that are asked for, and send all values now and then."""
        self._topics = []
        self._listen()
        self.every(4 / self._link.team.max_age, lambda _: self._send_all())

    def on_stop(self) -> None:
        """Send nothing more."""
        for subscription in self._topics:
            subscription.cancel()

    def _take(self, body: bytes) -> bytes:
        """Answer a request in a turn of its own, which a record keeps: what is sent from then on follows from it."""
        answers: list[bytes] = []

        def take(body: bytes) -> None:
            key = self._link.key(PREDICATES, "follow")
            self.runtime.observers.tell(Asked, self.runtime.now(), self._link.agent, key, bytes(body))
            answers.append(self._answer(body))

        self.runtime.dispatcher.deliver(Subscription(None, self, take), body)
        return answers[0] if answers else b""  # where another turn goes on first: it asks again

    def _answer(self, body: bytes) -> bytes:
        try:
            return _encode(self.reply(_request(body)))
        except UNREADABLE:
            return b""

    def reply(self, asked: Request) -> Reply:
        """Return the present values of predicates, and send each change from now on."""
        unknown: dict[str, str] = {}
        values: dict[str, bool | None] = {}
        for names, kind in ((asked.predicates, "predicate"), (asked.events, "event")):
            for name in names:
                manager = next((one for one in self._managers if one.declared.names.get(name) == kind), None)
                if manager is None:
                    known = [
                        other for one in self._managers for other, its in one.declared.names.items() if its == kind
                    ]
                    unknown[name] = similar(name, known) if len(unknown) < _MOST_HINTS else ""
                    continue
                self._names.setdefault(manager, {})[name] = None
                if kind == "predicate":
                    values[name] = manager.value(name)
        self._listen()
        return Reply(self._number, values, unknown)

    def _listen(self) -> None:
        """Subscribe to the predicates and events that were asked for, and to no others."""
        for subscription in self._topics:
            subscription.cancel()
        self._topics = []
        for manager, names in self._names.items():
            updates = self.runtime.channel(f"{manager.path}/updates", PredicateUpdate)
            events = self.runtime.channel(f"{manager.path}/events", EventUpdate)
            self._topics.append(updates.subscribe(self._publish_predicates, self, topics=names))
            self._topics.append(events.subscribe(self._publish_events, self, topics=names))

    def _names_of_all(self) -> set[str]:
        return set().union(*self._names.values())

    def _publish_predicates(self, update: PredicateUpdate) -> None:
        names = self._names_of_all()
        values: dict[str, bool | None] = {name: True for name in update.rising if name in names}
        values |= {name: False for name in update.falling if name in names}
        values |= {name: None for name in update.unknown if name in names}
        if values:
            self._publish(update.time, values, ())

    def _publish_events(self, update: EventUpdate) -> None:
        names = self._names_of_all()
        self._publish(update.time, {}, tuple(name for name in update.events if name in names))

    def _publish(self, time: int, values: Mapping[str, bool | None], events: tuple[str, ...]) -> None:
        self._number += 1
        self._send(Change(self._number, time, dict(values), events))

    def _send_all(self) -> None:
        if self._names:
            values = {
                name: manager.value(name)
                for manager, names in self._names.items()
                for name in names
                if manager.declared.names[name] == "predicate"
            }
            self._send(Change(self._number, self.runtime.now(), values))

    def _send(self, change: Change) -> None:
        for tell in self.local:
            tell(change)
        self._link.send(self._key, _encode(change))


class PredicateSubscriber(Actor):
    """Keeps a manager's predicates and events of one agent up to date; that may be its own, since all run one file.

    Args:
        link: The connection of this agent to the others.
        agent: The agent.
        manager: The predicate manager.
        names: The names that it uses.
        publisher: The publisher of this agent's own.
    """

    def __init__(
        self,
        link: Link,
        agent: str,
        manager: PredicateManager,
        names: Request,
        publisher: PredicatePublisher,
        *,
        name: str,
    ) -> None:
        super().__init__(name)
        self._publisher = publisher if agent == link.agent else None
        self._link = link
        self._agent = agent
        self._manager = manager
        self._names = names
        self._life = 0
        self._answered = 0
        self._number = -1
        self._count = 0
        self._values: dict[str, bool | None] = {}
        self._asking: Work | None = None
        self._old: Timer | None = None
        self._hears: list[Subscription[Any]] = []
        self._max_age = link.team.max_age
        self._follows = False
        self._answer: Subscription[Reply] = Subscription(None, self, self._take_answer)

    def prepare(self, runtime: Runtime) -> None:
        """Let the manager follow; call this before it starts."""
        self._updates: Channel[PredicateUpdate] = runtime.channel(f"{self.path}/updates", PredicateUpdate)
        self._map: Channel[PredicateMap] = runtime.channel(f"{self.path}/map", PredicateMap)
        if self._names.predicates and not self._follows:
            self._manager.follow(self._agent, self._updates, self._map)
            self._follows = True

    def on_start(self) -> None:
        """Listen to the agent."""
        self._life, self._asking, self._old = 0, None, None
        if self._publisher is not None:
            self._receive_reply(self._publisher.reply(self._names))
            self._publisher.local.append(self._receive)
            return
        key = join(self._link.team.name, self._agent, PREDICATES, "changes")
        self._hears = [self._link.listen(key, self._on_sample, self), self._link.watch(self._on_live, self)]

    def on_stop(self) -> None:
        """Listen no more."""
        self._link.drop(self._hears)
        if self._publisher is not None and self._receive in self._publisher.local:
            self._publisher.local.remove(self._receive)

    def _on_live(self, link: Link) -> None:
        life = link.live.get(self._agent, 0)
        if life != self._life:
            self._life = life
            self._forget()
            if self._asking is not None:
                self._asking.cancel()
            self._asking = self.spawn(self._ask(), name="follow") if life else None

    def _forget(self) -> None:
        """Know nothing of the other agent until it is heard again."""
        self._number = -1
        if self._old is not None:
            self._old.cancel()
            self._old = None
        self._update(dict.fromkeys(self._names.predicates))

    async def _ask(self) -> None:
        """Ask the other agent to send the predicates and events."""
        key = join(self._link.team.name, self._agent, PREDICATES, "follow")
        answer = await self._link.ask_one(self._agent, key, _encode(self._names), _reply)
        self.runtime.dispatcher.deliver(self._answer, answer)

    def _take_answer(self, reply: Reply) -> None:
        """Take the answer of the other agent, in a turn of its own."""
        self.runtime.observers.tell(Answered, self.runtime.now(), self.path, _encode(reply))
        self._receive_reply(reply)

    def repeat_answer(self, body: bytes) -> None:
        """Take an answer that is in the record of a run."""
        self.runtime.dispatcher.deliver(self._answer, _reply(body))

    def _receive_reply(self, reply: Reply) -> None:
        if self._answered != self._life or self._publisher is not None:
            for name, hint in reply.unknown.items():
                self.report("follow", f"agent {self._agent!r} has no predicate or event {name!r}{hint}")
        self._answered = self._life
        if reply.number >= self._number:  # else what has changed since has come before it
            self._number = reply.number
            self._update(reply.values)
            self._publish_map()
        if self._publisher is None:
            self._watch()

    def _watch(self) -> None:
        if self._old is not None:
            self._old.cancel()
        self._old = self.call_later(self._max_age, self._on_old)

    def _on_old(self) -> None:
        self.report("stale", f"nothing was heard of agent {self._agent!r} for {self._max_age:g} s")
        self._forget()

    def _on_sample(self, sample: Sample) -> None:
        try:
            change = _change(sample.body)
        except UNREADABLE as error:
            self._link.refuse_sample(sample, f"is no change of predicates: {error}")
            return
        if sample.incarnation == self._life:
            self._watch()
            self._number = max(change.number, self._number)
            self._receive(change)

    def _receive(self, change: Change) -> None:
        self._update(change.values)
        if not change.events:
            self._publish_map()
        events = [f"{self._agent}/{name}" for name in change.events if name in self._names.events]
        if events:
            self._manager.derive((), tuple(events))

    def _update(self, values: Mapping[str, bool | None]) -> None:
        """Publish the new values of the predicates."""
        new = {
            name: value
            for name, value in values.items()
            if name in self._names.predicates and value is not self._values.get(name)
        }
        if new:
            self._values |= new
            rising, falling, unknown = (
                tuple(name for name, value in new.items() if value is truth) for truth in (True, False, None)
            )
            self._count += 1
            self._updates.publish(PredicateUpdate(self.runtime.now(), self._count, rising, falling, unknown))

    def _publish_map(self) -> None:
        """Publish all values, for a manager that has just started again."""
        self._map.publish(PredicateMap(self.runtime.now(), self._count, dict(self._values)))
