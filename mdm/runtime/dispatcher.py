"""The dispatcher: delivers messages first in, first out, until a turn is over; and the inbox of other threads.

A turn is everything that one outside stimulus causes, and has one time, that of the stimulus. It runs to completion as
one synchronous pass: a handler that publishes only enqueues, so no handler is ever re-entered and all subscribers see
one global order. A message that is next anyway need not be queued for that: where the first handler of a turn emits it
last, to one subscriber, while nothing waits, the subscriber is called straight away (see `Channel.emit_last`).
"""

from __future__ import annotations

import os
import sys
from collections import Counter, OrderedDict, deque
from itertools import islice
from threading import RLock, get_ident
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakSet

from msgspec.structs import replace

from mdm.errors import Error
from mdm.messages import Belief, Control, Observation, SensorUpdate, State
from mdm.runtime.channel import Subscription
from mdm.runtime.observing import Choices, Observers
from mdm.runtime.statistics import DispatcherStatistics
from mdm.runtime.time.clock import Timer
from mdm.stimuli import Resumed

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Hashable

    from mdm.runtime.channel import Channel
    from mdm.runtime.time.clock import Clock


class Inbox:
    """Messages in the order in which they came, from any thread.

    A message that a channel says is superseded by the newer one gives way to it, unless one that cannot be superseded
    came between them, such as an event: states that held at an event are published before it. Each channel may have as
    many waiting as the bound. Beyond it, messages that can be superseded become one, and others are lost.

    Args:
        bound: How many messages of a channel may wait.
    """

    def __init__(self, bound: int = 2048) -> None:
        self.bound = bound
        self.replaced = 0
        self.lost = 0
        self._rests: dict[Channel[Any], int] = {}
        self._waiting: OrderedDict[Hashable, tuple[Channel[Any], Any, int]] = OrderedDict()
        self._counts: dict[Channel[Any], int] = {}
        self._losses: Counter[Channel[Any]] = Counter()
        self._number = 0
        # One that its own thread may take again: a signal's handler may set a sensor while another is being set.
        self._lock = RLock()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, channel: Channel[Any], message: Any, since: int = 0) -> None:
        """Let a message wait that came at a time; one that says what the superseded one says waits since that came."""
        supersedes = channel.supersedes
        subject = None if supersedes is None else supersedes(message)
        with self._lock:
            count = self._counts.get(channel, 0)
            full = count >= self.bound
            if subject is None and full:
                self._losses[channel] += 1
                self.lost += 1
                return
            if full:
                place: Hashable = self._rests.get(channel)
                if place is None:
                    place = self._rests[channel] = self._next()
                elif (rest := self._waiting.get(place)) is not None:
                    message, since = channel.merge(rest[1], message), rest[2]
            else:
                if self._rests:
                    self._rests.pop(channel, None)
                place = self._next() if subject is None else (channel, subject, self._number)
            if self._waiting and (older := self._waiting.pop(place, None)) is not None:
                count -= 1
                self.replaced += 1
                if message.__class__ is SensorUpdate and older[1].predicates == message.predicates:
                    since = older[2]
            self._waiting[place] = (channel, message, since)
            self._counts[channel] = count + 1

    def _next(self) -> int:
        self._number += 1
        return self._number

    def take(self) -> tuple[Channel[Any], Any, int] | None:
        """Return the message that came first, with its time, and wait with it no longer; None where none waits."""
        with self._lock:
            if not self._waiting:
                return None
            _, item = self._waiting.popitem(last=False)
            channel = item[0]
            count = self._counts.pop(channel) - 1
            if count:
                self._counts[channel] = count
            return item

    def losses(self) -> Counter[Channel[Any]]:
        """Return how many messages of which channels were lost since this was last asked."""
        if not self._losses:
            return self._losses
        with self._lock:
            losses, self._losses = self._losses, Counter()
            return losses


_STAMPED: Final = (State, Observation, Belief, Control)
"""Messages whose time says when they were made, and not, as that of a pose, when something was so."""
_FRESH: Final = 1_000_000
_BEHIND: Final = 10_000_000
"""Nanoseconds by which a turn may be behind the clock, and delays still count from its own time."""
_SLICE: Final = 256
_SHORTER: Final = 10
"""By how much the slices of a turn that was cut are shorter than the first: the rest of the program waits for each."""
_MOST_CUTS: Final = 512
_LOOKS: Final = 16
"""Cuts of a turn from one look at who keeps it going to the next."""
LOOK_EVERY: Final = 1_000
"""Rounds of an event loop whose time is virtual from one look whether it stands still to the next."""
_AT_ONCE: Final = 100_000
"""Messages of one turn, or turns, at one instant, beyond which time would never go on."""
_ROOM: Final = 500
_STRAIGHT: Final = 16
_WATCHED: Final = 256
_NAMED: Final = 8
"""Messages of a turn without end that are watched, and those who publish them that are named."""
_NONE_TOLD: Final = (1 << 63, 0)
_OPEN: WeakSet[Dispatcher] = WeakSet()


class Dispatcher:
    """Runs turns on the event loop's thread, and takes messages from other threads.

    Args:
        clock: Tells when a turn has taken too long.
        max_messages: A turn that delivers more yields to the event loop and continues afterwards.
        max_seconds: The same by time (looked at every 256 messages).
        starved_after: Seconds for which a turn that was cut may go on while other input comes.
    """

    __slots__ = (
        "__weakref__",
        "_behind",
        "_circle",
        "_cuts",
        "_first_cut",
        "_forked",
        "_from_threads",
        "_handed",
        "_inbox",
        "_instant",
        "_interrupted",
        "_looks",
        "_max_nanoseconds",
        "_max_slices",
        "_overflowing",
        "_refused",
        "_rounds",
        "_seen",
        "_since",
        "_starved",
        "_taken",
        "_turns",
        "_turns_behind",
        "_waits",
        "_waits_since",
        "_woken",
        "active",
        "blamed",
        "choices",
        "clock",
        "last",
        "loop",
        "now",
        "observed",
        "observers",
        "on_endless",
        "on_overflow",
        "on_standstill",
        "on_starved",
        "queue",
        "starved_after",
        "straight",
        "thread",
        "time",
        "told",
        "watch",
    )

    def __init__(
        self, clock: Clock, *, max_messages: int = 16_384, max_seconds: float = 0.05, starved_after: float = 1.0
    ) -> None:
        self.clock = clock
        self.now = self._reader()
        self._max_slices = max(1, max_messages // _SLICE)
        self._max_nanoseconds = int(max_seconds * 1e9)
        self.starved_after = starved_after
        self.queue: deque[tuple[Subscription[Any], Any]] = deque()
        # Turns that begin behind the running one: at its time, or at one of their own.
        self._behind: deque[tuple[int | None, tuple[tuple[Subscription[Any], Any], ...]]] = deque()
        self.active = False
        # The running turn's time, -1 between turns and while one is cut short; and that of the last one.
        self.time = -1
        self.last = 0
        # Who hears what happens, and whether anybody hears stimuli; and who answers what only the world knows.
        self.observers = Observers()
        self.observed = False
        self.choices = Choices()
        # Called before each message of a turn is delivered, and once more behind the last one, where a run is repeated
        # or a circle is looked for; returns whether the turn is cut there.
        self.watch: Callable[[], bool] | None = None
        # How many messages the first handler of this turn, and those whom it leads to, may still hand on by a call.
        self.straight = 0
        # Whose handler has raised, where that was not the first one's.
        self.blamed: Subscription[Any] | None = None
        # While what another thread told is delivered: the time from which turns are on that, and when it was told.
        self.told = _NONE_TOLD
        self.thread = 0
        # Where turns run, while they do.
        self.loop: asyncio.AbstractEventLoop | None = None
        self._inbox = Inbox()
        self._overflowing: set[Channel[Any]] = set()
        self.on_overflow: Callable[[str], object] = str
        self.on_endless: Callable[[str], object] = str
        # Called with words when other input has come for too long while a turn was cut, and with none at its end.
        self.on_starved: Callable[[str], object] = str
        self.on_standstill: Callable[[str], object] = str
        self._forked = False
        # Of the turn that is cut: how often it was, how many messages it had delivered by then, when it was first, when
        # other input came first, whether that was told as starved, and who keeps the turn going.
        self._cuts = self._handed = 0
        self._first_cut = self._waits_since = -1
        self._starved = False
        self._circle: _Circle | None = None
        # Whether what other threads said last is still to be delivered; it is when this is.
        self._waits = False
        self._taken: Subscription[None] = Subscription(None, None, self._take_more)
        # What an event loop whose time is virtual calls now and then. Of the instant that its clock shows: which, how
        # many turns there had been before it and when it was looked at last, and how many rounds it has lasted.
        self._looks: list[Callable[[], object]] = []
        self._instant, self._since, self._seen, self._rounds = -1, 0, 0, 0
        self._woken = False
        self._turns = 0
        # Turns that began behind another one, within the limits of that one: a chain of them may have no end, either.
        self._turns_behind = 0
        self._interrupted = 0
        self._from_threads = 0
        self._refused = 0

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Take the calling thread and its event loop as the place where turns run."""
        self.loop = loop
        self.thread = get_ident()
        self.last = self.clock.now()
        self._looks = getattr(loop, "looks", self._looks)
        self._looks.append(self.look_at_time)
        _OPEN.add(self)

    def leave_to_parent(self) -> None:
        """Run nothing in a forked child: its messages are refused."""
        self._forked = True
        self.loop = None
        self.thread = 0

    def close(self) -> None:
        """Deliver the waiting messages, as far as one turn may go, then accept no more from other threads."""
        self.loop = None
        if self.look_at_time in self._looks:
            self._looks.remove(self.look_at_time)
        self._drain()
        if self.queue or self._behind:
            self._go_on()
        for subscription, _ in (*self.queue, *(item for _, items in self._behind for item in items)):
            if subscription.channel is not None:
                subscription.channel.dropped += 1
        self.queue.clear()
        self._behind.clear()

    # -- Turns and their times -----------------------------------------------------------------------------------

    def _reader(self) -> Callable[[], int]:
        """Return what `now` is: a function of one piece, for hot paths keep it."""
        clock, tell = self.clock, self.clock.reader()

        def now() -> int:
            """Return the running turn's time; outside of turns, and from other threads, the clock's.

            A timer's own call, outside of turns, happens when that was due.
            """
            time = self.time
            if time >= 0:
                if get_ident() == self.thread:
                    return time
            elif clock.firing >= 0 and get_ident() == self.thread:
                return clock.firing
            return tell()

        return now

    def counts_from(self, actor: str) -> int:
        """Return the time from which a delay counts that an actor asks for now: that of the running turn.

        Where that has fallen behind the clock, for the loop was held, it is the clock's, which a record keeps. Else who
        calls itself after a delay that is shorter than its own work would be called without end, at times further and
        further in the past, and nothing that is due later would ever come.
        """
        time, shown = self.now(), self.clock.now()
        begin = self.choices.counts_from(actor, time, shown if shown - time > _BEHIND else time)
        if self.observed:
            self.observers.delayed(actor, time, begin)
        return begin

    def stamp(self, message: Any) -> int:
        """Return the time of a stimulus: that which its maker has just stamped it with, else now."""
        now = self.now()
        if isinstance(message, _STAMPED):
            time = message.time
            if max(self.last, now - _FRESH) <= time <= now:
                return time
        return now

    def begin(self, time: int) -> None:
        """Begin a turn at a time: what timers bring about by then comes before it."""
        if time >= self.clock.due and self.clock.firing < 0:
            self.clock.fire_before(time)
        self.time = self.last = time

    def deliver(self, subscription: Subscription[Any], message: object) -> None:
        """Hand a message to one subscriber: in the running turn, or in a turn of its own, now."""
        if self.time >= 0:
            self.queue.append((subscription, message))
            return
        time = self.now()
        if time >= self.clock.due and self.clock.firing < 0:  # as `begin`, without a call
            self.clock.fire_before(time)
        self.time = self.last = time
        if self.active:
            self._take(subscription, message)
        else:
            self.queue.append((subscription, message))
            self.run()

    def deliver_due(self, subscription: Subscription[Any], message: object, time: int) -> None:
        """Hand a timer's message to one subscriber, in a turn at the time when that was due."""
        if self.time >= 0:
            self._behind.append((time, ((subscription, message),)))
            return
        self.time = self.last = time
        if self.active:
            self._take(subscription, message)
        else:
            self.queue.append((subscription, message))
            self.run()

    def deliver_behind(self, subscription: Subscription[Any], message: object) -> None:
        """Hand a message to one subscriber in a turn of its own: behind all that the running turn brings about."""
        if self.active:
            self._behind.append((None, ((subscription, message),)))
        else:
            self.deliver(subscription, message)

    def wait(self, items: tuple[tuple[Subscription[Any], Any], ...]) -> None:
        """Hand messages of other input to subscribers while a turn is cut short, behind all that it has published.

        Were they handed over sooner, earlier messages would undo them, for who takes both.
        """
        self._note_waiting()
        self._turns_behind += 1
        self.queue.extend(items)

    def _take(self, subscription: Subscription[Any], message: object) -> None:
        """Handle other input while a turn is cut short; its consequences wait as messages do that come then."""
        self._note_waiting()
        self._turns_behind += 1
        try:
            subscription.handler(message)
        except BaseException as error:
            subscription.fail(error)
        finally:
            self.time = -1

    def run_from(self, first: Subscription[Any], message: object) -> None:
        """Run a turn that begins with a message to one subscriber, where nothing waits: 0.1 µs for a hop by a call."""
        if self.watch is not None:
            self.queue.append((first, message))
            self._run_watched()
            return
        self.active = True
        self.straight = _STRAIGHT
        try:
            try:
                (_ := first.handler)(message)
            except RecursionError as error:
                limit = sys.getrecursionlimit()
                sys.setrecursionlimit(limit + _ROOM)  # here there may be none even to say so
                self._fail_later(self._culprit(first), error, limit)
                return
            except BaseException as error:
                self._culprit(first).fail(error)
            if not (self.queue or self._behind):
                self._turns += 1
                self.straight = 0
                self.active = False
                self.time = -1
                return
            left = _SLICE - 1 - _STRAIGHT + self.straight
            self.straight = 0
        except BaseException:
            self._leave()
            raise
        self.run(left)

    def _leave(self) -> None:
        """Let the event loop go on with a turn that an error has ended."""
        self.straight = 0
        self.active = False  # where there is no room to go on later, the next message does
        self._resume_later()

    def run(self, budget: int = 0) -> None:  # noqa: C901 - hot path, no calls
        """Run a turn: deliver the queue, and all that this leads to.

        Hot path: a hop costs about 0.2 µs, of which the handler's call is half.

        Args:
            budget: After how many messages the clock is read for the first time; 0 for those of a slice.
        """
        if self.watch is not None:
            self._run_watched()
            return
        queue = self.queue
        self.active = True
        budget = budget or _SLICE
        deadline = slices = 0
        try:
            while True:
                while queue:
                    subscription, message = queue.popleft()
                    try:
                        (_ := subscription.handler)(message)
                    except RecursionError as error:
                        limit = sys.getrecursionlimit()
                        sys.setrecursionlimit(limit + _ROOM)
                        self._fail_later(subscription, error, limit)
                        return
                    except BaseException as error:
                        subscription.fail(error)
                    budget -= 1
                    if not budget:
                        budget = _SLICE
                        now = self.clock.now()
                        if not deadline:
                            deadline, slices = self._limits(now)
                        self._handed += _SLICE
                        slices -= 1
                        if not slices or now > deadline:
                            if self._cut_short(now):
                                return
                            deadline = 0
                if not self._behind:
                    break
                time, items = self._behind.popleft()
                if time is not None:
                    self.time = self.last = time
                queue.extend(items)
                self._turns_behind += 1
            self._turns += 1
            self.active = False
            self.time = -1
        except BaseException:
            self._leave()
            raise

    def _run_watched(self) -> None:
        """As `run`, with each message from the queue, and cut where whoever watches says so."""
        queue, left = self.queue, 4 * self._max_slices * _SLICE
        self.active = True
        try:
            while (watch := self.watch) is not None:
                if watch():
                    self._cuts += 1
                    self.time = -1
                    return
                left -= 1
                if left < 0:  # the run that is repeated has ended before this turn, or made another one of it
                    self._resume_later()
                    return
                if queue:
                    subscription, message = queue.popleft()
                    try:
                        subscription.handler(message)
                    except BaseException as error:
                        subscription.fail(error)
                elif self._behind:
                    time, items = self._behind.popleft()
                    if time is not None:
                        self.time = self.last = time
                    queue.extend(items)
                    self._turns_behind += 1
                else:
                    self._turns += 1
                    self.active = False
                    self.time = -1
                    return
        except BaseException:
            self.active = False
            self._resume_later()
            raise
        self.run()

    def _culprit(self, first: Subscription[Any]) -> Subscription[Any]:
        """Return the actor whose handler has raised: the first handler, or one that it has called."""
        blamed, self.blamed = self.blamed, None
        return first if blamed is None else blamed

    # -- Turns that are cut short --------------------------------------------------------------------------------

    def _limits(self, now: int) -> tuple[int, int]:
        """Return until when a turn may go on, and for how many slices of messages."""
        if self._cuts:  # the program has waited for it already
            return now + self._max_nanoseconds // _SHORTER, max(1, self._max_slices // _SHORTER)
        self._handed = 0
        return now + self._max_nanoseconds, self._max_slices

    @property
    def goes_on(self) -> bool:
        """Whether the turn that runs was cut short before."""
        return self._cuts > 0

    def _cut_short(self, now: int) -> bool:
        """Cut a turn, so that the event loop turns before it goes on; return False where it ends by itself first."""
        if self.observed and not self._come_to_a_place():
            return False
        self._interrupted += 1
        if not self._cuts:
            self._first_cut = now
        elif self._cuts == _MOST_CUTS and not self._starved:
            self.on_endless(
                f"one turn has been cut short {_MOST_CUTS} times and goes on: handlers may publish to each other "
                f"without end{self._going()}"
            )
        self._resume_later()
        if self._handed >= _AT_ONCE and now == self._first_cut:
            self._stand_still("messages of one turn")
        return True

    def _going(self) -> str:
        """Return in words who keeps the turn going, where that is known."""
        told = str(self._circle or "")
        return told and f": {told}"

    def _stand_still(self, what: str) -> None:
        self.on_standstill(
            f"time stands still: {_AT_ONCE:,} {what} at one instant, and they go on{self._going()}: what an action "
            f"or a message leads to must not bring that about at once"
        )

    def count_afresh(self) -> None:
        """Count messages and turns at this instant from 0: a simulated world steps, so that this is no circle."""
        self._handed, self._instant = 0, -1

    def look_at_time(self) -> None:
        """See whether time stands still, once in so many rounds of an event loop whose time is virtual."""
        if self.choices.repeats:
            return  # its time is that of the record
        now, turns = self.clock.now(), self._turns + self._turns_behind
        if now != self._instant or turns == self._seen:
            self._instant, self._since, self._rounds = now, turns, 0
            if not self.active:
                self._circle = None
        self._seen = turns
        self._rounds += LOOK_EVERY
        if min(turns - self._since, self._rounds) < _AT_ONCE or self.active:
            return
        if self._circle is None:
            self._look_for_circle()
        elif self.watch is None:
            self._stand_still("turns")

    def _look_for_circle(self) -> None:
        if self.watch is None:
            self._circle = _Circle(self)
            self.watch = self._circle.look

    def _come_to_a_place(self) -> bool:
        """Deliver messages until a handler has published something by which a record can say where the turn was cut.

        Later input stands behind that when the run is repeated, too. Where handlers of the program alone publish to
        each other, which nothing repeats, any place will do.
        """
        place, queue = self.observers.place, self.queue
        before = place()
        for _ in range(_SLICE):
            if not queue:
                return bool(self._behind)
            subscription, message = queue.popleft()
            try:
                subscription.handler(message)
            except BaseException as error:
                subscription.fail(error)
            if place() != before:
                break
        return True

    def _resume_later(self, resume: Callable[[], object] | None = None) -> None:
        # `active` stays true: whatever is published meanwhile waits behind what the turn still has to deliver.
        if self.time >= 0:
            self.observers.cut(self.time)
            self.time = -1
            self._cuts += 1
        if self.loop is not None and not self.loop.is_closed():
            self.loop.call_soon(resume or self._go_on)
            self.active = True
        else:
            self.active = False

    def resume_later(self) -> None:
        """Go on with a turn that is cut where whoever watched said so, from the event loop."""
        if self.active:
            self._resume_later()

    def _go_on(self) -> None:
        """Run the rest of a turn that was cut short, or messages left between turns, at the present time."""
        now = self.clock.now()
        if now >= self.clock.due and self.clock.firing < 0:
            self.clock.fire_before(now)  # as before any stimulus
        waited = now - self._waits_since if self._waits_since >= 0 else 0
        self.resume(now, starved=waited > self.starved_after * 1e9)

    def resume(self, time: int, *, starved: bool) -> None:
        """Go on with the turn that is cut, and with all input since, as of a time.

        Args:
            time: The time.
            starved: Whether other input has waited for too long by then.
        """
        self.time = self.last = time
        self.observers.tell(Resumed, time, starved)
        if self._cuts > 1:  # what is to come behind a turn without end comes behind what that has published by now
            while self._behind:
                self.queue.extend(self._behind.popleft()[1])
        if starved and not self._starved:
            self._starved = True
            self.on_starved(
                f"a turn goes on without end, and other input has come for {self.starved_after:g} s{self._going()}"
            )
        if self._cuts % _LOOKS == 1:
            self._look_for_circle()
        try:
            self.run()
        finally:
            if not self.active:  # the turn that was cut has come to its end
                if self._circle is not None and self.watch == self._circle.look:
                    self.watch = None
                self._circle = None
                self._cuts = 0
                self._waits_since = -1
                if self._starved:
                    self._starved = False
                    self.on_starved("")

    def _note_waiting(self) -> None:
        """Note that other input waits for the turn that is cut."""
        if self._waits_since < 0:
            self._waits_since = self.clock.now()

    def _fail_later(self, subscription: Subscription[Any], error: RecursionError, limit: int) -> None:
        """Handle a failure, and the rest of the turn, from the event loop: the stack here is too deep."""
        self.straight = 0
        failing: Subscription[None] = Subscription(None, None, lambda _: subscription.fail(error))
        self.queue.appendleft((failing, None))

        def resume() -> None:
            sys.setrecursionlimit(limit)
            self._go_on()

        self._resume_later(resume)
        if not self.active:
            resume()

    def publish_from_thread(self, channel: Channel[Any], message: object) -> None:
        """Take a message from another thread into the `Inbox`; many of them share one wake-up of the event loop.

        After the end it is counted, and that is all: drivers' threads end when they end, and none can know of ours.

        Raises:
            Error: If the runtime has not begun, or is that of the process from which this one was forked.
        """
        loop = self.loop
        if loop is None or loop.is_closed():
            self._refused += 1
            if self._forked:
                raise Error(
                    f"channel {channel.name!r} got a message in a forked process, but its runtime is the parent's: "
                    f"send it there through a pipe or a queue"
                )
            if not self.thread:
                raise Error(f"channel {channel.name!r} got a message before its runtime began")
            return
        self._inbox.put(channel, message, self.clock.now())
        if not self._woken:
            self._woken = True
            try:
                loop.call_soon_threadsafe(self._drain)
            except RuntimeError:  # it has just been closed
                self._refused += 1

    def _drain(self) -> None:
        loop, inbox = self.loop, self._inbox
        if self.active and self._waits and loop is not None:
            loop.call_soon(self._drain)  # a turn without end must not become the place where things pile up
            self._note_waiting()
            return
        self._woken = False
        before = self._from_threads
        # Only what is there now: what comes meanwhile has woken the event loop again, which must not starve.
        for _ in range(len(inbox)):
            item = inbox.take()
            if item is None:
                break
            self._from_threads += 1
            channel, message, since = item
            now = self.clock.now()
            self.told = (now, since)
            try:
                channel.publish(self._delivered(message, now))
            finally:
                self.told = _NONE_TOLD
        if self.active and self._from_threads > before:
            self._waits = True
            self.queue.append((self._taken, None))
        self._tell_losses()

    def _take_more(self, _: None) -> None:
        self._waits = False

    def _delivered(self, message: Any, now: int) -> Any:
        """Return a message of another thread with the time at which it is delivered."""
        if message.__class__ is SensorUpdate:
            time = message.time if message.sensed is None else message.sensed
            return SensorUpdate(now, message.predicates, message.events, time)
        if isinstance(message, _STAMPED):
            return replace(message, time=now)
        return message

    def waited(self, time: int) -> int:
        """Return for how many nanoseconds the stimulus of a turn, at a time, had waited before: input of threads."""
        delivered, since = self.told
        return time - since if time >= delivered else 0

    def _tell_losses(self) -> None:
        """Report lost messages: once, until all of a channel's messages are accepted again."""
        losses = self._inbox.losses()
        for channel, lost in losses.items():
            channel.dropped += lost
            if channel not in self._overflowing:
                self.on_overflow(
                    f"{lost:,} messages of other threads on channel {channel.name!r} were lost: {self._inbox.bound:,} "
                    f"waited already while the event loop did not take them"
                )
        self._overflowing = set(losses)

    def statistics(self) -> DispatcherStatistics:
        """Return the dispatcher's statistics so far."""
        return DispatcherStatistics(
            turns=self._turns + self._turns_behind,
            interrupted=self._interrupted,
            from_threads=self._from_threads,
            replaced=self._inbox.replaced,
            lost=self._inbox.lost,
            refused=self._refused,
        )


class Alarm(Timer):
    """A timer that begins a turn of one subscriber, and may be set again; ``cancel()`` takes it back.

    Args:
        dispatcher: Runs the turn.
        turn: The subscriber.
    """

    __slots__ = ("_dispatcher", "_timer", "_turn")

    def __init__(self, dispatcher: Dispatcher, turn: Subscription[None]) -> None:
        self._dispatcher = dispatcher
        self._turn = turn
        self._timer: Timer | None = None  # the clock's
        self.when = 0

    @property
    def waiting(self) -> bool:
        """Whether it will still begin a turn."""
        return self._timer is not None

    def set(self, when: int) -> None:
        """Begin a turn at a time, or now where that has passed; one that begins sooner stands for both."""
        timer, dispatcher = self._timer, self._dispatcher
        if timer is not None:
            if self.when <= when:
                return
            timer.cancel()
        time = dispatcher.time
        self.when = max(when, time if time >= 0 else dispatcher.now())
        self._timer = dispatcher.clock.call_at(self.when, self._fire)

    def _fire(self) -> None:
        self._timer = None
        self._dispatcher.deliver_due(self._turn, None, self.when)

    def cancel(self) -> None:
        """Begin no turn, unless it is set again."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class _Circle:
    """Watches some messages of a turn, and names those that lead to others without end.

    Args:
        dispatcher: Which delivers them.
    """

    def __init__(self, dispatcher: Dispatcher) -> None:
        self._dispatcher = dispatcher
        self._left = _WATCHED
        self._head: Subscription[Any] | None = None
        self._length = 0
        # Who has published on which channel, and who takes what comes there, by name.
        self._edges: dict[tuple[str, str], set[str]] = {}

    def look(self) -> bool:
        """Note the consequences of the message delivered last, before the next one; the turn is not cut there."""
        queue = self._dispatcher.queue
        if self._head is not None:
            # What a handler publishes stands behind all that waited by then.
            for led_to, _ in islice(queue, self._length - 1, None):
                if led_to.channel is not None:
                    self._edges.setdefault((_name(self._head), led_to.channel.name), set()).add(_name(led_to))
        self._head = queue[0][0] if queue else None
        self._length = len(queue)
        self._left -= 1
        if self._left < 0:
            self._dispatcher.watch = None
        return False

    def __str__(self) -> str:
        """Return who publishes on which channel, as far as that leads to further messages."""
        edges = dict(self._edges)
        while True:  # who takes a message and publishes nothing does not keep the turn going
            going = {who for who, _ in edges}
            on = {edge: takers for edge, takers in edges.items() if not takers.isdisjoint(going)}
            if len(on) == len(edges):
                break
            edges = on
        edges = edges or self._edges  # where each round is a turn of its own, a task leads from one to the next
        told = [f"{who} publishes on {channel!r}" for who, channel in islice(edges, _NAMED)]
        more = len(edges) - len(told)
        return ", ".join(told) + (f", and {more} more" if more > 0 else "")


def _name(subscription: Subscription[Any]) -> str:
    """Return the path of the actor whose handler takes messages; that of the program is no actor's."""
    path = getattr(subscription.actor, "path", "")
    return repr(path) if path else "a handler of the program"


def _leave_to_parent() -> None:
    for dispatcher in _OPEN:
        dispatcher.leave_to_parent()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_parent)
