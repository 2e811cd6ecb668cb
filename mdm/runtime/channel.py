"""Channels: named, typed streams of messages between actors; and streams of them for consumers outside the turn."""

from __future__ import annotations

from collections import deque
from threading import get_ident
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import anyio
from msgspec.structs import replace

from mdm.checks import check_choice, is_whole
from mdm.errors import Error
from mdm.messages import Fault
from mdm.runtime.handler import check_plain
from mdm.runtime.statistics import ChannelStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable
    from types import TracebackType
    from typing import Self

    from mdm.checks import Whole
    from mdm.runtime.actor import Actor
    from mdm.runtime.dispatcher import Dispatcher

T = TypeVar("T")


class Overflow(Error):
    """A stream with ``overflow="error"`` got more messages than its consumer took."""


class Stream(Generic[T]):
    """An asynchronous iterator over a channel's messages; also a context manager that unsubscribes.

    Args:
        name: The channel's name, for messages.
        capacity: How many messages may wait.
        overflow: The treatment of one too many.
        on_drop: Called for each message that is dropped.
    """

    def __init__(
        self,
        name: str,
        capacity: Whole,
        overflow: Literal["drop_oldest", "drop_newest", "error"],
        on_drop: Callable[[], None],
    ) -> None:
        if not is_whole(capacity) or capacity < 1:
            raise Error(f"a stream on channel {name!r} needs a capacity of at least 1, not {capacity!r}")
        check_choice(overflow, ("drop_oldest", "drop_newest", "error"), f"overflow of a stream on channel {name!r}")
        self._name = name
        self._capacity = int(capacity)
        self._overflow = overflow
        self._on_drop = on_drop
        self._on_close: Callable[[], None] = lambda: None
        self._waiting: deque[T] = deque()
        self._arrived = anyio.Event()
        self._ended = False
        self._failed = False
        self.dropped = 0

    def on_close(self, function: Callable[[], None]) -> None:
        """Set the function that unsubscribes the stream."""
        self._on_close = function

    def put(self, message: T) -> None:
        """Take a message from the turn; never waits."""
        if len(self._waiting) >= self._capacity:
            self.dropped += 1
            self._on_drop()
            if self._overflow == "error":
                self._failed = True
                self.close()
                return
            if self._overflow == "drop_newest":
                return
            self._waiting.popleft()
        self._waiting.append(message)
        self._arrived.set()

    def end(self) -> None:
        """Let the consumer take the waiting messages and then leave its loop."""
        self._ended = True
        self._arrived.set()

    def close(self) -> None:
        """Unsubscribe and end."""
        self._on_close()
        self.end()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        while not self._waiting:
            if self._failed:
                raise Overflow(
                    f"a consumer of channel {self._name!r} fell more than {self._capacity} messages behind; "
                    "take them faster, allow a larger capacity, or let the stream drop messages"
                )
            if self._ended:
                raise StopAsyncIteration
            if self._arrived.is_set():
                self._arrived = anyio.Event()  # one for all consumers that wait
            await self._arrived.wait()
        return self._waiting.popleft()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class Subscription(Generic[T]):
    """One actor's handler on one channel, for all of its messages or for some topics."""

    __slots__ = ("_until", "actor", "channel", "handler", "since", "taken", "topics")

    def __init__(self, channel: Channel[T] | None, actor: Actor | None, handler: Callable[[T], object]) -> None:
        self.channel = channel
        self.actor = actor
        self.handler = handler
        # Messages are counted by difference, at no cost: how many the channel had carried before its first. Of topics
        # each one is counted.
        self.since = channel.published if channel is not None else 0
        self._until: int | None = None
        self.topics: tuple[str, ...] | None = None
        self.taken = 0

    @property
    def received(self) -> int:
        """How many messages were handed to the handler."""
        if self.channel is None or self.topics is not None:
            return self.taken
        return (self.channel.published if self._until is None else self._until) - self.since

    def cancel(self) -> None:
        """Take no more messages; those of the running turn that are still queued count as dropped."""
        if self.channel is not None and self._until is None:
            waiting = self.channel.remove(self)
            self._until = self.channel.published - waiting
            self.taken -= waiting
        self.handler = self._drop

    def _drop(self, _: T) -> None:
        if self.channel is not None:
            self.channel.dropped += 1

    def fail(self, error: BaseException) -> None:
        """Attribute a handler's error to its actor."""
        if self.actor is None:
            raise error
        if self.channel is not None and self.channel.type is Fault:
            self.cancel()  # else it would be told of its own failure, and fail at that, without end
        self.actor.fail(error)


class Topics:
    """A topic of a channel's messages, with its subscribers; they are looked up again when they change.

    Args:
        names: The topics.
    """

    __slots__ = ("names", "sole", "subscriptions", "version")

    def __init__(self, *names: str) -> None:
        self.names = names
        self.version = -1
        self.subscriptions: tuple[Subscription[Any], ...] = ()
        self.sole: Subscription[Any] | None = None


class Channel(Generic[T]):
    """A named stream of messages of one type.

    Args:
        name: The channel's name, such as ``patrol/state``.
        type: The class of its messages; others are refused.
        dispatcher: Runs the turns.
        retain: Keep the last message and hand it to late subscribers.
        owner: The actor to whom errors of handlers without an actor are attributed.
    """

    # What each message reads or writes, close together: among many channels what is far apart is not in the cache.
    __slots__ = (
        "__dict__",
        "__weakref__",
        "_dispatcher",
        "_sole",
        "_subscriptions",
        "_version",
        "heard",
        "input",
        "last",
        "published",
        "stamped",
        "type",
    )

    def __init__(
        self,
        name: str,
        type: type[T],  # noqa: A002
        dispatcher: Dispatcher,
        *,
        retain: bool = False,
        owner: Actor | None = None,
    ) -> None:
        self.type = type
        self._dispatcher = dispatcher
        self.published = 0
        self.last: T | _Unmade[T] | None = None
        # All subscriptions; the only one, where there is but one, for every message; and how often they have changed.
        self._subscriptions: tuple[Subscription[T], ...] = ()
        self._sole: Subscription[T] | None = None
        self._version = 0
        # Whether anybody listens, so that a costly message need not be made for nobody.
        self.heard = False
        # Whether the library takes input from it, which a record keeps; and whether the time of each message is the
        # clock's, read just before: within a turn it is made that of the turn.
        self.input = False
        self.stamped = False
        self.name = name
        self.retain = retain
        self.dropped = 0
        # Tells what a message is about, where a newer one from another thread supersedes it; None where none does.
        self.supersedes: Callable[[T], Hashable | None] | None = None
        # Makes one of two of these, where too many wait: the older, and the newer, which counts.
        self.merge: Callable[[T, T], T] = lambda _, newer: newer
        self._unheard = 0
        self._owner = owner
        self._snapshot: Callable[[], T | None] | None = None
        # Subscriptions for every message; and those for topics, by topic.
        self._general: tuple[Subscription[T], ...] = ()
        self._topics: dict[str, tuple[Subscription[T], ...]] = {}
        self._streams: tuple[Stream[T], ...] = ()
        self._deserted: Callable[[Channel[T]], object] | None = None

    def publish(self, message: T) -> None:  # noqa: C901 - hot path, no calls
        """Hand a message to every subscriber, in the running turn or in a turn of its own; from any thread.

        Raises:
            TypeError: If the message is not of the channel's type.
            Error: If the runtime has not begun, or is another process's. After its end messages are counted alone.
        """
        dispatcher = self._dispatcher
        if message.__class__ is not self.type:
            raise TypeError(
                f"channel {self.name!r} carries {self.type.__name__} messages, not {message.__class__.__name__}"
            )
        if get_ident() != dispatcher.thread:
            dispatcher.publish_from_thread(self, message)
            return
        if dispatcher.time < 0:
            # The way in: a stimulus, behind what timers bring about by its time. As `Dispatcher.begin`, without a call.
            time: int = message.time if self.stamped else dispatcher.stamp(message)  # type: ignore[attr-defined]
            if time >= dispatcher.clock.due:
                if dispatcher.clock.firing < 0:
                    dispatcher.clock.fire_before(time)
                elif self.stamped:  # a timer sets it by itself, when that was due
                    time = dispatcher.clock.firing
                    message = replace(message, time=time)  # type: ignore[type-var]
            if dispatcher.active:  # though none runs: one was cut short
                if dispatcher.observed and self.input:
                    dispatcher.observers.message(self, message, time)
                self._wait(message)
                return
            dispatcher.time = dispatcher.last = time
            if dispatcher.observed and self.input:
                dispatcher.observers.message(self, message, time)
            self.published += 1
            self.last = message
            sole = self._sole
            if sole is not None and not dispatcher.queue:
                dispatcher.run_from(sole, message)
            elif self._subscriptions:
                self._queue(message)
                dispatcher.run()
            else:
                self._queue(message)
                dispatcher.time = -1
            return
        if self.stamped and message.time != dispatcher.time:  # type: ignore[attr-defined]
            message = replace(message, time=dispatcher.time)  # type: ignore[type-var]
        if dispatcher.observed and self.input:
            dispatcher.observers.message(self, message, dispatcher.time)
        self.published += 1
        self.last = message
        self._queue(message)

    def derive(self, message: T) -> None:
        """As `publish`, from the event loop, for a message that follows from others: it is no input of its own."""
        dispatcher = self._dispatcher
        if dispatcher.time < 0:
            time = dispatcher.now()
            if dispatcher.active:
                self._wait(message)
                return
            dispatcher.begin(time)
        self.published += 1
        self.last = message
        self._queue(message)
        if not dispatcher.active:
            if dispatcher.queue:
                dispatcher.run()
            else:
                dispatcher.time = -1

    def _queue(self, message: T) -> None:
        if self._subscriptions:
            append = self._dispatcher.queue.append
            for subscription in self._subscriptions:
                append((subscription, message))
                if subscription.topics is not None:
                    subscription.taken += 1
        elif not self._streams:
            self._unheard += 1

    def _wait(self, message: T) -> None:
        """Publish a message while a turn is cut short: it comes behind all that was published by then."""
        self.published += 1
        self.last = message
        for subscription in self._subscriptions:
            if subscription.topics is not None:
                subscription.taken += 1
        if self._subscriptions:
            self._dispatcher.wait(tuple([(subscription, message) for subscription in self._subscriptions]))
        elif not self._streams:
            self._unheard += 1

    def emit(self, message: T) -> None:
        """Hand a message to every subscriber, from a handler: it is queued in the running turn, with no check at all.

        Hot path: a third of a microsecond less in each decision than `publish` would cost.
        """
        self.published += 1
        self.last = message
        if self._subscriptions:
            append = self._dispatcher.queue.append
            for subscription in self._subscriptions:
                append((subscription, message))
                if subscription.topics is not None:
                    subscription.taken += 1
        else:
            self._unheard += 1

    def emit_later(self, time: int, make: Callable[[], T]) -> None:
        """As `emit`, for a message that costs much to make: where nobody listens, only a late subscriber has it made.

        Args:
            time: The message's.
            make: Makes it, from values that must not change.
        """
        if self._subscriptions:
            self.emit(make())
        else:
            self.published += 1
            self._unheard += 1
            self.last = _Unmade(time, make)

    def emit_on(self, message: T, topics: Topics) -> None:
        """As `emit`, but of those who subscribed to topics only to those with one of these."""
        self.published += 1
        self.last = message
        if topics.version != self._version:
            self._look_up(topics)
        append = self._dispatcher.queue.append
        for subscription in topics.subscriptions:
            if subscription.topics is not None:
                subscription.taken += 1
            append((subscription, message))

    def emit_last(self, message: T) -> None:
        """As `emit`, as the last thing that a handler does: a sole subscriber who is next anyway is called at once.

        It must be the last statement of the handler and of its callers, and none of them may catch its errors.
        """
        sole, dispatcher = self._sole, self._dispatcher
        if sole is None or not dispatcher.straight or dispatcher.queue:
            self.emit(message)
            return
        self.published += 1
        self.last = message
        dispatcher.straight -= 1
        try:
            (_ := sole.handler)(message)  # named first: docs/decisions/emitting-and-publishing.md says why
        except BaseException:
            if dispatcher.blamed is None:  # no call: there may be no room for one
                dispatcher.blamed = sole
            raise

    def emit_last_on(self, message: T, topics: Topics) -> None:
        """As `emit_on`, as the last thing that a handler does, see `emit_last`."""
        if topics.version != self._version:
            self._look_up(topics)
        sole, dispatcher = topics.sole, self._dispatcher
        if sole is None or not dispatcher.straight or dispatcher.queue:
            self.emit_on(message, topics)
            return
        self.published += 1
        self.last = message
        if sole.topics is not None:
            sole.taken += 1
        dispatcher.straight -= 1
        try:
            (_ := sole.handler)(message)
        except BaseException:
            if dispatcher.blamed is None:  # no call: there may be no room for one
                dispatcher.blamed = sole
            raise

    def _look_up(self, topics: Topics) -> None:
        known = self._topics
        found = (subscription for name in topics.names if name in known for subscription in known[name])
        topics.subscriptions = (*self._general, *dict.fromkeys(found))
        topics.sole = topics.subscriptions[0] if len(topics.subscriptions) == 1 else None
        topics.version = self._version

    def _changed(self) -> None:
        """Note that subscriptions have come or gone."""
        self.heard = bool(self._subscriptions)
        self._sole = self._general[0] if len(self._subscriptions) == len(self._general) == 1 else None
        self._version += 1

    def subscribe(
        self, handler: Callable[[T], object], actor: Actor | None = None, *, topics: Iterable[str] | None = None
    ) -> Subscription[T]:
        """Call ``handler`` with each message from now on, and with the retained one at once.

        Args:
            handler: A plain function.
            actor: The actor that it belongs to.
            topics: Of messages that are emitted on topics, take those on one of these alone.

        Raises:
            Error: If the handler is no plain function (an async one would never run), or the topics are one text.
        """
        check_plain(handler, f"the handler of channel {self.name!r}")
        if isinstance(topics, str):
            raise Error(f"topics on channel {self.name!r} are several texts, not one: [{topics!r}]")
        subscription = Subscription(self, actor or self._owner, handler)
        self._subscriptions = (*self._subscriptions, subscription)
        if topics is None:
            self._general = (*self._general, subscription)
        else:
            subscription.topics = tuple(dict.fromkeys(topics))
            for topic in subscription.topics:
                self._topics[topic] = (*self._topics.get(topic, ()), subscription)
        self._changed()
        if isinstance(self.last, _Unmade) and self.retain:
            self.last = self.last.make()
        retained = self._snapshot() if self._snapshot is not None else self.last if self.retain else None
        if retained is not None:
            subscription.since -= 1
            subscription.taken += 1
            self._dispatcher.deliver(subscription, retained)
        return subscription

    def retain_by(self, snapshot: Callable[[], T | None]) -> None:
        """Make the message for a late subscriber when one comes, in place of keeping the last one published."""
        self._snapshot = snapshot

    def forget(self) -> None:
        """Keep the last message no more: a late subscriber waits for the next one."""
        self.last = None

    def claim(self) -> None:
        """Note that the channel is an actor's, which lives."""
        self._deserted = None

    def desert(self, unused: Callable[[Channel[T]], object]) -> None:
        """Note that its actor has ended: call ``unused`` when nobody listens any more."""
        self._deserted = unused
        if not self.heard:
            unused(self)

    def remove(self, subscription: Subscription[T]) -> int:
        """Forget a subscription, and return how many messages it had yet to handle; `Subscription.cancel` calls it."""
        self._subscriptions = _without(self._subscriptions, subscription)
        self._general = _without(self._general, subscription)
        for topic in subscription.topics or ():
            self._topics[topic] = _without(self._topics[topic], subscription)
            if not self._topics[topic]:
                del self._topics[topic]
        self._changed()
        if self._deserted is not None and not self.heard:
            self._deserted(self)
        return sum(waiting is subscription for waiting, _ in self._dispatcher.queue)

    def stream(
        self, *, capacity: Whole = 64, overflow: Literal["drop_oldest", "drop_newest", "error"] = "drop_oldest"
    ) -> Stream[T]:
        """Return the messages from now on (and the retained one) for ``async for``, outside the turn.

        Args:
            capacity: How many messages may wait.
            overflow: The treatment of one too many: ``drop_oldest``, ``drop_newest``, or ``error``, which ends the
                stream with an error for its consumer. Drops are counted by the stream and the channel.
        """
        stream = Stream[T](self.name, capacity, overflow, self._count_drop)
        subscription = self.subscribe(stream.put)
        stream.on_close(lambda: self._close(stream, subscription))
        self._streams = (*self._streams, stream)
        return stream

    def _count_drop(self) -> None:
        self.dropped += 1

    def _close(self, stream: Stream[T], subscription: Subscription[T]) -> None:
        self._streams = tuple(other for other in self._streams if other is not stream)
        subscription.cancel()

    def close(self) -> None:
        """End every stream: consumers finish the waiting messages and then leave their loops."""
        for stream in self._streams:
            stream.end()

    def statistics(self) -> ChannelStatistics:
        """Return the channel's statistics so far."""
        return ChannelStatistics(
            name=self.name,
            published=self.published,
            last=getattr(self.last, "time", None),
            dropped=self.dropped,
            unheard=self._unheard,
            subscribers=len(self._subscriptions) - len(self._streams),
            streams=len(self._streams),
        )


class _Unmade(Generic[T]):
    """A message that is made when somebody asks for it."""

    __slots__ = ("make", "time")

    def __init__(self, time: int, make: Callable[[], T]) -> None:
        self.time = time
        self.make = make


def _without(subscriptions: tuple[Subscription[T], ...], one: Subscription[T]) -> tuple[Subscription[T], ...]:
    if one not in subscriptions:
        return subscriptions
    place = subscriptions.index(one)
    return subscriptions[:place] + subscriptions[place + 1 :]
