"""The action layer: from action symbols to the code that moves the robot.

Every action has one exact life: ``running``, then one of ``succeeded``, ``failed``, ``preempted``, ``timed_out`` and
``abandoned``. A new action cancels the running one and starts when that has ended, so that two are never live at once.
The state machine of `mdm.actors.actions.lives` orders lives to begin and end; the layer carries out its orders.
"""

from __future__ import annotations

import asyncio
import inspect
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from mdm.actors.actions.binding import AbandonedError, Binding, Callback, bindings_of, returns_nothing, safe_binding
from mdm.actors.actions.lives import Life, Lives, Order, Part
from mdm.actors.layer import Layer
from mdm.actors.options import SAFE_TIMEOUT, SafetySettings
from mdm.errors import ConfigError, Error
from mdm.messages import Action, ActionLife, ActionStatus
from mdm.runtime import ActorStatistics, Histogram, Latencies
from mdm.runtime.channel import Subscription
from mdm.runtime.handler import has_not_run
from mdm.runtime.statistics import FULL
from mdm.runtime.supervision import LEAVING, describe
from mdm.runtime.work import OWNER, Jobs
from mdm.stimuli import GoesOn, Over, Raised

if TYPE_CHECKING:
    from collections.abc import Iterator, Set as AbstractSet

    from mdm.actors.actions.lives import Orders
    from mdm.actors.ensemble import Ensemble
    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.runtime import Timer, Work

Secured = Callable[[str | None], None]

_FAILED = frozenset({"failed", "timed_out", "abandoned"})

_own, _disown, _owner = OWNER.set, OWNER.reset, OWNER.get


class _Run(Life):
    """A life, and the work that carries it out."""

    __slots__ = ("began", "deadline", "grace", "put_off", "work")

    def __init__(self, name: str, binding: Binding, action: Action, *, secures: bool = False) -> None:
        super().__init__(name, binding, action, secures=secures)
        self.began = action.time
        self.work: Work | None = None
        self.deadline: Timer | None = None
        self.grace: Timer | None = None
        self.put_off: asyncio.Handle | None = None  # the cancellation that comes behind its successor's first step


class _Brief:
    """A binding's function, called on the hot path."""

    __slots__ = ("function", "silent", "takes_action")

    def __init__(self, binding: Binding) -> None:
        self.function = binding.function
        self.takes_action = binding.takes_action
        self.silent = returns_nothing(self.function)


class ActionStatistics(ActorStatistics, frozen=True):
    """Counts of an action layer.

    Attributes:
        started: Lives of actions that began.
        ended: How many of them ended in each way.
        safe_ended: How many of those were run as the safe action.
        skipped: Decisions that were overtaken before their action began.
        live: The actions that are live now.
        latency: From each stimulus to the call of the action's callback.
    """

    started: int
    ended: dict[ActionStatus, int]
    safe_ended: dict[ActionStatus, int]
    skipped: int
    live: tuple[str, ...]
    latency: Histogram


class ActionLayer(Layer):
    """Runs one agent's component of the joint actions published on ``action``; tells their lives on ``lives``.

    Args:
        names: The agent's actions in the model's order.
        bindings: Code for every action, by name or by index, not both.
        component: From a joint action's index to this agent's; None where they are one.
        predicates: Takes the ends of actions as events (``Patrol.succeeded``).
        safe_action: An action's name, or a function, that leaves the robot safe.
        safe_timeout: Seconds that the safe action may take.

    Attributes:
        lives: The state machine: which lives are live, and which may begin.
        begins: Told of an action that begins, by its name.
        ends: Told how an action has ended, by its name, binding, status and in words, whether it took time, and whether
            a later decision had asked it to; says whether it is given up.
        clears: Notified when a replaced life has ended, too; its end as ``preempted`` was reported before.
        heeds: Says whether ``begins`` hears each plain function, too; `count_others` asks it.
    """

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = (
        "_briefs",
        "_called",
        "_choices",
        "_component",
        "_ends",
        "_now",
        "_observers",
        "_others",
        "_recent",
        "_swift",
        "_told",
        "bindings",
        "lives",
        "names",
        "predicates",
        "started",
    )

    def __init__(
        self,
        names: tuple[str, ...],
        bindings: Mapping[str, Callback | Ensemble | Binding] | Mapping[int, Callback | Ensemble | Binding],
        *,
        component: Callable[[int], int] | None = None,
        predicates: PredicateManager | None = None,
        safe_action: str | Callback | Binding | None = None,
        safe_timeout: float = SAFE_TIMEOUT,
        name: str = "action",
    ) -> None:
        super().__init__(name)
        self.safe_timeout = SafetySettings(safe_timeout=safe_timeout).safe_timeout
        self.begins: Callable[[str], None] = lambda _: None
        self.ends: Callable[[str, Binding, ActionStatus, str, bool, bool], bool] = lambda *_: False
        self.clears: Callable[[], None] = lambda: None
        self.heeds: Callable[[], bool] = lambda: False
        self.lives: Lives[_Run] = Lives()
        self.names = names
        self.predicates = predicates
        # The ends that predicates depend on: the manager's own set, so that none is asked for after each action.
        self._ends: AbstractSet[str] = frozenset() if predicates is None else predicates.action_ends
        self.bindings = bindings_of(names, bindings)
        self._briefs = tuple([_Brief(binding) if binding.brief else None for binding in self.bindings])
        self.safe = safe_binding(safe_action, names, self.bindings)
        self.started = 0
        self._ended: dict[ActionStatus, int] = {}
        self._safe_ended: dict[ActionStatus, int] = {}
        # Functions that were called and have succeeded, by action, and are not counted above or below yet.
        self._swift = [0] * len(names)
        self._decided = [0] * len(names)
        self._component = component
        self.joint = component is not None
        self._latencies = Latencies()
        self._record = self._latencies.record
        self._recent = self._latencies.pending
        # Whether any was abandoned or replaced, so that the next life may not be alone, or its beginning is heeded.
        self._others = False
        self._idle: list[Callable[[], None]] = []
        self._secured: Secured = lambda _: None
        self._secures: Callable[[], None] = lambda: None
        self._patience: Timer | None = None

    @property
    def idle(self) -> bool:
        """Whether nothing is done here, not even the safe action: other agents do it."""
        return self.lives.part is Part.DELEGATED

    @property
    def barred(self) -> bool:
        """Whether this agent begins none of its decided actions for now."""
        return self.lives.part is Part.BARRED

    @property
    def live(self) -> tuple[str, ...]:
        """The names of the actions that are live now."""
        current = () if self.lives.current is None else (self.lives.current.name,)
        return (*current, *self.lives.beside)

    @property
    def ages(self) -> dict[str, float]:
        """For how many seconds each action has lived that is live now, by name."""
        lives = self.lives
        running = (*(() if lives.current is None else (lives.current,)), *lives.beside.values())
        return {life.name: (self.runtime.now() - life.began) / 1e9 for life in running}

    @property
    def calls(self) -> int:
        """The number of the life whose function is being called; 0 where none is."""
        return self.started if self.lives.calling else 0

    @property
    def busy(self) -> bool:
        """Whether an action is live or waits for the end of another, or none may begin."""
        return not (self.lives.open and self.lives.quiet)

    @property
    def skipped(self) -> int:
        """Decisions that were overtaken before their action began."""
        return self.lives.skipped

    def name_of(self, joint: int) -> str:
        """Return the name of this agent's component of a joint action."""
        return self.names[joint if self._component is None else self._component(joint)]

    def count_others(self) -> None:
        """See whether the next plain function may be called without a life of its own."""
        self._others = bool(self.lives.replaced or self.lives.left or self.heeds())

    @property
    def ended(self) -> dict[ActionStatus, int]:
        """How many actions have ended in which way, safe actions among them; in the order in which they first did."""
        if swift := sum(self._swift):
            self._ended["succeeded"] = self._ended.get("succeeded", 0) + swift
            self._decided = [*map(operator.add, self._decided, self._swift)]
            self._swift = [0] * len(self._swift)
        return self._ended

    @property
    def decided(self) -> dict[str, int]:
        """How often each action was decided, by name."""
        counts = map(operator.add, self._decided, self._swift)
        return {name: count for name, count in zip(self.names, counts, strict=True) if count}

    @property
    def num_ended(self) -> int:
        """How many actions have ended, safe actions among them."""
        return sum(self.ended.values())

    def statistics(self) -> ActionStatistics:
        """Return the layer's counts so far."""
        return ActionStatistics(
            **msgspec.structs.asdict(super().statistics()),
            started=self.started,
            ended=dict(self.ended),
            safe_ended=dict(self._safe_ended),
            skipped=self.skipped,
            live=self.live,
            latency=self.latency,
        )

    @property
    def latency(self) -> Histogram:
        """The histogram of times from stimulus to the call of a callback."""
        return self._latencies.snapshot()

    def problems(self) -> Iterator[ConfigError]:
        """Yield the faults of ensembles that are bound as actions."""
        for binding in self.bindings:
            if binding.ensemble is not None:
                yield from binding.ensemble.problems()

    def adopt(self, ensemble: Ensemble) -> None:
        """Replace each binding by its own within this layer's ensemble, see `Binding.within`; before the start."""
        own = {id(binding): binding.within(ensemble) for binding in self.bindings}
        for binding in self.bindings:
            bound = own[id(binding)]
            bound.sequel, bound.retries, bound.note = binding.sequel, binding.retries, binding.note
        self.bindings = tuple([own[id(binding)] for binding in self.bindings])
        counts = ensemble.liveness.counts
        self._briefs = tuple([_Brief(each) if each.brief and not counts else None for each in self.bindings])
        if self.safe is not None:
            self.safe = own.get(id(self.safe), self.safe)

    def substitute(self, function: Callable[..., object], *, asks: bool = False) -> None:
        """Call one function, with the binding, in place of those of all actions, as where a run is repeated.

        Where it ``asks``, it is called with the action besides, where the binding's own function is.
        """
        own = {id(each): each.standing_in(partial(function, each), asks=asks) for each in self.bindings}
        if self.safe is not None:
            self.safe = own.get(id(self.safe)) or self.safe.standing_in(partial(function, self.safe), asks=asks)
        self.bindings = tuple([own[id(binding)] for binding in self.bindings])
        briefs = zip(self.bindings, self._briefs, strict=True)
        self._briefs = tuple([known and _Brief(binding) for binding, known in briefs])

    # -- Life of the layer ---------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen for actions."""
        self._told = self.owner.channel("lives", ActionLife)
        self._now = self.runtime.clock.reader()
        self._path = self.owner.path
        self._observers, self._choices = self.runtime.observers, self.runtime.dispatcher.choices
        self._observers.acts(self._path, self)
        self._choices.acts(self._path, self)
        self._observers.watch(self._count_observers)
        self.lives.restart()
        self.subscribe(self.owner.channel("action", Action), self._on_action)

    def _count_observers(self) -> None:
        self._called = self._observers.hears_calls

    def admit(self) -> None:
        """Run actions from now on."""
        self.lives.admit()
        self._idle.clear()

    def bar(self, *, barred: bool) -> None:
        """Start no decided action while it is barred; running lives go on, and the safe action runs when due."""
        self.lives.bar(barred=barred)

    def latch(self) -> None:
        """Start no decided or pending action any more; running lives go on, but for replaced ones."""
        self._obey(self.lives.latch())

    def halt(self, idle: Callable[[], None]) -> None:
        """Cancel all lives, start no more, and call back when none is left; in a turn."""
        self._obey(self.lives.halt())
        self.when_idle(idle)

    def secure(self, secured: Secured, begins: Callable[[], None], *, patience: float = 60.0) -> None:
        """Cancel all lives, start no more, and run the safe action when none is left.

        Args:
            secured: Called when it has ended, in a turn behind all that was decided before: with None, or with how it
                failed. It is then told to run once more, or else `give_up` is called: until then nothing is idle here.
            begins: Called when it begins.
            patience: Seconds after which lives that have not ended are abandoned.
        """
        self._secured, self._secures = secured, begins
        self._obey(self.lives.secure())
        lives = tuple(life for life in self.lives.living if not life.secures)
        if lives:
            self._patience = self.after(patience, lambda: self._abandon_all(lives))
        self._settle()

    def give_up(self) -> None:
        """Run the safe action, which has failed, no more."""
        self.lives.give_up()
        self._settle()

    def end_functions(self) -> None:
        """Cancel all lives but those of ensembles and the safe action."""
        self._obey(self.lives.cancel_all(but=lambda life: life.binding.ensemble is not None))

    def when_idle(self, idle: Callable[[], None]) -> None:
        """Call back when nothing lives: at once, or in the turn in which the last life ends."""
        self._idle.append(idle)
        self._settle()

    def _settle(self) -> None:
        """Begin what waits and may begin now; where nothing lives or waits, call the idle callbacks."""
        lives = self.lives
        if lives.calling:  # an action's own function has brought this about: it comes to its end first
            return
        if lives.safe_action_is_due:
            if self._patience is not None:
                self._patience.cancel()
                self._patience = None
            if self.safe is None or self.idle:
                self._tell_secured(None)
            else:
                self._secures()
                self._begin_life(_Run("safe action", self.safe, Action(self.runtime.now(), -1, -1), secures=True))
        while (life := lives.next()) is not None:
            self._begin_life(life)
        if lives.quiet:
            idle, self._idle = self._idle, []
            for tell in idle:
                tell()

    def _obey(self, orders: Orders[_Run]) -> None:
        """Carry out the state machine's orders."""
        for order, life in orders:
            if order is Order.BEGIN:
                self._begin_life(life)
            elif order is Order.CANCEL:
                self._cancel(life)
            elif order is Order.REPLACE:
                self._replace(life)
            elif order is Order.CANCEL_BEHIND:
                self._cancel_behind(life)
            else:
                self._cancel_now(life)

    # -- Choosing ------------------------------------------------------------------------------------------------

    def _on_action(self, action: Action) -> None:
        lives = self.lives
        index = action.index if self._component is None else self._component(action.index)
        if not lives.open:
            self._decided[index] += 1
            lives.skipped += 1
            return
        brief = self._briefs[index]
        if brief is None or lives.current is not None or self._told.heard or self._others:
            self._decided[index] += 1
            life = _Run(self.names[index], self.bindings[index], action)
            living = lives.met_by(life)
            own = living is not None and living.work is not None and self._is_last(living, living.work, action)
            self._obey(lives.choose(life, lambda: self._continues(life), own=own))
            return
        # Hot path: a plain function, while nothing lives and nobody listens to lives, needs no record of its own.
        self.started += 1
        self._recent.append((_ := self._now)() - action.time)
        if len(self._recent) >= FULL:
            self._latencies.fold()
        # Whose jobs are made where it has any; the work of a function that returns nothing is over with its call.
        token = None if brief.silent and _owner() is None else _own(action)
        try:
            lives.calling = True
            result = (_ := brief.function)(action) if brief.takes_action else (_ := brief.function)()
            lives.calling = False
            if token is not None:
                _disown(token)
        except BaseException as error:
            if token is not None:
                _disown(token)
            self._raised(self._begun(index, action), error)
            return
        if result is not None or not lives.open:
            self._returned(self._begun(index, action), result, Jobs.of(action))
            return
        self._swift[index] += 1
        if self._called:
            self._observers.call(self._path, self.started, self.names[index], action.time)
        if self._ends:
            self._raise_end(self.names[index], "succeeded")

    def _begun(self, index: int, action: Action) -> _Run:
        """Return the life of a plain function that was called without one."""
        self._decided[index] += 1
        life = _Run(self.names[index], self.bindings[index], action)
        life.number = self.started
        if self._observers.hears_lives:
            self._observers.life(ActionLife(action.time, self._path, life.number, life.name, "running"))
        return life

    def _returned(self, life: _Run, result: object, jobs: Jobs) -> None:
        """A function has returned: an awaitable runs as a task, and has ended when its jobs have."""
        if inspect.isawaitable(result):
            self._keep(life)
            try:
                life.work = self.spawn(result, lambda work: self._work_ended(life, work), name=life.name, jobs=jobs)
            except Error as error:  # the layer has ended already
                self._finish(life, "failed", describe(error))
            else:
                self._choices.lasts(self._path, life.number, life.work)
                self._observers.lasts(self._path, life.number, life.work, self.runtime.now())
        elif has_not_run(result):
            self._observers.tell(Raised, self.runtime.now(), self._path, life.number, repr(result), True)
            self._end_life(life, "failed", f"returned {result!r}, of which nothing has run")
        else:
            self._end_life(life, "succeeded")
        self._call_over(life)

    def _raised(self, life: _Run, error: BaseException) -> None:
        """A function has raised."""
        self.lives.calling = False
        text = describe(error)
        self._observers.tell(Raised, self.runtime.now(), self._path, life.number, text)
        self._end_life(life, "failed", text)
        if isinstance(error, LEAVING):
            self.fail(error)  # which ends the runtime; the code that decided this action goes on
        self._call_over(life)

    def _call_over(self, life: _Run) -> None:
        """Carry out the orders that a function has itself brought about, once its call is over."""
        lives = self.lives
        if life.secures:
            return
        if not lives.open:  # it stopped its deciding ensemble: nothing that it has returned goes on
            self._obey(lives.cancel(life, "preempted"))
        if not lives.open or lives.waits:
            self._settle()

    def _is_last(self, life: _Run, work: Work, action: Action) -> bool:
        """Whether a task has perhaps taken its last step when an action is chosen: in that step, or behind it."""
        if work.is_calling:
            return self.runtime.clock.firing < 0  # a timer that was due before is not its doing
        return self._is_over(life, work, action)

    def _is_over(self, life: _Run, work: Work, action: Action) -> bool:
        """Whether a task is over when an action is chosen, and its end on the way."""
        over = self._choices.over(self._path, action.epoch, action.time, life.number, work.done)
        if over:
            self._observers.tell(Over, action.time, self._path, action.epoch, life.number)
        return over

    def _continues(self, life: _Run) -> bool:
        """Whether a running task goes on when its action is chosen again."""
        binding, action = life.binding, life.action
        if binding.goes_on is None:
            return binding.continues(action)
        goes_on = self._choices.goes_on(self._path, action.epoch, action.time, lambda: bool(binding.continues(action)))
        self._observers.tell(GoesOn, action.time, self._path, action.epoch, goes_on)
        return goes_on

    def _replace(self, life: _Run) -> None:
        """Report the end of a life that another of its group replaces, so that the device they drive need not stop."""
        self._others = True
        if life.deadline is not None:
            life.deadline.cancel()
        self._end_life(life, "preempted")
        life.grace = self.after(life.binding.grace, lambda: self._abandon(life))

    def _cancel_behind(self, life: _Run) -> None:
        """Cancel a replaced life behind the first step of its successor, unless nothing may begin by then."""
        assert life.work is not None
        if life.work.begun and self.lives.open:
            life.put_off = asyncio.get_running_loop().call_soon(self._cancel_now, life)
        else:
            life.work.cancel()

    def _cancel_now(self, life: _Run) -> None:
        """Carry out the cancellation of a replaced life that was put off."""
        put_off, life.put_off = life.put_off, None
        if put_off is not None and life.work is not None:
            put_off.cancel()
            life.work.cancel()

    # -- Lives ---------------------------------------------------------------------------------------------------

    def _begin_life(self, life: _Run) -> None:
        """Start a life. Hot path for plain functions."""
        self.started = life.number = self.started + 1
        binding, action = life.binding, life.action
        if not life.secures:
            self.begins(life.name)
        itself = self._beside_left(life) if self.lives.left else None
        if self._told.heard or self._observers.hears_lives:
            self._tell(life, "running")
        if itself is not None:
            seconds = (self.runtime.now() - itself.began) / 1e9
            text = f"still runs since {seconds:g} s ago, abandoned: it is not begun beside itself"
            self._end_life(life, "failed", text)
            return
        ensemble = binding.ensemble
        if ensemble is not None:
            if ensemble.life != "running" or ensemble.failing:  # which may not have stopped yet
                what = "has failed" if ensemble.failing else f"is {ensemble.life}"
                self._end_life(life, "failed", f"ensemble {ensemble.path!r} does not run: it {what}")
                return
            self._keep(life)
            ensemble.when_idle(lambda: self._ensemble_ended(life))
            ensemble.begin(resume=binding.resume)
            return
        if action.epoch >= 0:
            self._record(self._now() - action.time)
        jobs = Jobs()
        try:
            self.lives.calling = True
            result = jobs.call(binding.function, *((action,) if binding.takes_action else ()))
            self.lives.calling = False
        except BaseException as error:
            self._raised(life, error)
            return
        self._returned(life, result, jobs)

    def _keep(self, life: _Run) -> None:
        life.began = self.runtime.now()
        self.lives.keep(life)
        timeout = self.safe_timeout if life.secures else life.binding.timeout
        if timeout is not None:
            life.deadline = self.after(timeout, lambda: self._obey(self.lives.cancel(life, "timed_out")))

    def _cancel(self, life: _Run) -> None:
        if life.binding.ensemble is not None:
            life.binding.ensemble.interrupt()
        elif life.work is not None:
            life.work.cancel()
            life.grace = self.after(life.binding.grace, lambda: self._abandon(life))

    def _abandon(self, life: _Run) -> None:
        if life.work is not None:
            self._leave(life, life.work)
            self._finish(life, "abandoned", f"did not end within {life.binding.grace:g} s of being cancelled")

    def _abandon_all(self, lives: tuple[_Run, ...]) -> None:
        """Abandon lives that their own grace has not ended, as when the layer itself has failed."""
        for life in set(lives).intersection(self.lives.living):
            if life.work is not None:
                self._leave(life, life.work)
            self._finish(life, "abandoned", "had not ended when the safe action was due")

    def _leave(self, life: _Run, work: Work) -> None:
        self.abandon(work)
        self.lives.leave(life)
        self._others = True
        work.over.add_done_callback(lambda _: self._left_ended(life, work))

    def _left_ended(self, life: _Run, work: Work) -> None:
        """An abandoned task has ended at last."""
        self._forget(life)
        if self.life == "running":
            self._observers.ended(self._path, life.number, work, self.runtime.now())

    def _forget(self, life: _Run) -> None:
        self.lives.forget(life)
        self.count_others()

    def _beside_left(self, life: _Run) -> _Run | None:
        """Return the abandoned life of the same action, if any; report the others that this one begins beside."""
        for left in (*self.lives.left,):
            if left.work is not None and self._is_over(left, left.work, life.action):
                self._forget(left)
        itself = self.lives.itself(life)
        if itself is None and self.lives.left:
            running = " and ".join(repr(left.name) for left in self.lives.left)
            self.report("action", f"action {life.name!r} begins while {running}, abandoned, still runs")
        return itself

    def _work_ended(self, life: _Run, work: Work) -> None:
        self._observers.ended(self._path, life.number, work, self.runtime.now())
        if work.error is not None:
            status: ActionStatus = "abandoned" if isinstance(work.error, AbandonedError) else "failed"
            self._finish(life, status, describe(work.error))
        elif work.interrupted and (work.cancelled or not life.binding.may_succeed):  # even where it has returned
            self._finish(life, life.ending or "preempted")
        elif work.cancelled:
            self._finish(life, "failed", "was cancelled, but not by its action layer")
        else:
            self._finish(life, "succeeded")

    def _ensemble_ended(self, life: _Run) -> None:
        ensemble = life.binding.ensemble
        assert ensemble is not None
        if ensemble.failing:
            self._finish(life, "failed", f"ensemble {ensemble.path!r} failed")
        elif ensemble.safety.ending:  # the ensemble below ends before this layer has asked for it
            self._finish(life, "preempted")
        else:
            self._finish(life, life.ending or "succeeded")

    def _finish(self, life: _Run, status: ActionStatus, detail: str = "") -> None:
        replaced = life in self.lives.replaced
        if not self.lives.end(life):
            return  # it was abandoned, and an ensemble that was abandoned ends all the same
        for timer in (life.deadline, life.grace):
            if timer is not None:
                timer.cancel()
        if replaced:  # that it was preempted is told already
            self.count_others()
            if status in _FAILED:
                self.report("action", f"action {life.name!r}, which was replaced, {status.replace('_', ' ')}: {detail}")
            self.clears()
        else:
            self._end_life(life, status, detail)
        self._settle()

    def _end_life(self, life: _Run, status: ActionStatus, detail: str = "") -> None:
        ended = self.ended
        ended[status] = ended.get(status, 0) + 1
        text = f"action {life.name!r} {status.replace('_', ' ')}: {detail}".rstrip(": ")
        if life.secures:
            self._safe_ended[status] = self._safe_ended.get(status, 0) + 1
            self._tell_secured(None if status == "succeeded" else text)
        if status in _FAILED:
            self.report("action", text)
        lasted = life.work is not None or life.binding.ensemble is not None
        asked = life.ending == "preempted"
        gave_up = not life.secures and self.ends(life.name, life.binding, status, text, lasted, asked)
        if self._told.heard or self._observers.hears_lives:
            self._tell(life, status, detail)
        if self._ends:
            self._raise_end(life.name, status)
            if gave_up:
                self._raise_end(life.name, "gave_up")

    def _tell_secured(self, failure: str | None) -> None:
        if self.lives.secured(failed=failure is not None):
            self.runtime.dispatcher.deliver(Subscription(None, self, self._secured), failure)

    def listened(self, name: str, status: str) -> bool:
        """Whether a predicate or event of the system depends on this end of an action."""
        return f"{name}.{status}" in self._ends

    def _raise_end(self, name: str, status: str) -> None:
        event = f"{name}.{status}"
        if self.predicates is not None and event in self._ends:
            self.predicates.derive((), (event,))

    def _tell(self, life: _Run, status: ActionStatus, detail: str = "") -> None:
        told = ActionLife(self.runtime.now(), self._path, life.number, life.name, status, detail)
        self._observers.life(told)
        if self._told.heard:
            self._told.publish(told)
