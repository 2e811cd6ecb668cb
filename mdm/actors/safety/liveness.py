"""Liveness: an ensemble that decides has a live action, or waits for something that it names, or is idle and says so.

Nothing of it is on the way from an input to an action: an ensemble is looked at when an action that takes time has
ended, behind all that this brings about. One that should decide and does not know its
state reports the input that it waits for.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Final, NamedTuple

from mdm.messages import Fault, Idle, PredicateUpdate, State
from mdm.runtime.channel import Subscription

if TYPE_CHECKING:
    from mdm.actors.actions.binding import Binding
    from mdm.actors.control.control_layer import ControlLayer
    from mdm.actors.ensemble import Ensemble
    from mdm.actors.options import SafetySettings, Sequel
    from mdm.messages import ActionStatus
    from mdm.runtime import Timer

_PATIENCE = 1.0


class Waiting:
    """Reports the input that an ensemble waits for, a second after it began to wait, and again when that changes.

    It listens while the ensemble waits, and not otherwise, so that a decision costs nothing for it.

    Args:
        ensemble: The ensemble.

    Attributes:
        names: The input that it waits for now; empty where it waits for nothing.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self.names: tuple[str, ...] = ()
        self._ensemble = ensemble
        self._subscriptions: list[Subscription[State] | Subscription[PredicateUpdate]] = []
        self._timer: Timer | None = None
        self._told: tuple[str, ...] = ()

    def unknown(self) -> tuple[str, ...]:
        """Return the unknown predicates that keep the state unknown; empty where no state layer tells it."""
        layer = self._ensemble.state
        return () if layer is None else layer.unknown()

    def begin(self) -> None:
        """Note that the ensemble waits for its state, and listen for it."""
        if self._subscriptions:
            return
        ensemble = self._ensemble
        self.names = self._wanted()
        self._told = ()
        self._timer = ensemble.call_later(_PATIENCE, self._tell)
        self._subscriptions = [ensemble.channel("state", State, retain=True).subscribe(self._on_state, ensemble)]
        if ensemble.state is not None:
            updates = ensemble.state.predicates.updates
            self._subscriptions.append(updates.subscribe(self._on_update, ensemble, topics=ensemble.state.inputs()))

    def end(self) -> None:
        """Stop listening: the ensemble waits no more."""
        self.names = ()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for subscription in self._subscriptions:
            subscription.cancel()
        self._subscriptions.clear()

    def _wanted(self) -> tuple[str, ...]:
        if self._ensemble.state is None:
            return (f"a state on {self._ensemble.path}/state",)
        return self.unknown()  # nothing, where all is known by now and the state is about to come

    def _on_state(self, state: State) -> None:
        if state.index is not None:
            self.end()

    def _on_update(self, _: PredicateUpdate) -> None:
        self.names = self._wanted()
        if self._timer is None:
            self._tell()

    def _tell(self) -> None:
        self._timer = None
        self.names = self._wanted()
        if self._subscriptions and self.names and self.names != self._told:
            self._told = self.names
            manager = self._ensemble.predicates
            tellers = {} if manager is None else manager.declared.tellers
            *most, last = [f"{name} ({tellers[name]})" if name in tellers else name for name in self.names]
            names = f"{', '.join(most)} and {last} are" if most else f"{last} is"
            absence = self._ensemble.absence
            self._ensemble.report("waiting", f"cannot decide while {names} unknown{absence and f': {absence}'}")


_TIMES: Final = 30
_AT_ONCE: Final = 100_000_000
_RATE: Final = 10
_LASTS: Final = 1_500_000_000
_FLAPS: Final = 8
_SECOND: Final = 1_000_000_000
_FEWEST, _MOST = 16, 256


class Livelock:
    """Reports, once a spell, an action that succeeds at once again and again, or a predicate that flaps.

    It is the opposite of idleness: decisions of which nothing comes. No plain decision pays for it. Decisions for an
    action's end alone are counted where they are made; how quickly others come is looked at some twice a second, and
    what flaps is heard only while they come too quickly.

    Args:
        ensemble: The ensemble.
        control: Its control layer.
    """

    def __init__(self, ensemble: Ensemble, control: ControlLayer) -> None:
        self._ensemble = ensemble
        self._control = control
        self._action, self._times, self._again = "", 0, -1
        # At the last look: when it was, and how many decisions; the same at the begin of decisions that come quickly.
        self._looked = self._spell = -1, 0
        # Of the present spell of such decisions: hears its flapping, until that is told.
        self._heard: Subscription[PredicateUpdate] | None = None
        self._changes: Counter[str] = Counter()
        self._counted = -1
        if control.event_driven:
            control.output.look = self._look

    def decides_again(self, time: int) -> None:
        """Note that only the end of the action before led to this decision."""
        self._again = time

    def ended(self, action: str, *, well: bool) -> None:
        """Take the end of an action that is decided again; ``well`` if it succeeded, and no other decision came."""
        again, self._again = self._again, -1
        at_once = again >= 0 and self._ensemble.runtime.now() - again <= _AT_ONCE
        self._times = self._times + 1 if well and at_once and action == self._action else 0
        self._action = action
        if self._times == _TIMES:
            self._report(
                f"action {action!r} has succeeded at once {_TIMES} times in a row, and was decided again each time: "
                "its success changes nothing of what it is decided on"
            )

    def end(self) -> None:
        """Forget what was counted: the ensemble has stopped deciding."""
        self._times, self._again, self._looked = 0, -1, (-1, 0)
        self._calm()

    def _calm(self) -> None:
        self._spell = -1, 0
        if self._heard is not None:
            self._heard.cancel()
            self._heard = None

    def _look(self) -> int:
        """Look how quickly decisions come; return after how many to look again."""
        ensemble, (then, count) = self._ensemble, self._looked
        now, decisions = self._looked = ensemble.runtime.now(), self._control.decisions
        more, passed = decisions - count, now - then
        # Of a turn without end `endless_turn` is told.
        if then < 0 or more * _SECOND < _RATE * passed or ensemble.runtime.dispatcher.goes_on:
            self._calm()
            return _FEWEST
        if self._spell[0] < 0:
            self._spell = then, count
        lasts, shared = now - self._spell[0] >= _LASTS, self._control.source.shared  # others' input decides, too
        if lasts and not (self._heard or shared or ensemble.predicates is None) and (used := ensemble.inputs()):
            self._heard = ensemble.predicates.updates.subscribe(self._on_update, ensemble, topics=used)
        return min(max(_FEWEST, more * _SECOND // (2 * passed)), _MOST) if passed else _MOST

    def _on_update(self, update: PredicateUpdate) -> None:
        if not 0 <= update.time - self._counted <= _SECOND:
            self._changes.clear()
            self._counted = update.time
        self._changes.update((*update.rising, *update.falling))
        flapping = sorted(name for name, count in self._changes.items() if count >= _FLAPS)
        if flapping and self._heard is not None:
            self._heard.cancel()
            manager, (since, count) = self._ensemble.predicates, self._spell
            assert manager is not None
            names = [name for name in flapping if not manager.declared.derived(name)] or flapping
            rate = (self._control.decisions - count) * _SECOND / (update.time - since)
            what = f"predicate {names[0]!r} flaps" if len(names) == 1 else f"predicates {', '.join(names)} flap"
            self._report(f"{what}: {rate:.3g} decisions a second")

    def _report(self, detail: str) -> None:
        runtime = self._ensemble.runtime
        runtime.faults.publish(Fault(runtime.now(), self._ensemble.path, "livelock", detail))


IDLE_AFTER = 10.0
"""Seconds of idleness after which it is told as a fault, where an action that takes time has ended."""

_FAILED = frozenset({"failed", "timed_out", "abandoned"})
_ACTION = frozenset({"action"})


LONGEST_PAUSE = 60.0
"""Seconds to which the pause between failures grows at most, where it does not begin longer."""


class Due(NamedTuple):
    """The sequel that is due after an action's end.

    Attributes:
        pause: Seconds after which to decide again, or None.
        gave_up: Whether it has failed as often as it may.
    """

    pause: float | None = None
    gave_up: bool = False


class Tries:
    """Counts how often the same action has failed in a row, and returns the sequel of each end."""

    __slots__ = ("_failures", "_name")

    def __init__(self) -> None:
        self._name = ""
        self._failures = 0

    @property
    def counting(self) -> bool:
        """Whether an action has failed, so that a row may go on."""
        return self._failures > 0

    def began(self, name: str) -> None:
        """Take the beginning of an action, which ends the row of another one."""
        if name != self._name:
            self._name, self._failures = name, 0

    def ended(self, name: str, sequel: Sequel, *, failed: bool, retries: bool = False) -> Due:
        """Take the end of an action that nobody asked for.

        Args:
            name: The action's.
            sequel: Its binding's declaration.
            failed: Whether it failed.
            retries: Whether failures are followed by a decision, even against its declaration.
        """
        self.began(name)
        if not failed:
            self._failures = 0
            return Due(sequel.pause if sequel.then == "decide" else None)
        retries = retries or sequel.then == "decide"
        if not (retries or sequel.attempts):
            return Due()
        self._failures += 1
        if sequel.attempts is not None and self._failures >= sequel.attempts:
            self._failures = 0  # once begun again it has as many once more
            return Due(gave_up=True)
        longest = max(LONGEST_PAUSE, sequel.pause)
        return Due(min(sequel.pause * 2.0 ** min(self._failures - 1, 64), longest) if retries else None)


class _End(NamedTuple):
    """How an action has ended."""

    status: ActionStatus
    binding: Binding
    lasted: bool


class Liveness:
    """Decides again where that is declared, and notices an ensemble that has nothing to do.

    Args:
        ensemble: The ensemble.
        settings: The ensemble's options.

    Attributes:
        retries: Whether failed actions are followed by a decision, even against their bindings.
        since: Nanoseconds since when the ensemble is idle; None where it is not.
        repeats: How often it was decided again in an episode for no other reason than that an action had ended.
    """

    def __init__(self, ensemble: Ensemble, settings: SafetySettings) -> None:
        self.retries = settings.on_failed_action == "decide"
        self.since: int | None = None
        self.repeats = 0
        self._ensemble = ensemble
        self._control = ensemble.control
        self._idle_after = settings.idle_after
        self._tries = Tries()
        self._total = 0
        self._rest = "", False
        self._ended: dict[str, _End] = {}
        self._again: Timer | None = None
        self._why = ""
        self._decisions = 0
        self._patience: Timer | None = None
        self._later: Timer | None = None
        self._looks: Subscription[int] = Subscription(None, ensemble, self._look)
        self._livelock = Livelock(ensemble, self._control)
        ensemble.action.begins = self.began
        ensemble.action.ends = self.ended
        ensemble.action.clears = self.look
        ensemble.action.heeds = lambda: self._again is not None or self.since is not None or self._tries.counting

    @property
    def idle(self) -> float:
        """Seconds for which the ensemble has been idle, all in all."""
        now = 0 if self.since is None else self._ensemble.runtime.now() - self.since
        return (self._total + now) / 1e9

    @property
    def resting(self) -> float | None:
        """Seconds since when the ensemble has had nothing to do; None where it has."""
        return None if self.since is None else (self._ensemble.runtime.now() - self.since) / 1e9

    @property
    def waiting(self) -> tuple[str, ...]:
        """The pause or the holds that it waits for before it decides again, in words."""
        if self._again is not None:
            return (self._why,)
        if self.since is not None or not self._rests:
            return ()
        now = self._ensemble.runtime.now()
        return tuple(f"{name!r} to hold for {(due - now) / 1e9:g} s more" for name, due in self._holding().items())

    # -- Ends and retries -----------------------------------------------------------------------------------------

    @property
    def counts(self) -> bool:
        """Whether the end of each plain function is to be noticed, too, which costs a decision some microseconds."""
        return self.retries or (self._idle_after is not None and self._idle_after != math.inf)

    def began(self, name: str) -> None:
        """Note that an action begins, which ends a pause and a rest."""
        self._tries.began(name)
        self._cancel_again()
        self._end_rest()
        self._ended.pop(name, None)

    def ended(self, name: str, binding: Binding, status: ActionStatus, text: str, lasted: bool, asked: bool) -> bool:
        """Take the end of an action.

        Args:
            name: The action's.
            binding: Its binding.
            status: How it has ended.
            text: The same, in words.
            lasted: Whether it took time.
            asked: Whether a later decision had asked it to: where its cleanup then raises, that is told, and is no
                cause; and where it has succeeded, nothing follows.

        Returns:
            Whether it is given up for now.
        """
        ensemble, safety, due = self._ensemble, self._ensemble.safety, Due()
        # A plain function's effect stands.
        stands = not (lasted or binding.sequel.counts or self.counts) and status == "succeeded"
        if stands or not safety.deciding:
            return False
        self._ended[name] = _End(status, binding, lasted)
        if status != "preempted" and not (asked and status in {"failed", "succeeded"}):
            failed = status in _FAILED
            # Before the safe action counts as chosen, and what waits is discarded.
            follows = self._decides_alone and self._chosen == name
            answered = ensemble.action.lives.waits and (asked or self._decides_alone)
            due = self._tries.ended(name, binding.sequel, failed=failed, retries=self.retries or binding.retries)
            if failed and not ensemble.action.listened(name, status):
                safety.fail(text)
                if answered:  # the input that is the way back has come, and is decided on behind the safe action
                    safety.reopen(_ACTION, ensemble.runtime.now())
            if due.gave_up:
                self._give_up(name, text, binding.sequel)
            elif due.pause is not None and (follows or not safety.deciding):
                self._plan(due.pause, name, status)
            ensemble.action.count_others()
        self.look()
        return due.gave_up

    def look(self) -> None:
        """See whether anything is done, behind all that the running turn brings about."""
        runtime = self._ensemble.runtime
        runtime.dispatcher.deliver_behind(self._looks, runtime.now())

    def end(self) -> None:
        """Forget all ends, pauses and rests: the ensemble does not decide."""
        self._cancel_again()
        if self._later is not None:
            self._later.cancel()
            self._later = None
        self._end_rest()
        self._ended.clear()
        self._livelock.end()

    def wait(self) -> None:
        """End a rest: the ensemble waits for its state."""
        self._end_rest()

    # -- Deciding again ------------------------------------------------------------------------------------------

    @property
    def _decides_alone(self) -> bool:
        """Whether nothing but an input has it decide: at a fixed rate the next tick does."""
        return self._control.event_driven

    def _plan(self, pause: float, name: str, status: ActionStatus) -> None:
        self._cancel_again()
        ensemble = self._ensemble
        alone = self._control.decisions <= self._decisions + 1
        self._livelock.ended(name, well=alone and status == "succeeded")
        self._decisions = self._control.decisions
        self._why = f"a pause of {pause:g} s, for action {name!r} {status.replace('_', ' ')}"
        self._again = ensemble.call_later(pause, self._decide_again)
        ensemble.action.count_others()

    def _cancel_again(self) -> None:
        if self._again is not None:
            self._again.cancel()
            self._again = None
            self._ensemble.action.count_others()

    def _decide_again(self) -> None:
        ensemble, safety = self._ensemble, self._ensemble.safety
        now = ensemble.runtime.now()
        self._cancel_again()
        if safety.modes.mode == "safe":  # by the failure itself
            safety.reopen(_ACTION, now)
        elif safety.deciding and self._decides_alone and self._control.decisions == self._decisions:
            self._livelock.decides_again(now)
            self.repeats += self._control.source.decide_again(now)
        self.look()

    def _give_up(self, name: str, text: str, sequel: Sequel) -> None:
        ensemble = self._ensemble
        if ensemble.action.listened(name, "gave_up"):
            return
        detail = f"action {name!r} is given up after {sequel.attempts} failures in a row; the last: {text}"
        ensemble.action.report("action", detail)
        ensemble.safety.endanger("action", detail, ensemble.runtime.now())

    # -- Idleness ------------------------------------------------------------------------------------------------

    @property
    def _rests(self) -> bool:
        """Whether it decides, nothing that it has decided runs or stands, and it is not about to decide."""
        ensemble = self._ensemble
        control = self._control
        return (
            self._again is None
            and ensemble.safety.deciding
            and self._decides_alone
            and (control.acted is None or self._end is not None)  # else its effect stands
            and not ensemble.action.busy
            and not control.blind
            and (control.asking is None or control.asking.stimulus is None)
        )

    def _holding(self) -> dict[str, int]:
        """Return the predicates that may yet change its decision since they are about to be true, and when they are."""
        manager = self._ensemble.predicates
        held = {} if manager is None else manager.holding
        return {name: held[name] for name in sorted(held.keys() & self._ensemble.inputs())} if held else {}

    def _look(self, time: int) -> None:
        ensemble = self._ensemble
        if self.since is not None or not self._rests:
            return
        if holding := self._holding():
            self._look_again(max(holding.values()))
            return
        self.since = time
        if ensemble.predicates is not None:
            ensemble.predicates.hears_holds.append(self._on_hold)
        self._rest = ("" if self._end is None else self._chosen), self._meant
        ensemble.action.count_others()
        self._tell(idle=True, time=time)
        after = self._limit()
        if after is not None:
            self._patience = ensemble.call_later(after, lambda: self._complain(after))

    def _limit(self) -> float | None:
        """Seconds after which it is told as a fault; None where it is not."""
        ensemble = self._ensemble
        if self._meant or self._idle_after == math.inf:
            return None
        if self._idle_after is not None:
            return self._idle_after
        if self._control.source.shared:  # its part may be done while others do theirs
            return None
        end = self._end
        if end is None:
            lasting = any(binding.lasts for binding in ensemble.action.bindings)
        else:
            lasting = end.lasted or end.status in _FAILED
        return IDLE_AFTER if lasting else None

    @property
    def _meant(self) -> bool:
        return self._end is not None and self._end.binding.sequel.then == "wait"

    @property
    def _chosen(self) -> str:
        """The action that was decided last in this episode; empty where there is none."""
        acted = self._control.acted
        return "" if acted is None else self._ensemble.action.name_of(acted)

    @property
    def _end(self) -> _End | None:
        """How the action has ended that was decided last, and its binding; None where it stands, or there is none."""
        return self._ended.get(self._chosen)

    def _look_again(self, when: int) -> None:
        """Look behind all that is brought about by then."""
        if self._later is not None:
            self._later.cancel()

        def look() -> None:
            self._later = None
            self.look()

        self._later = self._ensemble.call_at(when, look)

    def _complain(self, after: float) -> None:
        self._patience = None
        ensemble = self._ensemble
        end, why = self._end, "it can decide, and nothing has been decided"
        if end is not None:
            why = f"action {self._chosen!r} {end.status.replace('_', ' ')}, and nothing has been decided since"
        detail = f"idle for {after:g} s: {why}"
        ensemble.runtime.faults.publish(Fault(ensemble.runtime.now(), ensemble.path, "idle", detail))

    def _on_hold(self, name: str) -> None:
        """Count as waiting, and not as idle, while a predicate is about to become true."""
        if name in self._ensemble.inputs():
            self._end_rest()
            self.look()

    def _end_rest(self) -> None:
        if self.since is None:
            return
        if self._ensemble.predicates is not None:
            self._ensemble.predicates.hears_holds.remove(self._on_hold)
        now = self._ensemble.runtime.now()
        self._total += now - self.since
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None
        self._tell(idle=False, time=now)
        self.since = None
        self._ensemble.action.count_others()

    def _tell(self, *, idle: bool, time: int) -> None:
        ensemble = self._ensemble
        channel = ensemble.runtime.idles
        if channel.heard:
            assert self.since is not None
            channel.publish(Idle(time, ensemble.path, idle, self.since, *self._rest))
