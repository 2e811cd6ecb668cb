"""Actors: the units of a program, which share nothing, handle one message at a time, and live in a tree."""

from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING, Any, Literal, TypeVar
from weakref import WeakSet

import anyio

from mdm.errors import Error
from mdm.messages import Fault, StateChange, Tick
from mdm.runtime.channel import Channel, Subscription
from mdm.runtime.dispatcher import Alarm
from mdm.runtime.handler import check_plain, kind_of
from mdm.runtime.statistics import ActorStatistics
from mdm.runtime.supervision import (
    LEAVING,
    ActorFailure,
    Restart,
    RestartBudget,
    Supervision,
    check_supervision,
    describe,
    failure,
    text_of,
    was_cancelled,
)
from mdm.runtime.time.clock import check_seconds
from mdm.runtime.time.scheduler import Ticker
from mdm.runtime.work import Workload, hide
from mdm.stimuli import Began, Failed, Ticked

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Iterable

    from anyio.abc import TaskGroup

    from mdm.runtime.runtime import Runtime
    from mdm.runtime.work import Jobs, Work


class _Loan:
    """Who uses an actor, the path that it lives at, and a lock, since its start and its stop take time."""

    __slots__ = ("lock", "place", "users")

    def __init__(self, place: str) -> None:
        self.place = place
        self.lock = asyncio.Lock()
        self.users: dict[Actor, None] = {}


class Sharing:
    """Starts actors for their first user, ahead of it, and stops them behind the last.

    An actor that has a parent already, or that a program has started itself, is left alone.

    Args:
        root: The parent of those that are shared.
    """

    def __init__(self, root: Actor) -> None:
        self._root = root
        self._loans: dict[Actor, _Loan] = {}

    def users(self, actor: Actor) -> tuple[Actor, ...]:
        """Return who uses an actor: its failure is theirs."""
        loan = self._loans.get(actor)
        return () if loan is None else tuple(loan.users)

    def reserve(self, actor: Actor, user: Actor) -> str:
        """Register a user; return the prefix of the actor's path: the path of its first user.

        Raises:
            Error: If it lives in another runtime, whose channels its user does not hear.
        """
        loan = self._loans.get(actor)
        if loan is None:
            if actor.parent is not None:
                if actor.life != "created" and actor.runtime is not user.runtime:
                    raise Error(
                        f"actor {user.path!r} cannot use {actor.path!r}, for {actor.path!r} lives in another runtime: "
                        "give each runtime one of its own"
                    )
                return ""
            loan = self._loans[actor] = _Loan(user.path)
        loan.users[user] = None
        return loan.place

    async def lend(self, actor: Actor) -> None:
        """Start an actor for those who reserved it, where it does not live; an error of its start is raised here."""
        loan = self._loans.get(actor)
        if loan is None:
            return
        async with loan.lock:
            ended = actor.life == "stopped" or (actor.failing and actor.life != "restarting")
            if ended and actor.parent is self._root:
                await self._root.stop_child(actor)  # forget it: those who used it have yet to end
            if actor.parent is None:
                await self._root.start_child(actor, first=True, at=loan.place)

    async def give_back(self, actor: Actor, user: Actor) -> None:
        """Stop an actor if nobody uses it any more."""
        loan = self._loans.get(actor)
        if loan is None or user not in loan.users:
            return
        del loan.users[user]
        async with loan.lock:
            if loan.users:
                return
            if actor.parent is self._root:
                await self._root.stop_child(actor)
            if not loan.users and self._loans.get(actor) is loan:
                del self._loans[actor]


class Start:
    """Notifies the starter of an actor that it runs, or of the error of its start.

    Args:
        untold: Called with the error of the start, where the starter was cancelled and no longer waits.
    """

    def __init__(self, untold: Callable[[BaseException], object]) -> None:
        self._untold = untold
        self._left = False
        self._event = anyio.Event()
        self._error: BaseException | None = None

    def done(self) -> None:
        """Say that the actor runs."""
        self._event.set()

    def failed(self, error: BaseException | None) -> None:
        """Say that it has ended; before it ran, because of an error."""
        if not self._event.is_set():
            self._error = error
            self._event.set()
            self._tell_otherwise()

    def _tell_otherwise(self) -> None:
        if self._left and self._error is not None:
            self._untold(self._error)

    async def wait(self) -> None:
        """Wait until it runs; raise the error of its start."""
        try:
            await self._event.wait()
        except BaseException:
            self._left = True
            self._tell_otherwise()
            raise
        if self._error is not None:
            raise self._error


T = TypeVar("T")
Request = Literal["none", "stop", "restart", "fail"]
_PLAIN_HOOKS = ("on_start", "on_running", "on_failing", "on_ending", "on_starved", "on_stop")
_OVERRIDABLE = frozenset({*_PLAIN_HOOKS, "on_stopping", "patience", "statistics"})
_LATE = 1.0
Life = Literal["created", "starting", "running", "restarting", "stopping", "stopped", "failed"]


if TYPE_CHECKING:
    own = property
else:

    class own(property):  # noqa: N801 - a property but for one thing
        """A property that is the actor's own: one that a subclass sets by accident says so."""

        def __set__(self, actor: Actor, value: object) -> None:
            raise Error(_hidden(type(actor), self.fget.__name__))


class TakenName(Error):
    """An actor has two children of one name."""

    def __init__(self, path: str, name: str) -> None:
        super().__init__(f"actor {path!r} has two children named {name!r}")
        self.name = name


class Actor:
    """A unit that handles messages, one at a time and to completion.

    Subclass it and override the hooks. Handlers are plain functions that must neither block nor await; slow work
    goes to `spawn`, and its end comes back as a turn of its own. Its own attributes that are not for subclasses
    begin with two underscores, so that a subclass may call its own as it likes; a subclass that hides a public one is
    refused.

    Args:
        name: Its name among its siblings.
        supervision: The consequence of its failure: ``Restart(...)``, ``"stop"`` or ``"escalate"`` to its parent.
        grace: Seconds that its work has to end when it is cancelled, before it is abandoned.
    """

    def __init__(self, name: str, *, supervision: Supervision = "escalate", grace: float = 5.0) -> None:
        if not isinstance(name, str):
            raise Error(f"an actor's name is a text, not {name!r}")
        if "/" in name:
            raise Error(f"an actor's name has no '/': {name!r} would read as a path")
        check_supervision(supervision)
        check_seconds(grace, "grace", key="grace")
        self.name = name
        self.supervision = supervision
        self.grace = grace
        self.__parent: Actor | None = None
        self.__children: list[Actor] = []
        self.__names: set[tuple[str, str]] = set()
        self.__place = ""
        self.__shared: list[Actor] = []
        self.__life: Life = "created"
        self.__runtime: Runtime | None = None
        self.__channels: dict[str, Channel[Any]] = {}
        self.__subscriptions: list[Subscription[Any]] = []
        self.__timers: WeakSet[Alarm | Ticker] = WeakSet()
        self.__work = Workload(self)
        self.__received = 0
        self.__skipped = 0
        self.__failures = 0
        self.__restarts = 0
        self.__request: Request = "none"
        self.__requested: anyio.Event | None = None
        self.__ended: anyio.Event | None = None
        self.__group: TaskGroup | None = None
        self.__backoff = 0.0
        self.__budget = RestartBudget(supervision) if isinstance(supervision, Restart) else None

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse a subclass that hides an attribute of every actor, or whose hooks could not be called."""
        super().__init_subclass__(**options)
        for name in ("name", "supervision", "grace", *vars(Actor)):
            found = inspect.getattr_static(cls, name, None)
            ours = name.startswith("_") or name in _OVERRIDABLE or found is vars(Actor).get(name)
            if not ours and not (name == "path" and isinstance(found, property)):
                raise Error(_hidden(cls, name))
        for name in _PLAIN_HOOKS:
            check_plain(getattr(cls, name), f"{cls.__qualname__}.{name}")
        if kind_of(inspect.unwrap(cls.on_stopping)) != "an async function":
            raise Error(f"{cls.__qualname__}.on_stopping is awaited: define it with `async def`")

    # -- Hooks ---------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Prepare: subscribe, set timers, add children. Called in a turn, at the start and at each restart."""

    def on_running(self) -> None:
        """Begin: this actor and its children have started. Called in a turn, unless it has failed or ended by then."""

    async def on_stopping(self) -> None:
        """End work that needs living children to end in good order; called before they are stopped.

        A fault `stopping` names an actor for which this takes a second longer than its `patience`.
        """

    def on_failing(self, error: BaseException) -> None:
        """React at once to its failure, or to that of a child that it answers for. Called before it stops."""

    def on_ending(self) -> None:
        """React at once to the end of the whole runtime. Called in all running actors before the first stops."""

    def on_starved(self, detail: str) -> None:
        """React at once to a turn that goes on without end while other input comes; ``detail`` is empty at its end."""

    def on_stop(self) -> None:
        """Release the resources taken in `on_start`; subscriptions, timers and work have ended by then."""

    @property
    def patience(self) -> float:
        """Seconds within which `on_stopping` ends, by limits of its own; a second signal changes nothing meanwhile."""
        return 0.0

    # -- Place in the tree ---------------------------------------------------------------------------------------

    @own
    def path(self) -> str:
        """Names from the root down, joined by ``/``."""
        above = self.__place or ("" if self.__parent is None else self.__parent.path)
        return f"{above}/{self.name}" if above else self.name

    @own
    def parent(self) -> Actor | None:
        """The actor whose child it is, if any."""
        return self.__parent

    @own
    def children(self) -> tuple[Actor, ...]:
        """Its children, in the order of their starts."""
        return tuple(self.__children)

    @own
    def life(self) -> Life:
        """Where it stands in its life."""
        return self.__life

    @own
    def failing(self) -> bool:
        """Whether it has failed: it is about to stop or to start again, or has stopped for good."""
        return self.life in {"failed", "restarting"} or self.__request in {"restart", "fail"}

    @own
    def runtime(self) -> Runtime:
        """The runtime in which it lives.

        Raises:
            Error: If it has not been started.
        """
        if self.__runtime is None:
            raise Error(f"actor {self.path!r} has not been started")
        return self.__runtime

    def add(self, child: Actor, *, first: bool = False) -> None:
        """Make another actor a child: started after those added before, or ahead of them; stopped in reverse."""
        _demand_actor(child)
        for name in vars(child).keys() & vars(Actor).keys():
            if name not in _OVERRIDABLE:
                raise Error(_hidden(type(child), name))
        if not child.name:
            raise Error(f"a child of actor {self.path!r} needs a name that is not empty")
        if child.parent is not None:
            raise Error(f"actor {child.name!r} is already a child of {child.parent.path!r}")
        known_as = (child.name, child.__place)
        if known_as in self.__names:
            raise TakenName(self.path, child.name)
        child.__parent = self
        self.__names.add(known_as)
        self.__children.insert(0 if first else len(self.__children), child)

    def share(self, actor: Actor) -> None:
        """Share an actor that nobody has started: it lives in the runtime, from before this one's children to its end.

        Several may use one: it lives as long as one of them does, and its failure is theirs. Call this in `on_start`.
        """
        self.__shared.append(actor)
        actor.__place = self.runtime.sharing.reserve(actor, self)  # so that its path is known from now on

    async def start_child(self, child: Actor, *, first: bool = False, at: str = "") -> None:
        """Add a child to an actor that already runs, and wait until it has started.

        Args:
            child: The actor to add.
            first: Ahead of the others: it stops after them.
            at: The path that its own begins with, in place of its parent's.
        """
        _demand_actor(child)
        child.__place = at
        self.add(child, first=first)
        try:
            await self.__start(child)
        except BaseException:
            # Whoever waited for the start may have been cancelled: what has started by then ends in good order.
            await self.stop_child(child)
            raise

    async def stop_child(self, child: Actor) -> None:
        """Stop a child, wait for its end, and forget it."""
        _demand_actor(child)
        life = child.__ended
        await child.__stop()
        if child.parent is self and child.__ended is life:  # else another has stopped it, too, and started it again
            self.__children.remove(child)
            self.__names.discard((child.name, child.__place))
            child.__parent = None
            child.__place = ""

    @own
    def subscriptions(self) -> tuple[Subscription[Any], ...]:
        """Its subscriptions, in the order of their making."""
        return tuple(self.__subscriptions)

    # -- Services ------------------------------------------------------------------------------------------------

    def channel(self, name: str, type: type[T], *, retain: bool = False) -> Channel[T]:  # noqa: A002
        """Return the channel ``<path>/<name>``, made at the first call."""
        channel = self.__channels.get(name) if name.__class__ is str else None
        if channel is None or channel.type is not type:
            path = self.path
            channel = self.runtime.channel(f"{path}/{name}" if path else name, type, retain=retain)
            self.__channels[name] = channel
            channel.claim()
        return channel

    def subscribe(
        self, channel: Channel[T], handler: Callable[[T], object], *, topics: Iterable[str] | None = None
    ) -> Subscription[T]:
        """Handle each message of a channel, or those on some topics alone, until this actor stops."""
        subscription = channel.subscribe(handler, self, topics=topics)
        self.__subscriptions.append(subscription)
        return subscription

    def call_later(self, seconds: float, function: Callable[[], object]) -> Alarm:
        """Call a function in a turn of its own, after so many seconds."""
        return self.call_at(self.runtime.dispatcher.counts_from(self.path) + round(seconds * 1e9), function)

    def call_at(self, when: int, function: Callable[[], object]) -> Alarm:
        """Call a function in a turn of its own, when the clock shows ``when`` nanoseconds: that is the turn's time."""
        check_plain(function, "what a timer calls")
        turn: Subscription[None] = Subscription(None, self, lambda _: function())
        timer = Alarm(self.runtime.dispatcher, turn)
        timer.set(when)
        self.__timers.add(timer)
        return timer

    def every(
        self, rate: float, handler: Callable[[Tick], object], *, overrun: Literal["skip", "burst"] = "skip"
    ) -> Ticker:
        """Call a handler ``rate`` times a second, at aligned times, each in a turn of its own."""
        check_plain(handler, "the handler of ticks")
        turn = Subscription(None, self, handler)
        runtime = self.runtime

        def deliver(tick: Tick) -> None:
            dispatcher = runtime.dispatcher
            if dispatcher.observed:
                dispatcher.observers.stimulus(Ticked(tick.time, self.path, tick.number, tick.missed, rate))
            dispatcher.deliver_due(turn, tick, tick.time)

        ticker = Ticker(runtime.clock, rate, deliver, overrun=overrun, since=runtime.now())
        self.__timers.add(ticker)
        runtime.dispatcher.choices.rates(self.path, rate, ticker)
        return ticker

    def spawn(
        self,
        awaitable: Awaitable[Any],
        ended: Callable[[Work], object] | None = None,
        *,
        name: str = "",
        jobs: Jobs | None = None,
    ) -> Work:
        """Run a coroutine as a task of this actor.

        Args:
            awaitable: The coroutine or future to run.
            ended: Called in a turn when it has ended, however it did. Without it, an error of the awaitable is this
                actor's failure; so is its cancellation, unless the actor asked for it.
            name: For debuggers and reports.
            jobs: The jobs that were handed to executors where the awaitable was made; they have to end, too.

        Raises:
            Error: If the actor does not live (work that takes time at its end belongs in `on_stopping`), the argument
                cannot be awaited, or ``ended`` is no plain function.
        """
        return self.__work.begin(awaitable, ended, name, jobs)

    def abandon(self, work: Work) -> None:
        """Own a piece of work no longer: it did not end when it was asked to."""
        self.__work.abandon(work)

    def report(self, kind: str, detail: str, *, time: int | None = None) -> None:
        """Publish a `Fault` of this actor."""
        stamp = self.runtime.now() if time is None else time
        self.runtime.faults.publish(Fault(stamp, self.path, kind, detail))

    # -- Failure -------------------------------------------------------------------------------------------------

    def fail(self, error: BaseException) -> None:
        """Fail with an error, and act by the actor's supervision.

        `SystemExit` and `KeyboardInterrupt` are no matter of supervision: they end the runtime, in order.
        """
        if isinstance(error, LEAVING) and self.__runtime is not None:
            self.__runtime.abort(error)
            return
        dispatcher = None if self.__runtime is None else self.__runtime.dispatcher
        if dispatcher is not None and dispatcher.time < 0:
            dispatcher.deliver(Subscription(None, None, lambda _: self.fail(error)), None)  # which has one time
            return
        if self.life in {"created", "stopped", "failed"} or self.__request in {"restart", "fail"}:
            if self.__runtime is not None:
                self.report("exception", describe(error))
            return
        if dispatcher is not None:
            dispatcher.observers.tell(Failed, dispatcher.now(), self.path, describe(error))
        self.__failures += 1
        if self.path or not getattr(error, "escalated", False):  # the root and a system have no name of their own
            self.report("exception", describe(error))
        if self.life == "stopping":
            return
        self.__act_on(error)
        try:
            self.on_failing(error)
        except BaseException as another:
            self.__trouble(another)

    def __act_on(self, error: BaseException) -> None:
        """Act by the actor's supervision on an error."""
        delay = self.__budget.delay(self.runtime.now()) if self.__budget is not None else None
        if delay is not None:
            self.__backoff = delay
            if self.life != "restarting":  # else it waits to start again already
                self.__ask("restart")
        elif self.supervision == "stop":
            self.__ask("fail")
        else:
            self.__escalate(error)

    def __escalate(self, error: BaseException) -> None:
        # It handles nothing more, but is stopped only in its turn, by those above.
        self.__request = "fail"
        self.__release()
        if self.parent is None:
            self.runtime.abort(error)
            return
        if isinstance(error, ActorFailure) and error.escalated:
            failure = error  # however far up it goes, it says who has failed first, and why
        else:
            failure = ActorFailure(f"actor {self.path!r} failed: {text_of(error)}")
            failure.__cause__ = error
            failure.escalated = True
        users = self.runtime.sharing.users(self)
        if users and self.__requested is not None:
            self.__requested.set()  # nobody above it stops it before its users have
        for above in users or (self.parent,):
            above.fail(failure)

    def __ask(self, request: Request) -> None:
        if self.__request == "none":
            self.__request = request
        self.__release()
        if self.__requested is not None:
            self.__requested.set()

    # -- Life ----------------------------------------------------------------------------------------------------

    async def __start(self, child: Actor) -> None:
        if self.__group is None:
            who = f"actor {self.path!r}" if self.path else "the runtime"
            remedy = "" if self.path else ": start it inside `async with Runtime() as runtime`"
            raise Error(f"{who} does not run, so it cannot start {child.name!r}{remedy}")
        await child.live_in(self.__group, self.runtime)

    async def live_in(self, group: TaskGroup, runtime: Runtime) -> None:
        """Live as a task of a group, and wait until it runs; the runtime and parents call this."""
        self.__ended = anyio.Event()
        self.__request = "none"
        start = Start(self.__trouble)
        group.start_soon(self.__run, runtime, start)
        await start.wait()

    async def __stop(self) -> None:
        if self.__ended is None:
            return
        self.end()
        with anyio.CancelScope(shield=True):
            await self.__ended.wait()

    def end(self) -> None:
        """Ask this actor to stop, its children before it; returns at once."""
        if self.__request != "fail":
            self.__request = "stop"
        if self.__requested is not None:
            self.__requested.set()

    async def __run(self, runtime: Runtime, start: Start) -> None:
        self.__runtime = runtime
        hide(asyncio.current_task())
        started = False
        error: BaseException | None = None
        try:
            while True:
                self.__requested = anyio.Event()
                if not self.__asked("none"):
                    self.__requested.set()
                error = await self.__live(None if started else start)
                started = True
                if error is not None or not await self.__restarting():
                    break
        finally:
            self.__change("failed" if self.__asked("fail") or error is not None else "stopped")
            runtime.desert(self.__channels.values())
            self.__channels.clear()
            start.failed(error)
            if self.__ended is not None:
                self.__ended.set()

    def __asked(self, request: Request) -> bool:
        return self.__request == request

    async def __restarting(self) -> bool:
        """Return whether to live once more, after the back-off that supervision asks for."""
        if not self.__asked("restart"):
            return False
        self.__restarts += 1
        self.__request = "none"
        self.__requested = anyio.Event()
        self.__change("restarting")
        with anyio.move_on_after(self.__backoff):
            await self.__requested.wait()
        if self.__ends_with_others():
            await self.__requested.wait()
        return not (self.__asked("stop") or self.__asked("fail"))

    def __ends_with_others(self) -> bool:
        """Whether an actor above it has failed or is to end, and this one with it."""
        above = self.parent
        while above is not None:
            if not above.__asked("none"):  # noqa: SLF001 - the tree is actors' own affair
                return True
            above = above.parent
        return False

    async def __live(self, start: Start | None) -> BaseException | None:
        """Live once, from start to stop; return the error of a first start."""
        failed: BaseException | None = None
        async with anyio.create_task_group() as group:
            self.__group = group
            self.__work.open = True
            self.__change("starting")
            permanent = dict.fromkeys(self.children)
            try:
                try:
                    await self.__begin()
                    await self.__start_others()
                except (Exception, *LEAVING) as error:
                    failed = error
                if failed is None:
                    if not self.__asked("stop"):  # else some of its children may not have been started
                        self.__change("running")
                        await self.come_to("run", self.__run_on)
                    if start is not None:
                        start.done()
                    if self.__requested is not None:
                        await self.__requested.wait()
                elif start is None:
                    self.__life = "running"
                    self.fail(failed)
                    failed = None
                await self.__end()
            finally:
                try:
                    await self.__let_go()
                finally:
                    await self.__give_back()
            # A further start adds again what on_start adds.
            for child in self.children:
                if child not in permanent:
                    child.__parent = None  # noqa: SLF001 - the tree is actors' own affair
            self.__children[:] = (child for child in permanent if child.parent is self)
            self.__names = {(child.name, child.__place) for child in self.__children}  # noqa: SLF001
        return failed

    async def __begin(self) -> None:
        # A turn of its own, so that what on_start publishes is delivered in order before anything else happens.
        done = anyio.Event()
        errors: list[BaseException] = []

        def begin(_: None) -> None:
            try:
                self.on_start()
            except BaseException as error:
                errors.append(failure(error))
            done.set()

        await self.come_to("start", begin)
        if not done.is_set():  # a turn that was cut short comes first
            await done.wait()
        if errors:
            raise errors[0]

    async def come_to(self, step: Literal["start", "run", "stop", "end"], handler: Callable[[None], None]) -> None:
        """Come to a step of its life, in a turn of its own; where a run is repeated, at its time."""
        dispatcher = self.runtime.dispatcher
        await dispatcher.choices.comes(self.path, step)

        def handle(_: None) -> None:
            dispatcher.observers.tell(Began, dispatcher.time, self.path, step)
            handler(None)

        dispatcher.deliver(Subscription(None, self, handle), None)

    async def __start_others(self) -> None:
        for actor in self.__shared:
            await self.runtime.sharing.lend(actor)
        for child in tuple(self.children):
            if not self.__asked("stop"):
                await self.__start(child)

    def __run_on(self, _: None) -> None:
        if self.__asked("none"):
            self.on_running()

    async def __end(self) -> None:
        self.__group = None  # children that are started from now on would outlive this actor's end
        if self.__request != "restart":
            self.__change("stopping")
        try:
            await self.__watched(self.on_stopping())
        except BaseException as error:
            if was_cancelled(error):
                raise
            self.__trouble(error)
        for child in reversed(self.children):
            await child.__stop()  # noqa: SLF001 - the tree is actors' own affair

    async def __watched(self, stopping: Coroutine[Any, Any, None]) -> None:
        """Await `on_stopping`, and report that it has not ended a second after it should have."""
        limit = self.patience + _LATE

        def tell() -> None:
            frame = getattr(stopping, "cr_frame", None)
            place = "" if frame is None else f": it waits at {frame.f_code.co_filename}:{frame.f_lineno}"
            self.report("stopping", f"`on_stopping` has not ended within {limit:g} s{place}")

        clock = self.runtime.clock
        timer = clock.call_at(clock.now() + round(limit * 1e9), tell)
        try:
            await stopping
        finally:
            timer.cancel()

    async def __let_go(self) -> None:
        """Let go of everything; when cancelled, at once."""
        self.__group = None
        try:
            # In a turn, which a record has: input from before it is handled, and that from behind it is not.
            await self.come_to("end", lambda _: self.__release())
            await self.__work.end(self.grace)
        finally:
            self.__work.open = False
            self.__release()  # what ending work has subscribed to or set
            try:
                self.on_stop()
            except BaseException as error:
                self.__trouble(error)

    async def __give_back(self) -> None:
        shared, self.__shared = self.__shared, []
        for actor in shared:
            await self.runtime.sharing.give_back(actor, self)

    def __trouble(self, error: BaseException) -> None:
        """Report an error that changes nothing, as at an end, or where nobody waits for a start any more."""
        self.report("exception", describe(error))
        if isinstance(error, LEAVING):
            self.runtime.abort(error)

    def __release(self) -> None:
        for subscription in self.__subscriptions:
            subscription.cancel()
            self.__received += subscription.received
        self.__subscriptions.clear()
        for timer in self.__timers:
            timer.cancel()
            if isinstance(timer, Ticker):
                self.__skipped += timer.missed
        self.__timers.clear()

    def __change(self, life: Literal["starting", "running", "restarting", "stopping", "stopped", "failed"]) -> None:
        self.__life = life
        if self.__runtime is not None:
            self.__runtime.lives.publish(StateChange(self.__runtime.now(), self.path, life))

    def statistics(self) -> ActorStatistics:
        """Return the actor's statistics so far."""
        return ActorStatistics(
            path=self.path,
            state=self.life,
            received=self.__received + sum(subscription.received for subscription in self.__subscriptions),
            failures=self.__failures,
            restarts=self.__restarts,
            work=len(self.__work),
            skipped_ticks=self.__skipped + sum(timer.missed for timer in self.__timers if isinstance(timer, Ticker)),
        )


def descendants(root: Actor) -> list[Actor]:
    """Return an actor and all below it, each behind its parent."""
    found = [root]
    for actor in found:
        found += actor.children
    return found


def _demand_actor(child: object) -> None:
    """Raise an error if this is no actor."""
    if not isinstance(child, Actor):
        kind = f"the class {child.__name__}" if isinstance(child, type) else f"an object of type {type(child).__name__}"
        raise Error(f"an actor was expected, such as an ensemble or a system, not {kind}")


def _hidden(kind: type[Actor], name: str) -> str:
    return f"{kind.__qualname__}.{name} would hide the attribute that every actor has under that name: choose another"
