"""Observing a run: who hears its events, and who answers its questions to the world.

Both are objects that are always there. The `Observers` of a runtime call those who listen, each guarded: nothing that
an observer does reaches a turn. Its `Choices` are the world's, unless a replay answers in its place.
"""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from threading import get_ident
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakMethod, WeakValueDictionary

from mdm.messages import Fault
from mdm.runtime.supervision import LEAVING, describe
from mdm.stimuli import Behind, Cut, Delays, Ended, Lasts, Said, count_messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.messages import ActionLife, Decision, Idle, Mode, StateChange
    from mdm.runtime.channel import Channel, Subscription
    from mdm.runtime.runtime import Runtime
    from mdm.runtime.time.scheduler import Ticker
    from mdm.runtime.work import Work
    from mdm.stimuli import Stimulus, Where


class Observer:
    """Hears the events of a runtime: subclass it, override some methods, and hand it to `Runtime.observe`.

    Each method is called on the event loop, within the turn in which something happens, and must be quick. One that
    raises changes nothing: the runtime counts it, and makes one fault ``observer`` of the first. A method
    that is not overridden costs nothing.

    Attributes:
        name: The observer in faults, such as ``the record``; empty for that of its class.
    """

    name: str = ""

    def on_stimulus(self, stimulus: Stimulus) -> None:
        """Hear the beginning of a turn, or an event in it that does not follow from that (`mdm.stimuli`)."""

    def on_decision(self, decision: Decision) -> None:
        """Hear a decision."""

    def on_life(self, life: ActionLife) -> None:
        """Hear that an action has begun or ended; of plain functions that succeed, `on_call` hears alone."""

    def on_call(self, ensemble: str, life: int, action: str, time: int) -> None:
        """Hear that a plain function was called and has succeeded: the whole life of an action."""

    def on_mode(self, mode: Mode) -> None:
        """Hear that an ensemble has changed its mode."""

    def on_fault(self, fault: Fault) -> None:
        """Hear a fault."""

    def on_change(self, change: StateChange) -> None:
        """Hear that an actor has come to another state of its life."""

    def on_idle(self, idle: Idle) -> None:
        """Hear that an ensemble has become idle, or is no longer."""

    def on_end(self) -> None:
        """Hear that nothing more comes: the runtime has ended."""

    # -- As it is heard, before a message is made of it -----------------------------------------------------------

    def on_message(self, channel: Channel[Any], message: Any, time: int) -> None:
        """Hear a message on a channel of input, in place of the stimulus `Said`."""

    def on_step(
        self,
        output: Deciding,
        time: int,
        epoch: int,
        cause: str,
        state: int | None,
        observation: Any,
        current: Any,
        action: int,
        reward: float | None,
    ) -> None:
        """Hear a decision, on a state or on an information state (``current``) that may be a belief."""

    def on_control(self, output: Deciding) -> None:
        """Hear that an ensemble's control layer has started."""


class Choices:
    """Answers a run's questions to the world, as that does; a replay answers as its record does.

    Attributes:
        repeats: Whether the run is repeated: its record stands for users' code and for other processes.
    """

    repeats = False

    async def comes(self, actor: str, step: str) -> None:
        """Let an actor come to a step of its life: ``start``, ``run``, ``stop`` or ``end``."""

    def kept(
        self, actor: str, values: dict[str, bool | None], times: dict[str, int], time: int
    ) -> tuple[dict[str, bool | None], dict[str, int]]:
        """Return the values that sensors told before a predicate manager starts, and when, in nanoseconds."""
        return values, times

    def counts_from(self, actor: str, time: int, begin: int) -> int:
        """Return when a delay begins that an actor asks for in the turn of a time."""
        return begin

    def rates(self, actor: str, rate: float, ticker: Ticker) -> None:
        """Let an actor tick, so many times a second."""

    def acts(self, ensemble: str, layer: Acting) -> None:
        """Let an action layer call the functions of its actions."""

    def lasts(self, ensemble: str, life: int, work: Work) -> None:
        """Let the awaitable end that an action's function has returned, and that runs as work."""

    def goes_on(self, ensemble: str, epoch: int, time: int, ask: Callable[[], bool]) -> bool:
        """Return whether a running action that is chosen again goes on."""
        return ask()

    def over(self, ensemble: str, epoch: int, time: int, life: int, over: bool) -> bool:
        """Return whether the task of a life that a decision meets is over, and its end on the way."""
        return over

    def controls(self, output: Deciding) -> None:
        """Let an ensemble's policy draw its actions."""

    def latency(self, ensemble: str, epoch: int, time: int, latency: int) -> int:
        """Return how late a decision with a deadline is, in nanoseconds."""
        return latency


class Guard:
    """Calls an observer so that nothing it raises reaches a turn: counts it, and makes one fault ``observer`` of it.

    What ends a program, `KeyboardInterrupt` and `SystemExit`, passes.

    Args:
        runtime: The runtime that is observed.
        name: The observer in that fault, such as ``the page``.
        observer: Its object.

    Attributes:
        lost: How often it has failed.
        error: The first error; None where there was none.
    """

    def __init__(self, runtime: Runtime, name: str, observer: Observer | None = None) -> None:
        self.lost = 0
        self.error: BaseException | None = None
        self.observer = observer
        self.subscriptions: list[Subscription[Any]] = []
        self._runtime = runtime
        self._name = name
        self._told = False

    def __call__(self, hear: Callable[..., object]) -> Callable[..., Any]:
        """Return a function of the observer as one that never raises; its arguments have no names."""

        def guarded(*arguments: Any) -> Any:
            try:
                return hear(*arguments)  # which costs less than to return nothing
            except LEAVING:
                raise
            except BaseException as error:
                self.lost += 1  # before any call, for which there may be no room
                if self.error is None:
                    self.error = error
                try:  # noqa: SIM105 - which is a call
                    self.tell(error)
                except Exception:  # noqa: S110 - the next failure is told
                    pass

        return guarded

    def lose(self, why: BaseException | str) -> None:
        """Count a failure, and tell the first one."""
        self.lost += 1
        self.tell(why)

    def tell(self, why: BaseException | str) -> None:
        """Make a fault of the first failure, behind the turn in which it came; from any thread."""
        if self._told:
            return
        dispatcher, self._told = self._runtime.dispatcher, True
        try:
            within = (dispatcher.active or dispatcher.time >= 0) and get_ident() == dispatcher.thread
            if within and dispatcher.loop is not None:
                dispatcher.loop.call_soon(self._publish, why)
            else:
                self._publish(why)
        except BaseException:
            self._told = False
            raise

    def _publish(self, why: BaseException | str) -> None:
        runtime, text = self._runtime, why if isinstance(why, str) else describe(why)
        detail = f"{self._name} has failed: {text}; what it lacks by that is counted, and the run goes on"
        runtime.faults.publish(Fault(runtime.now(), "runtime", "observer", detail))

    def cancel(self) -> None:
        """Let the observer hear nothing more."""
        self._runtime.observers.remove(self)

    def end(self) -> None:
        """Tell the observer that nothing more comes."""
        if self.observer is not None:
            self(self.observer.on_end)()


_CHANNELS = {
    "on_mode": "modes",
    "on_fault": "faults",
    "on_change": "lives",
    "on_idle": "idles",
    "on_decision": "decisions",
}
"""The channel of the runtime that each of these methods subscribes to."""


class Observers:
    """All who observe a runtime, as one.

    Args:
        runtime: The runtime; None for a dispatcher of its own, which nobody observes.

    Attributes:
        heard: Whether anybody hears stimuli, so that one need not be made for nobody.
        hears_lives: Whether anybody hears lives of actions.
        hears_calls: The same, of plain functions that succeed.
        hears_steps: Whether anybody hears decisions before a message is made of them.
        message: Hands on a message on a channel of input; the next ones are named as the methods of `Observer`.
        tasks: The ensemble and the life of each task of an action.
    """

    __slots__ = (
        "_delays",
        "_guards",
        "_layers",
        "_looks",
        "_runtime",
        "call",
        "control",
        "heard",
        "hears_calls",
        "hears_lives",
        "hears_steps",
        "life",
        "message",
        "step",
        "stimulus",
        "tasks",
    )

    def __init__(self, runtime: Runtime | None = None) -> None:
        self._runtime = runtime
        self._guards: tuple[Guard, ...] = ()
        self._delays = Delays()
        self._layers: WeakValueDictionary[str, Acting] = WeakValueDictionary()
        self._looks: set[WeakMethod[Callable[[], None]]] = set()
        self.tasks: dict[asyncio.Task[Any] | None, tuple[str, int]] = {}
        self._connect()

    # -- Who observes --------------------------------------------------------------------------------------------------

    def add(self, observer: Observer) -> Guard:
        """Let an observer hear all that follows; return its guard, the same at each call."""
        for known in self._guards:
            if known.observer is observer:
                return known
        assert self._runtime is not None
        guard = Guard(self._runtime, name_of(observer), observer)
        for method, channel in _CHANNELS.items():
            if _overrides(observer, method):
                heard: Channel[Any] = getattr(self._runtime, channel)
                guard.subscriptions.append(heard.subscribe(guard(getattr(observer, method))))
        self._guards = (*self._guards, guard)
        self._connect()
        return guard

    def remove(self, guard: Guard) -> None:
        """Let an observer hear nothing more."""
        self._guards = tuple([each for each in self._guards if each is not guard])
        for subscription in guard.subscriptions:
            subscription.cancel()
        guard.subscriptions.clear()
        self._connect()

    def end(self) -> None:
        """Tell all that nothing more comes, whoever came last first."""
        with ExitStack() as stack:
            for guard in self._guards:
                stack.callback(self.remove, guard)
                stack.callback(guard.end)

    def watch(self, look: Callable[[], None]) -> None:
        """Call a method now, and when others observe, for as long as its object is there."""
        self._looks.add(WeakMethod(look, self._looks.discard))
        look()

    def _connect(self) -> None:
        """Connect each event with those who hear it."""
        stimuli, self.stimulus = self._all("on_stimulus")
        messages, self.message = self._all("on_message")
        self.hears_lives, self.life = self._all("on_life")
        self.hears_calls, self.call = self._all("on_call")
        self.hears_steps, self.step = self._all("on_step")
        _, self.control = self._all("on_control")
        self.heard = stimuli or messages
        for reference in tuple(self._looks):
            if (look := reference()) is not None:
                look()

    def _all(self, method: str) -> tuple[bool, Callable[..., None]]:
        """Return whether anybody hears one kind of thing, and a function that tells all who do."""
        hear: list[Callable[..., None]] = []
        for guard in self._guards:
            observer = guard.observer
            if _overrides(observer, method):
                hear.append(guard(getattr(observer, method)))
            elif method == "on_message" and _overrides(observer, "on_stimulus"):
                hear.append(guard(self._as_stimulus(observer)))
        if len(hear) == 1:
            return True, hear[0]

        def tell(*arguments: Any) -> None:
            for each in hear:
                each(*arguments)

        return bool(hear), tell

    def _as_stimulus(self, observer: Any) -> Callable[[Channel[Any], Any, int], None]:
        def take(channel: Channel[Any], message: Any, time: int) -> None:
            where, ensemble, life, after = self.source()
            said = Said(time, channel.name, type(message).__name__, message, where, ensemble, life, after)
            observer.on_stimulus(said)

        return take

    # -- What happens --------------------------------------------------------------------------------------------------

    def tell(self, kind: Callable[..., Stimulus], *fields: Any) -> None:
        """Hand on a stimulus, which is made of its fields where anybody hears it."""
        if self.heard:
            self.stimulus(kind(*fields))

    def acts(self, ensemble: str, layer: Acting) -> None:
        """Know an action layer that starts."""
        self._layers[ensemble] = layer

    def lasts(self, ensemble: str, life: int, work: Work, time: int) -> None:
        """Tell that the function of a life has returned an awaitable, which runs as work."""
        if self.heard:
            self.tasks[work.task] = (ensemble, life)
            self.stimulus(Lasts(time, ensemble, life))

    def ended(self, ensemble: str, life: int, work: Work, time: int) -> None:
        """Tell that the work of a life has ended, and how."""
        self.tasks.pop(work.task, None)
        if self.heard:
            how = work.interrupted, work.cancelled, work.failure, work.abandoned
            self.stimulus(Ended(time, ensemble, life, *how))

    def delayed(self, actor: str, time: int, begin: int) -> None:
        """Tell when a delay begins that an actor asks for, where that is not the time of its turn."""
        if self.heard:
            number = self._delays.count(actor, time)
            if begin != time:
                self.stimulus(Behind(time, actor, number, begin))

    def cut(self, time: int) -> None:
        """Tell that the turn of a time was cut short, and where."""
        if self.heard:
            self.stimulus(Cut(time, self.place()))

    def place(self) -> int:
        """Return how many messages were published that lead to decisions: how far the run has come."""
        return 0 if self._runtime is None else count_messages(self._runtime.channels)

    def source(self) -> tuple[Where, str, int, int]:
        """Return whose code publishes a message of input now; see `Said`."""
        assert self._runtime is not None
        dispatcher = self._runtime.dispatcher
        if dispatcher.active and dispatcher.time >= 0:
            for ensemble, layer in self._layers.items():
                if life := layer.calls:
                    return "call", ensemble, life, 0
            return "turn", "", 0, self.place()
        if self.tasks and (found := self.tasks.get(asyncio.current_task())) is not None:
            return "task", found[0], found[1], 0
        return "outside", "", 0, 0


def name_of(observer: Observer) -> str:
    """Return the name of an observer in faults."""
    return observer.name or type(observer).__name__


def _overrides(observer: object, method: str) -> bool:
    """Whether an observer has a method of its own in place of the one that does nothing."""
    own = getattr(observer, method)
    return getattr(own, "__func__", own) is not getattr(Observer, method)


class Acting(Protocol):
    """An action layer, for those who observe or answer."""

    @property
    def calls(self) -> int:
        """The number of the life whose function is being called; 0 where none is."""


class Deciding(Protocol):
    """Where an ensemble's decisions are published, for those who observe or answer."""

    @property
    def ensemble(self) -> str:
        """The ensemble's path."""

    def facts(self) -> dict[str, Any]:
        """Return what decides, as plain data: digests, seed, names."""

    @property
    def draws(self) -> str:
        """The state of the random numbers by which its policy draws actions; empty where it does not."""

    def draw_from(self, draws: str) -> None:
        """Let the policy draw on from that state."""

    def name_of(self, action: int) -> str:
        """Return the name of an action."""

    @property
    def avoids(self) -> str:
        """A formula of all that its policy's shield keeps it out of; empty where it has none."""

    def wanted(self, cause: str, current: Any) -> tuple[int | None, str | None]:
        """Return the action in whose place its shield has taken another one on an information state, and its name."""

    def words(self, state: int | None, observation: Any) -> dict[str, object]:
        """Return the names of the state and the observation that it decides on, by these words."""

    def belief_of(self, current: Any) -> Any:
        """Return an information state as a belief, of S numbers; None where it is none."""
