"""The runtime: one tree of actors, their channels, clock and dispatcher, inside a running asyncio program."""

from __future__ import annotations

import asyncio
import builtins
import inspect
import threading
from collections.abc import Iterable
from contextlib import AsyncExitStack, suppress
from typing import TYPE_CHECKING, Any, Literal, TypeVar
from weakref import WeakKeyDictionary, WeakSet, WeakValueDictionary

import anyio
import msgspec

from mdm.checks import check_flag
from mdm.errors import Error
from mdm.messages import Decision, Fault, Idle, Mode, StateChange
from mdm.runtime.actor import Actor, Sharing, descendants
from mdm.runtime.channel import Channel, Subscription
from mdm.runtime.dispatcher import Dispatcher
from mdm.runtime.extension import Extension, extension_of
from mdm.runtime.observing import Guard, Observer, Observers, name_of
from mdm.runtime.process.log import FirstFailures, Log
from mdm.runtime.process.signals import Signals
from mdm.runtime.process.watchdog import Emergency, Watchdog, check_emergency, check_watch
from mdm.runtime.statistics import (
    ActorStatistics,
    ChannelStatistics,
    DispatcherStatistics,
    LogStatistics,
    LoopStatistics,
)
from mdm.runtime.supervision import LEAVING, ActorFailure, describe, text_of
from mdm.runtime.time.clock import Clock, WallClock, check_seconds
from mdm.runtime.time.virtual import VirtualClock, VirtualEventLoop
from mdm.runtime.work import hide, unwatch, watch
from mdm.stimuli import Finished

if TYPE_CHECKING:
    import os
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self

    from mdm.runtime.work import Work

T = TypeVar("T")

_LIVING: WeakSet[Extension] = WeakSet()
"""Extensions that are open."""

_OPEN: WeakKeyDictionary[asyncio.AbstractEventLoop, WeakSet[Runtime]] = WeakKeyDictionary()


class RuntimeStatistics(msgspec.Struct, frozen=True):
    """A snapshot of everything in a runtime.

    Attributes:
        dispatcher: Of its dispatcher.
        actors: Of each actor, parents before their children.
        channels: Of each channel, in the order in which they were made.
        log: Of its log; None without one.
        loop: Of its event loop; None without a watchdog.
    """

    dispatcher: DispatcherStatistics
    actors: tuple[ActorStatistics, ...]
    channels: tuple[ChannelStatistics, ...]
    log: LogStatistics | None
    loop: LoopStatistics | None

    def __str__(self) -> str:
        """Return a table of the numbers that are not zero: a line for each actor and channel."""
        rows = [("dispatcher", self.dispatcher.told())]
        rows += [(what, each.told()) for what, each in (("log", self.log), ("loop", self.loop)) if each is not None]
        rows += [(f"actor {actor.path}", actor.told("path", "since")) for actor in self.actors]
        used = [channel for channel in self.channels if channel.published or channel.dropped or channel.unheard]
        rows += [(f"channel {channel.name}", channel.told("name", "last")) for channel in used]
        width = max(len(what) for what, _ in rows)
        return "\n".join(f"{what:{width}}  {told}" for what, told in rows if told)


class Runtime:
    """Runs actors inside a program that already has a running asyncio event loop.

    Use it as ``async with mdm.Runtime() as runtime:``. However the block is left, its actors stop in order, children
    before parents and later ones before earlier ones; nothing outlives the block but work that ignores being
    cancelled, which is listed in `abandoned`. A program that is cancelled once more while they stop waits until they
    have stopped or their limits have passed. Then they are broken off: their waits are cancelled, and only their
    `on_stop` is still called. Two runtimes in one process do not know of each other.

    SIGINT, SIGTERM and SIGHUP stop the actors at once and cancel the block, which raises `KeyboardInterrupt` or
    `SystemExit` (143, 129) when they have stopped; so does a `SystemExit` that an actor or its work raises. A second
    signal changes nothing while actors stop within their limits; one after these, or a third, breaks them off. Several
    within a quarter of a second are one, and one within a second after the end changes nothing. Signals that the
    program handles itself, or that are ignored, are left alone.

    Args:
        clock: Whose time; where none is given, a `VirtualClock` inside a program that `mdm.run` runs in virtual time,
            else a `WallClock`.
        log: ``"console"`` or ``"json"`` lines on standard error, a structlog logger of your own, or a `Log`: it tells
            faults, modes, and the lives of the actors at the top. Lines are written on a thread of their own; where
            nobody reads them, some are lost and counted. With None the first failure of each action is printed, and
            nothing else; with False nothing at all.
        debug: Log decisions too, and the lives of all actors.
        watchdog: Seconds for which the event loop may stand still before a thread reports it, with the stack of the
            call that holds it, at once in the log and as a fault ``stall`` when the loop turns again; None for no
            watchdog. In virtual time there is none.
        emergency: A plain function without arguments that makes the robot safe by itself (cuts the motors, opens a
            relay). It is called on a thread of its own, when nothing else can be relied on.
        emergency_after: Seconds for which the event loop stands still before ``emergency`` is called; by default those
            of ``watchdog``.
        starved_after: Seconds for which a turn that was cut short may go on while other input comes, before all
            ensembles go safe; by default those of the system's file, else 1. In virtual time 100,000 messages or turns
            at one instant end the runtime.
        signals: Whether signals end the runtime; by default in the main thread, under a wall clock.
        record: The file, such as ``run.mcap``, to which the run is recorded, or a `Recorder` with options of its own.
            It needs the extra ``record``. A fault tells where it fails, and the run goes on.
        page: The port of a page for browsers of this machine, which shows the run live, or a `mdm.views.web.Page` with
            options of its own. It needs the extra ``page``, and real time.
        extensions: Further objects that live as long as the runtime, see `Extension`: they open in this order, behind
            the record and before the page, and close in reverse.

    Raises:
        Error: If ``emergency`` cannot be called so, the times contradict each other, or one of ``extensions`` is none.
        ActorFailure: On leaving the block, if an actor failed and nobody above it could help.

    Attributes:
        ending: Whether it ends: no decided action starts any more.
        starved: Why other input has waited for too long for a turn that goes on; empty where none has.
        observers: All who observe the run.
        extensions: All that live as long as the runtime, in the order of opening.
        recorder: The one that records the run; None where none does.
        page: The page that shows it; None where there is none.
    """

    def __init__(
        self,
        *,
        clock: Clock | None = None,
        log: Literal["console", "json"] | Any | None = "console",
        debug: bool = False,
        watchdog: float | None = 1.0,
        emergency: Callable[[], object] | None = None,
        emergency_after: float | None = None,
        starved_after: float | None = None,
        signals: bool | None = None,
        record: str | os.PathLike[str] | Extension | None = None,
        page: int | Extension | None = None,
        extensions: Iterable[Extension] = (),
    ) -> None:
        check_watch(watchdog, emergency, emergency_after)
        check_flag(debug, "debug")
        if starved_after is not None:
            check_seconds(starved_after, "starved_after")
        if signals is not None:
            check_flag(signals, "signals")
        if clock is not None and not isinstance(clock, Clock):
            raise Error(f"a runtime's clock is a WallClock(), a VirtualClock() or a Clock of your own, not {clock!r}")
        self.clock = _clock_of_the_loop() if clock is None else clock
        self.clock.resumed = lambda seconds: self._alarm("suspended", f"the machine was suspended for {seconds:.1f} s")
        self.dispatcher = Dispatcher(self.clock)
        self.observers = self.dispatcher.observers = Observers(self)
        self.observers.watch(self._count_observers)
        self.dispatcher.on_overflow = lambda detail: self._alarm("overflow", detail)
        self.dispatcher.on_endless = lambda detail: self._alarm("endless_turn", detail)
        self.dispatcher.on_starved = self._starve
        self.dispatcher.on_standstill = self._stand_still
        self._starved_after = starved_after
        self.limit_starving(1.0)
        self.starved = ""
        self.abandoned: list[Work] = []
        self._channels: dict[str, Channel[Any]] = {}
        self._deserted: WeakValueDictionary[str, Channel[Any]] = WeakValueDictionary()
        self.root = Actor("")
        self.sharing = Sharing(self.root)
        self.faults = self.channel("faults", Fault)
        self.lives = self.channel("lives", StateChange)
        self.decisions = self.channel("decisions", Decision)
        self.modes = self.channel("modes", Mode)
        self.idles = self.channel("idles", Idle)
        self._first_failures = FirstFailures() if log is None else None
        self._log = None if log is None or log is False else log if isinstance(log, Log) else Log(log, debug=debug)
        virtual = isinstance(self.clock, VirtualClock)
        self._emergency = Emergency(lambda detail: self._alarm("emergency", detail), threads=not virtual)
        if emergency is not None:
            self._emergency.add(emergency)
        self._watchdog: Watchdog | None = None
        if watchdog is not None and not virtual:
            after = None if emergency is None else watchdog if emergency_after is None else emergency_after
            self._watchdog = Watchdog(watchdog, self._alarm, self.emergency, after)
        self._signals = Signals(self._leave, self._break_off)
        self.recorder: Any = None if record is None else extension_of("record", record)
        self.page: Any = None if page is None else extension_of("page", page)
        self._named = _named(self.recorder, extensions, self.page)
        self.extensions = tuple([extension for _, extension in self._named])
        self._opened: list[tuple[Extension, Guard]] = []
        self._hears = isinstance(self.clock, WallClock) if signals is None else signals
        self._must_hear = signals is True
        self._host: asyncio.Task[Any] | None = None
        self._cancelling = 0
        self._interrupted = False
        self.ending = False
        self._leaving = False
        self._stopped = anyio.Event()
        self._tree: asyncio.Task[None] | None = None
        self._failure: BaseException | None = None

    # -- Channels ------------------------------------------------------------------------------------------------

    def channel(self, name: str, type: type[T], *, retain: bool = False) -> Channel[T]:  # noqa: A002
        """Return the channel of a name, made at the first call.

        An actor's channel is dropped, with its retained message, when the actor has ended and nobody listens.

        Raises:
            Error: If it exists and carries messages of another type.
        """
        if not isinstance(name, str) or not isinstance(type, builtins.type):
            raise Error(f"a channel has a name and carries messages of a class, not {name!r} and {type!r}")
        channel = self._channels.get(name)
        if channel is None:  # made again, unless somebody has kept the one that was given back
            channel = self._deserted.get(name)
            if channel is None:
                channel = Channel(name, type, self.dispatcher, retain=retain, owner=self.root)
            self._channels[name] = channel
        if channel.type is not type:
            raise Error(f"channel {name!r} carries {channel.type.__name__} messages, not {type.__name__}")
        return channel

    def desert(self, channels: Iterable[Channel[Any]]) -> None:
        """Give back the channels of an actor that has ended, when nobody listens; at the runtime's end, keep them."""
        if self.root.life == "running":
            for channel in channels:
                channel.desert(self._give_back)

    def _give_back(self, channel: Channel[Any]) -> None:
        if self._channels.get(channel.name) is channel:
            del self._channels[channel.name]
            self._deserted[channel.name] = channel
            channel.forget()

    def now(self) -> int:
        """Return the time of the running turn, that of its stimulus, in nanoseconds; outside of turns the clock's.

        Everything that is published in a turn carries it. From another thread it is the clock's, too.
        """
        return self.dispatcher.now()

    @property
    def channels(self) -> tuple[Channel[Any], ...]:
        """All channels, in the order of their making."""
        return tuple(self._channels.values())

    def observe(self, observer: Observer) -> Guard:
        """Let an observer hear all that follows; return its guard, which counts its errors and has `cancel`."""
        return self.observers.add(observer)

    def _count_observers(self) -> None:
        self.dispatcher.observed = self.observers.heard

    def say(self, event: str, **facts: object) -> None:
        """Write a line to the log, where there is one."""
        if self._log is not None:
            self._log.write(event, lambda: facts)

    # -- Actors --------------------------------------------------------------------------------------------------

    async def start(self, actor: Actor) -> None:
        """Start an actor at the top of the tree, its children after it; an error of its start is raised here.

        Its ``extensions``, where it has any, open before it, and close with those of the runtime; a replay opens none.
        """
        own = () if self._tree is None or self.dispatcher.choices.repeats else getattr(actor, "extensions", ())
        for name, extension in _named(None, own, None):
            if all(extension is not other for other, _ in self._opened):
                await self._open(name, extension)
        await self.root.start_child(actor)

    async def stop(self, actor: Actor) -> None:
        """Stop an actor at the top of the tree and wait for its end."""
        await self.root.stop_child(actor)

    async def wait(self) -> None:
        """Wait until the runtime is stopped by `shut_down`, or by an actor's failure."""
        await self._stopped.wait()

    def shut_down(self) -> None:
        """Let `wait` return; actors stop when the block is left."""
        self._stopped.set()

    def abort(self, error: BaseException) -> None:
        """End the block because of an error that nobody could help; the first one counts."""
        if self._failure is not None:
            return
        self._failure = error
        self._begin_to_end()
        self.shut_down()
        self.root.end()
        if self._host is not None:
            self._host.get_loop().call_soon(self._interrupt)

    def _begin_to_end(self) -> None:
        """Tell all that run, at once: one after the other they stop, which takes time."""
        if self.dispatcher.time >= 0:
            self._tell_of_end()
        else:  # in one turn, so that what one of them publishes reaches no other before that has been told
            self.dispatcher.deliver(Subscription(None, None, lambda _: self._tell_of_end()), None)

    def _tell_of_end(self) -> None:
        if self.ending:  # what a timer brought about that was due before has ended it
            return
        self.ending = True
        within = self.dispatcher.time >= 0 and bool(self.dispatcher.queue)
        self.observers.tell(Finished, self.now(), within)
        self._tell_all(lambda actor: actor.on_ending())

    def _starve(self, detail: str) -> None:
        """Tell all that run that input has waited for too long, in the running turn; or, behind it, no longer does."""
        self.starved = detail
        if detail:
            self._alarm("starved", detail)
            self._tell_all(lambda actor: actor.on_starved(detail))
        else:
            end: Subscription[None] = Subscription(
                None, None, lambda _: self._tell_all(lambda actor: actor.on_starved(""))
            )
            self.dispatcher.deliver_due(end, None, self.dispatcher.last)

    def _stand_still(self, detail: str) -> None:
        """End the block, for virtual time stands still; it goes on meanwhile."""
        self.abort(Error(detail))
        if isinstance(loop := self.dispatcher.loop, VirtualEventLoop):
            loop.go_on()

    def limit_starving(self, seconds: float) -> None:
        """Let a turn that was cut go on for so many seconds while other input comes, where nothing else was given."""
        self.dispatcher.starved_after = seconds if self._starved_after is None else self._starved_after

    def _tell_all(self, tell: Callable[[Actor], object]) -> None:
        """Tell all actors that run, each before its children."""
        waiting: list[Actor] = [self.root]
        while waiting:
            actor = waiting.pop()
            waiting += reversed(actor.children)
            if actor.life == "running" and not actor.failing:  # one that has failed is told so in this very call
                try:
                    tell(actor)
                except BaseException as error:
                    actor.report("exception", describe(error))
                    if isinstance(error, LEAVING):
                        self.abort(error)

    def _interrupt(self) -> None:
        """Cancel the block, where it has not been left; its task may be another than the one that leaves it."""
        if self._host is not None and not self._leaving:
            self._interrupted = self._host.cancel()

    def _leave(self, error: BaseException) -> float:
        """End the block because of a signal; return how long actors may take by their own limits."""
        self.abort(error)
        return self._limit()

    def _limit(self) -> float:
        """Return how many seconds the actors may take to stop by their own limits."""
        actors = descendants(self.root)
        return 1.0 + sum(actor.patience + (actor.grace if actor.statistics().work else 0.0) for actor in actors)

    def _break_off(self) -> None:
        if self._tree is not None:
            self._tree.cancel()

    def emergency(self, reason: str) -> None:
        """Report why, and call the program's ``emergency``: the last resort, when a safe action fails. From any thread.

        It is called on a thread of its own, in virtual time at once. Its errors are reported, too.
        """
        self._emergency.call(reason)

    def add_emergency(self, emergency: Callable[[], object]) -> None:
        """Call another function as ``emergency``, after those before it; each is called once.

        Where there was none, the watchdog calls it as soon as it reports.

        Raises:
            Error: If it cannot be called so.
        """
        check_emergency(emergency)
        self._emergency.add(emergency)
        if self._watchdog is not None:
            self._watchdog.call_emergency()

    def _alarm(self, kind: str, detail: str) -> None:
        """Publish a fault of the runtime itself, and log it before: the event loop may not turn."""
        fault = Fault(self.now(), "runtime", kind, detail)
        if self._log is not None:
            with suppress(Exception):  # a log that fails must end nothing
                self._log.tell(fault)
        with suppress(Error):  # a runtime that does not run has no subscribers
            self.faults.publish(fault)

    # -- Life ----------------------------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        if self._tree is not None:
            raise Error("a runtime runs once: make a new one for each block")
        if self._must_hear and threading.current_thread() is not threading.main_thread():
            raise Error("signals reach the main thread alone: enter the runtime there, or leave signals out")
        loop = _running_loop()
        if isinstance(self.clock, WallClock) and isinstance(loop, VirtualEventLoop):
            raise Error(
                "a WallClock stands still where the event loop's time is virtual: make the Runtime inside the program "
                "that mdm.run(main, virtual=True) runs, or give it clock=mdm.VirtualClock()"
            )
        self.clock.open(loop)
        self.dispatcher.open(loop)
        await self._open_extensions()
        watch(loop)
        for log in (self._log, self._first_failures):
            if log is not None:
                log.open(self)
        if self._watchdog is not None:
            self._watchdog.open(loop)
        # The tree has a task of its own, so that a cancelled program still stops it in order.
        began = asyncio.Event()
        self._tree = loop.create_task(self._grow(began), name="mdm:root")
        hide(self._tree)
        _OPEN.setdefault(loop, WeakSet()).add(self)
        try:
            await began.wait()
        except BaseException:
            await self._stop_tree(self._tree)
            raise
        self._host = asyncio.current_task()
        self._cancelling = 0 if self._host is None else self._host.cancelling()
        self._tree.add_done_callback(self._tree_ended)
        if self._hears:
            self._signals.open(loop)
        return self

    async def _open_extensions(self) -> None:
        async with AsyncExitStack() as opened:
            opened.callback(self.clock.close)
            opened.callback(self.dispatcher.close)
            opened.callback(self.observers.end)
            opened.push_async_callback(self._close_extensions)
            for name, extension in self._named:
                await self._open(name, extension)
            opened.pop_all()

    async def _open(self, name: str, extension: Extension) -> None:
        try:
            if extension in _LIVING:
                raise Error(f"{name} is open in a runtime: an extension lives as long as one")
            opening: Any = extension.open(self)
            if not inspect.isawaitable(opening):
                raise Error(f"{name} cannot be opened: its open is no async function")
            await opening
            _LIVING.add(extension)
        except Error:
            raise
        except Exception as error:
            raise Error(f"{name} cannot be opened: {describe(error)}") from error
        if isinstance(extension, Observer):  # which a page of the program's own need not be
            self.observe(extension)
        self._opened.append((extension, Guard(self, name)))

    async def _close_extensions(self) -> None:
        """Close the extensions that are open, the last one first; a fault names one that cannot be closed."""
        leaving = None
        while self._opened:
            extension, guard = self._opened.pop()
            closing = asyncio.ensure_future(_closed(extension))
            seconds = getattr(extension, "patience", Extension.patience)
            with anyio.CancelScope(shield=True):
                await asyncio.wait([closing], timeout=seconds)
            _LIVING.discard(extension)
            if not closing.done():
                closing.cancel()
                guard.lose(f"it is not closed after {seconds:g} s, and left so")
            elif isinstance(error := closing.result(), LEAVING):
                leaving = error
            elif error is not None:
                guard.lose(error)
        if leaving is not None:
            raise leaving

    async def _grow(self, began: asyncio.Event) -> None:
        async with anyio.create_task_group() as group:
            await self.root.live_in(group, self)
            began.set()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        assert self._tree is not None
        self._leaving = True
        swallowed = False
        if self._interrupted and self._host is not None and self._host is asyncio.current_task():
            swallowed = self._host.uncancel() <= self._cancelling and isinstance(error, asyncio.CancelledError)
        self._stopped.set()
        try:
            await self._stop_tree(self._tree)
        except asyncio.CancelledError:  # meanwhile: the exception that ends the program comes before it
            if not isinstance(self._failure, LEAVING):
                raise
        failure = self._failure
        if isinstance(failure, LEAVING):
            raise failure from (None if error is None or swallowed else error)
        if not self._tree.cancelled():
            self._tree.result()  # raises what a fault of ours did to it
        if failure is not None and (error is None or swallowed):
            if isinstance(failure, ActorFailure):
                raise failure
            raise ActorFailure(text_of(failure)) from failure
        return swallowed

    def _tree_ended(self, _: object) -> None:
        """Raise the exception that ends the program from the event loop, where the block's task has ended."""
        if not self._leaving and self._host is not None and self._host.done() and isinstance(self._failure, LEAVING):
            raise self._failure

    async def _stop_tree(self, tree: asyncio.Task[None]) -> None:
        """Stop the actors in order and close everything, the last of these first, past all errors."""
        async with AsyncExitStack() as closing:
            later = closing.callback
            later(self._signals.close)
            later(self.observers.end)
            later(unwatch, tree.get_loop())
            later(self.clock.close)
            later(self.dispatcher.close)
            later(self._close_channels)
            closing.push_async_callback(self._close_extensions)
            later(self._emergency.close)
            if self._watchdog is not None:
                later(self._watchdog.close)
            await self._end(tree)

    def _close_channels(self) -> None:
        for channel in self._channels.values():
            channel.close()

    async def _end(self, tree: asyncio.Task[None], *, pressed: bool = False) -> None:
        """Stop the actors in order; a cancellation waits until they have stopped, or are past their limits.

        Args:
            tree: Their task.
            pressed: Break them off past their limits, though nobody is cancelled.
        """
        self._begin_to_end()
        self.root.end()
        loop = tree.get_loop()
        until = loop.time() + self._limit()
        cancelled: asyncio.CancelledError | None = None
        broken = False
        while not tree.done():
            left = until - loop.time() if not broken and (pressed or cancelled is not None) else None
            if left is not None and left <= 0:
                broken, left = tree.cancel(), None
            try:
                with anyio.CancelScope(shield=True):
                    await asyncio.wait([tree], timeout=left)
            except asyncio.CancelledError as error:
                cancelled = error
            except BaseException:
                tree.cancel()
                raise
        if cancelled is not None:
            raise cancelled

    def explain(self, ensemble: str, last: int = 10) -> Any:
        """Return why an ensemble has decided as it did last, in the words of `mdm explain`.

        Example::

            print(runtime.explain("robot"))

        Args:
            ensemble: Its path, such as ``robot``, or ``top/patrol`` of one below another.
            last: How many of the last observations are looked at.

        Returns:
            An `mdm.explanation.Explanation`, of which `str` is in words.

        Raises:
            Error: If there is no such ensemble, or it has decided nothing in this episode.
        """
        known: dict[str, Any] = {each.path: each for each in descendants(self.root) if hasattr(each, "explain")}
        if ensemble not in known:
            raise Error(f"there is no ensemble {ensemble!r}; there is {', '.join(known) or 'none'}")
        return known[ensemble].explain(last)

    def statistics(self) -> RuntimeStatistics:
        """Return a snapshot of everything in the runtime."""
        actors: list[ActorStatistics] = []

        def visit(actor: Actor) -> None:
            actors.append(actor.statistics())
            for child in actor.children:
                visit(child)

        for child in self.root.children:
            visit(child)
        return RuntimeStatistics(
            dispatcher=self.dispatcher.statistics(),
            actors=tuple(actors),
            channels=tuple(channel.statistics() for channel in self._channels.values()),
            log=None if self._log is None else self._log.statistics(),
            loop=None if self._watchdog is None else self._watchdog.statistics(),
        )


async def end_all() -> None:
    """Stop the actors of every runtime of the running event loop, within its limits."""

    async def end(runtime: Runtime) -> None:
        tree = runtime._tree  # noqa: SLF001 - one module
        if tree is not None and not tree.done():
            await runtime._end(tree, pressed=True)  # noqa: SLF001

    await asyncio.gather(*map(end, tuple(_OPEN.get(asyncio.get_running_loop(), ()))), return_exceptions=True)


async def _closed(extension: Extension) -> BaseException | None:
    """Close an extension; return what it has raised, be it the cancellation of a task of its own."""
    try:
        await extension.close()
    except BaseException as error:
        return error
    return None


def _named(record: Extension | None, given: Iterable[Extension], page: Extension | None) -> list[tuple[str, Extension]]:
    """Return all extensions by name, in the order of opening: the record hears all others, and the page shows them.

    Raises:
        Error: If one of those that are given is none.
    """
    named = [] if record is None else [("the record", record)]
    if not isinstance(given, Iterable):
        raise Error(f"extensions are a list of such objects, not {given!r}")
    for each in given:
        if not isinstance(each, Extension):
            raise Error(f"extensions are objects of a class derived from mdm.Extension, not {each!r}")
        named.append((name_of(each), each))
    named += [] if page is None else [("the page", page)]
    twice = [name for place, (name, each) in enumerate(named) if any(each is other for _, other in named[:place])]
    if twice:
        raise Error(f"{twice[0]} is given twice: an extension is opened once")
    return named


def _running_loop() -> asyncio.AbstractEventLoop:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        raise Error(
            "a runtime needs asyncio's event loop, and none runs here: start the program by mdm.run or asyncio.run, "
            "not by trio.run; with anyio.run the backend is 'asyncio'"
        ) from None


def _clock_of_the_loop() -> Clock:
    """Return a clock that goes as the running event loop does."""
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return WallClock()
    return VirtualClock() if isinstance(loop, VirtualEventLoop) else WallClock()
