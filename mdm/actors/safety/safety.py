"""Safety: carries out the orders of an ensemble's modes, and reports them.

It receives the layers' reports, asks the state machine of `mdm.actors.safety.modes`, and obeys: the latch, the safe
action, the way back. All of it happens in the very call that notices a cause.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.actors.safety.liveness import Waiting
from mdm.actors.safety.modes import Modes, Order, Stage, Try
from mdm.errors import ConfigError
from mdm.messages import Cause, Fault, Mode, PredicateUpdate
from mdm.runtime.channel import Subscription

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mdm.actors.ensemble import Ensemble
    from mdm.actors.options import SafetySettings
    from mdm.actors.predicates.predicate_manager import PredicateManager

_FAILED = "on_failed_action"
_REACTIONS = (_FAILED, "on_lost_input", "on_unknown")
_OPTIONS = {"stale_input": "on_lost_input", "unknown_input": "on_unknown"}


class Safety:
    """The modes of one ensemble, carried out on its layers.

    Args:
        ensemble: The ensemble.
        settings: The ensemble's options.

    Attributes:
        modes: The state machine.
        waiting: Reports the input that an ensemble which cannot decide waits for.
        runs: How often the safe action was begun, or begun again.
        last_word: Carries out the end.
    """

    def __init__(self, ensemble: Ensemble, settings: SafetySettings) -> None:
        self.modes = Modes()
        self.waiting = Waiting(ensemble)
        self.runs = 0
        self._ensemble = ensemble
        self._control = ensemble.control
        self._reactions = {name: self._reaction(name, getattr(settings, name)) for name in _REACTIONS}
        self.on_lost_teammate = settings.on_lost_teammate
        if self.on_lost_teammate == "safe_action" and not self.has_safe_action:
            raise ConfigError("on_lost_teammate asks for the safe action, but there is none", key="safe_action")
        self._keep = settings.after_safe == "keep"
        self._done = self._index_of_safe_action()
        self._told: tuple[str, tuple[Cause, ...]] = ("stopped", ())
        self._stale = False
        self._base = 0
        self._lost: set[str] = set()
        self.last_word = LastWord(self, ensemble)

    @property
    def has_safe_action(self) -> bool:
        """Whether there is a safe action, and this agent carries out its part."""
        action = self._ensemble.action
        return action.safe is not None and not action.idle

    def _reaction(self, name: str, given: object) -> bool:
        """Whether a cause makes the ensemble safe."""
        if given == "safe" and not self.has_safe_action:
            raise ConfigError(f"{name} asks for the safe action, but there is none", key="safe_action")
        return self.has_safe_action and given in {None, "safe"}

    def _index_of_safe_action(self) -> int | None:
        """The model's index of the safe action, where it is one of the model's and the agent is alone."""
        action = self._ensemble.action
        if action.safe is None or action.joint or action.safe not in action.bindings:
            return None
        return action.bindings.index(action.safe)

    # -- Life ----------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Begin a life of the ensemble: stopped; it keeps only the causes that a restart does not mend."""
        ensemble = self._ensemble
        now = ensemble.runtime.now()
        self.modes.open(now)
        self.last_word.open()
        self._lost.clear()
        self._channel = ensemble.channel("mode", Mode, retain=True)
        self._control.guard = self
        if ensemble.predicates is not None:
            self._watch(ensemble.predicates)
        if self._told[0] != "stopped":
            self._tell(now)

    def close(self) -> None:
        """End a life of the ensemble: nothing of it is left that could be made safe."""
        self.modes.close()
        self._ensemble.liveness.end()
        self.last_word.tell()

    def _watch(self, manager: PredicateManager) -> None:
        """Notice sensors that become too old, and those of observations that turn unknown: no state shows these."""
        ensemble = self._ensemble
        observed = ensemble.observation.inputs() if ensemble.observation else frozenset()
        used = observed | (ensemble.state.inputs() if ensemble.state else frozenset())
        declared = manager.declared
        others = frozenset(filter(declared.senses, observed))
        watched = {
            "stale_input": (used & declared.aged, "input is too old"),
            "unknown_input": (others - declared.aged, "input turned unknown"),
        }

        topics = frozenset[str]().union(*(sensors for sensors, _ in watched.values()))

        def look(update: PredicateUpdate) -> None:
            self._lost |= topics.intersection(update.unknown)
            self._lost.difference_update(update.rising, update.falling)
            for kind, (sensors, words) in watched.items():
                if lost := sensors.intersection(update.unknown):
                    self._lose(kind, f"{words}: {', '.join(sorted(lost))}", update.time, told=True)
                elif sensors and self._lost.isdisjoint(sensors):
                    self.reopen(frozenset({kind}), update.time)

        if topics:
            updates = ensemble.runtime.channel(f"{manager.path}/updates", PredicateUpdate)
            ensemble.subscribe(updates, look, topics=topics)

    # -- Commands ------------------------------------------------------------------------------------------------

    @property
    def deciding(self) -> bool:
        """Whether the control layer may decide."""
        return self.modes.deciding

    @property
    def returning(self) -> bool:
        """Whether the ensemble is safe, and decides again when that is over."""
        return self.modes.mode == "safe" and not self.modes.leaving

    def start(self, time: int) -> None:
        """Decide, unless an ensemble above is safe or ends this one: until that is over, nothing below it decides."""
        ensemble = self._ensemble
        if ensemble.interrupted:
            text = "was not started: the action that it is bound to is coming to its end"
            ensemble.report("control", text, time=time)
            return
        above = ensemble.safe_above()
        if above is not None:
            if not ensemble.awaited:
                text = f"was not started: ensemble {above.path!r} above it is safe or ends"
                ensemble.report("control", text, time=time)
            if self.modes.mode == "stopped":  # else its idle callbacks are called when its safe mode is over
                ensemble.action.when_idle(ensemble.became_idle)
        elif not ensemble.runtime.ending:
            self.obey(self.modes.start(time), time)
            if ensemble.runtime.starved:
                self.endanger("starved", ensemble.runtime.starved, time)

    def stop(self, time: int) -> None:
        """Decide no more; an ensemble that is ending already is made safe all the same."""
        self.obey(self.modes.stop(time), time)

    def release(self, time: int) -> None:
        """Take a person's word that nothing holds any more."""
        self.obey(self.modes.release(time), time)

    def wait(self, kind: str, detail: str, time: int) -> None:
        """Be safe, though it was not started, where there is a safe action: whoever starts it waits for something."""
        if self.has_safe_action and self.modes.mode == "stopped":
            self.modes.causes[kind] = Cause(kind, detail, time)
            self.obey(self.modes.start(time), time)

    def recall(self, causes: Iterable[Cause], time: int) -> None:
        """Restore causes that have outlasted an earlier process: they hold until a release."""
        self.modes.causes |= {cause.kind: cause for cause in causes}
        self._tell(time)

    # -- Reports of the layers ----------------------------------------------------------------------------------

    def alarm(self, fault: Fault) -> bool:
        """Report a fault; where there is a safe action, go safe at once.

        Returns:
            Whether the ensemble is safe, so that nothing that was or is decided may start.
        """
        self._ensemble.runtime.faults.publish(fault)
        if self.has_safe_action:
            self.obey(self.modes.endanger(fault.kind, fault.detail, fault.time), fault.time)
        else:
            self._ensemble.liveness.look()
        return self.modes.mode == "safe"

    def endanger(self, kind: str, detail: str, time: int, *, at_rest: bool = False) -> None:
        """Take a cause that others report; where there is a safe action, go safe at once.

        Args:
            kind: The cause.
            detail: In words.
            time: When.
            at_rest: See `Modes.endanger`.
        """
        if self.has_safe_action:
            self.obey(self.modes.endanger(kind, detail, time, at_rest=at_rest), time)

    def reopen(self, kinds: frozenset[str], time: int) -> None:
        """Take causes as gone."""
        if self.modes.causes:
            self.obey(self.modes.gone(kinds, time), time)

    def blind(self, time: int) -> None:
        """Note that no state is known: a cause where the ensemble has acted, else it waits."""
        unknown, manager = frozenset(self.waiting.unknown()), self._ensemble.predicates
        names = ", ".join(sorted(unknown)) or "nobody tells it"
        if unknown and manager is not None and unknown <= self._lost & manager.declared.aged:
            self._lose("stale_input", f"input is too old: {names}", time)
        else:
            absence = self._control.source.absence
            self._lose("unknown_input", f"the state turned unknown: {names}{absence and f'; {absence}'}", time)
        if self.deciding:
            self._ensemble.liveness.wait()
            self.waiting.begin()

    def _lose(self, kind: str, text: str, time: int, *, told: bool = False) -> None:
        """Take input as lost: a cause beside others, too, so that none of their ways back leads past it.

        Args:
            kind: The cause.
            text: In words.
            time: When.
            told: Whether it is reported where it is no cause.
        """
        secured = self.returning and not self.modes.ending
        # An action that was decided in this turn may be about to begin.
        acts = self.deciding and self._control.decisions > self._base
        if kind in self.modes.causes or not (secured or acts):
            return
        fault = Fault(time, self._ensemble.path, kind, text)
        if self._reactions[_OPTIONS[kind]]:
            self.alarm(fault)
        elif told:
            self._ensemble.runtime.faults.publish(fault)

    @property
    def reacts_to_failures(self) -> bool:
        """Whether a failed action that nothing heeds is a cause."""
        return self._reactions[_FAILED]

    def fail(self, text: str) -> None:
        """Go safe for an action that has failed, where nothing else heeds that."""
        if self.deciding and self._reactions[_FAILED]:
            now = self._ensemble.runtime.now()
            self.obey(self.modes.endanger("action", text, now), now)

    # -- Orders --------------------------------------------------------------------------------------------------

    def obey(self, orders: tuple[Order, ...], time: int) -> None:
        """Carry out the orders of the modes, and publish the mode where it has changed."""
        action, control = self._ensemble.action, self._control
        if any(kind != "impossible_observation" for kind in self.modes.causes):
            self._stale = True
        for order in orders:
            if order is Order.SECURE:
                self.waiting.end()
                if self.modes.safe_action is not Try.SECOND:  # else the pause that leads back has begun by now
                    self._ensemble.liveness.end()
                self.runs += 1
                control.source.hold(self._done)
                for below in self._ensemble.subensembles:
                    below.safety.last_word.stop_alone()
                action.secure(self._on_secured, self.last_word.begins, patience=self._ensemble.settling)
            elif order is Order.HALT:
                self.waiting.end()
                self._ensemble.liveness.end()
                control.source.let_go()
                action.halt(self._ensemble.became_idle)
            elif order is Order.IDLE:
                control.source.let_go()
                self._ensemble.became_idle()
            elif order is Order.EMERGENCY:
                detail = f"the safe action failed twice: {self.modes.causes['safe_action'].detail}"
                self._ensemble.report("safe_action", detail, time=time)
                self._ensemble.runtime.emergency(f"ensemble {self._ensemble.path!r}: {detail}")
            else:
                self._base = control.decisions
                action.admit()
                self._ensemble.liveness.look()
                if order is Order.RESUME:
                    self._resume(time)
                self._stale = False
        self._tell(time)

    def _resume(self, time: int) -> None:
        self._tell(time)
        stale, self._stale = self._stale and self._done is None, False
        self._control.source.go_on(time, restart=stale and not self._keep, predict=stale or self._done is not None)
        if self.deciding and self._control.blind:
            self.waiting.begin()

    def _on_secured(self, failure: str | None) -> None:
        # Behind the state that the cause itself brings about, so that none from before it is decided on.
        secured: Subscription[str | None] = Subscription(None, self._ensemble, self._secured)
        self._ensemble.runtime.dispatcher.deliver_behind(secured, failure)

    def _secured(self, failure: str | None) -> None:
        now = self._ensemble.runtime.now()
        if failure is None:
            self.last_word.safe_at = self._ensemble.action.started
        orders = self.modes.secured(failure, now, early=self.last_word.outlived)
        if self.modes.safe_action is Try.OWED:
            self.last_word.end_stopped()
            return
        self.obey(orders, now)
        if failure is not None and Order.SECURE not in orders:
            self._ensemble.action.give_up()
        if self.modes.stage is Stage.LAST and not self.modes.securing:
            self.last_word.finish()

    def _tell(self, time: int) -> None:
        """Publish the mode and its causes, where they have changed."""
        modes = self.modes
        now = (modes.mode, tuple(modes.causes.values()))
        if now != self._told:
            self._told = now
            message = Mode(time, self._ensemble.path, modes.mode, modes.since, now[1])
            self._channel.publish(message)
            self._ensemble.runtime.modes.publish(message)

    # -- The end -------------------------------------------------------------------------------------------------

    @property
    def ending(self) -> bool:
        """Whether it comes to its end, or has."""
        return self.modes.ending


class LastWord:
    """The end of an ensemble: those below come first, and its safe action runs last where anything has run since.

    Args:
        safety: Carries out its modes.
        ensemble: The ensemble.

    Attributes:
        safe_at: How many lives had begun when the safe action last ended well.
        end_stopped: Ends the stopped ensembles below, which wait until what lives here has ended.
    """

    def __init__(self, safety: Safety, ensemble: Ensemble) -> None:
        self.safe_at = 0
        self.end_stopped: Callable[[], None] = lambda: None
        self._safety = safety
        self._modes = safety.modes
        self._ensemble = ensemble
        self._ended_below: int | None = None
        self._ended: list[Callable[[], None]] = []

    def open(self) -> None:
        """Begin a life of the ensemble."""
        self._ended_below = None
        self._ended.clear()

    def begins(self) -> None:
        """Note that the safe action begins."""
        self._ended_below = self._count_below()

    @property
    def outlived(self) -> bool:
        """Whether an action below has ended since the safe action last began: at its end it is due once more."""
        return self._ended_below is not None and self._count_below() > self._ended_below

    def _count_below(self) -> int:
        return sum(one.action.num_ended for one in self._family() if one is not self._ensemble)

    def _family(self) -> Iterator[Ensemble]:
        """Yield the ensemble and all below it."""
        family = [self._ensemble]
        while family:
            one = family.pop(0)
            yield one
            family = [*one.subensembles, *family]

    @property
    def unsafe(self) -> bool:
        """Whether an action has begun since the safe action last ran, or has ended below since that began.

        Not in the middle of a start, while no action could run.
        """
        action = self._ensemble.action
        unsafe = action.started > self.safe_at or self.outlived
        return unsafe and self._safety.has_safe_action and action.life == "running"

    @property
    def was_left(self) -> bool:
        """Whether it has stopped, and an action has begun here or below since a safe action last ran."""
        stopped = self._modes.mode == "stopped" and not self._ensemble.interrupted
        return stopped and any(one.safety.last_word.unsafe for one in self._family())

    def end(self, kind: str, detail: str, ended: Callable[[], None]) -> None:
        """Make all that is below safe, then this ensemble, with no way back; the outermost has the last word.

        Args:
            kind: The cause: ``end`` or ``failure``.
            detail: In words.
            ended: Called when it is done.
        """
        if self._modes.stage in {Stage.CLOSED, Stage.OVER}:  # closed, where the ensemble above ends in its own start
            ended()
            return
        self._ended.append(ended)
        if self._modes.ending:
            return
        for one in self._family():
            one.safety.last_word.latch()
        self._modes.end_below()
        waiting = len(self._ensemble.subensembles) + 1

        def one_has() -> None:
            nonlocal waiting
            waiting -= 1
            if not waiting:
                self._end_here(kind, detail)

        self._end_below(kind, detail, one_has)
        one_has()

    def _end_below(self, kind: str, detail: str, ended: Callable[[], None]) -> None:
        """Make the deciding ensembles below safe at once, and then the stopped ones; call back for each."""
        family = [child.safety.last_word for child in self._ensemble.subensembles]
        stopped = [below for below in family if below.was_left]
        for below in family:
            if below not in stopped:
                below.end(kind, detail, ended)

        def end_stopped() -> None:
            while stopped:
                stopped.pop().end(kind, detail, ended)

        self.end_stopped = end_stopped
        if stopped:  # their safe actions would run beside lives that go on here
            self._ensemble.action.when_idle(end_stopped)
            self._ensemble.after(self._ensemble.settling, end_stopped)

    def _end_here(self, kind: str, detail: str) -> None:
        self._modes.end_here()
        now, safety = self._ensemble.runtime.now(), self._safety
        if not safety.has_safe_action:
            safety.obey(self._modes.stop(now), now)
        safety.obey(self._modes.end(now, kind, detail, unsafe=self.unsafe), now)
        if not self._modes.securing:
            self._ensemble.action.when_idle(self.finish)

    def finish(self) -> None:
        """The last word is said."""
        if self._modes.finish():
            self._ensemble.became_idle()
            self.tell()

    def tell(self) -> None:
        """Call back those who wait for the end."""
        ended, self._ended = self._ended, []
        for tell in ended:
            tell()

    def stop_alone(self) -> None:
        """Stop ensembles started by hand, here and below; one that an action has started stops at that action's end."""
        for below in self._ensemble.subensembles:
            below.safety.last_word.stop_alone()
        if self._modes.mode != "stopped" and not self._modes.ending and not self._ensemble.awaited:
            self._ensemble.interrupt()

    def latch(self) -> None:
        """Start no decided action any more, and end the lives here; the ensembles below end on their own.

        It stays latched: the ensemble above ends, and it ends with that one.
        """
        self._modes.latch()
        self._ensemble.control.source.latch()
        self._ensemble.action.latch()
        self._ensemble.action.end_functions()
