"""The control layer: a controller with a drive, messages and faults around it.

Event-driven and fixed-rate control share one path from a stimulus to a decision; only the trigger differs. Where the
policy's answer comes later, as a search's does, the layer asks its planner and decides when the answer is there.
"""

from __future__ import annotations

import operator
import sys
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast

import msgspec

from mdm.actors.control.output import Output, symbol_of
from mdm.actors.control.planner import PATIENCE, Asking, Planner
from mdm.actors.control.source import OwnChannels
from mdm.actors.layer import Layer
from mdm.actors.options import ControlOptions, ControlSettings, Drive, FixedRate, OnEvent, drive_of
from mdm.actors.safety.modes import AT_KNOWN
from mdm.controller import Controller
from mdm.errors import ConfigError, ModelError, PolicyError
from mdm.messages import Control, Fault, Observation, State, Tick
from mdm.options import ControllerSettings
from mdm.runtime import ActorStatistics, Histogram
from mdm.runtime.supervision import text_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors.control.output import Observed
    from mdm.actors.control.source import Source
    from mdm.actors.safety.safety import Safety
    from mdm.controller import Step
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.matrices import Vector
    from mdm.models.space import Space
    from mdm.policies import Deliberating
    from mdm.runtime import Ticker


class ControlStatistics(ActorStatistics, frozen=True):
    """Counts of a control layer.

    Attributes:
        decisions: Actions that were published.
        impossible: Observations that have probability 0 by the model.
        superseded: Observations in whose place a newer one was taken.
        undecided: Ticks without a known state.
        missed: Ticks that the event loop came too late for.
        latency: From each stimulus to its decision, and after missed ticks once more from the first of them.
    """

    decisions: int
    impossible: int
    superseded: int
    undecided: int
    missed: int
    latency: Histogram


class ControlLayer(Layer):
    """Drives a `Controller`: hands it states and observations, and publishes its decisions.

    Reads ``state``, ``observation``, ``external_belief``, ``initial_belief`` and ``control``; publishes ``action``,
    ``reward`` and ``belief`` under its ensemble's name, and a `Decision` on the runtime's ``decisions``.

    Args:
        policy: As for `Controller`.
        model: As for `Controller`.
        agent: As for `Controller`.
        options: See `ControlOptions`.

    Raises:
        ConfigError: If sizes or names do not fit each other, or an option means nothing here.

    Attributes:
        guard: Receives its alarms; None where it stands alone.
        source: The source of its input: its ensemble's channels, or a team.
        running: Whether it decides.
        state: The last state that it was told; None where none is known.
        decided: The epoch at which a safe action of the model's began, and the decision before it.
        alarms: How often it has reported something that endangers the ensemble.
        controller: The controller that decides.
        output: Publishes its decisions.
        planner: Searches for an answer, where the policy's comes later; else None.
        asking: Asks the planner, where there is one.
        ticks: Decides at a fixed rate, where the drive is one.
        another: Returns another controller of the same policy, model and options.
    """

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = (
        "_acts",
        "_last_epoch",
        "_see",
        "_tell",
        "asking",
        "controller",
        "event_driven",
        "output",
        "running",
        "source",
        "state",
    )

    def __init__(
        self,
        policy: GivenPolicy,
        model: GivenModel | None = None,
        *,
        agent: int | str | None = None,
        name: str = "control",
        **options: Unpack[ControlOptions],
    ) -> None:
        super().__init__(name)
        settings = ControlSettings.from_keywords(options)
        rest = settings.as_arguments(ControllerSettings)
        self.controller = Controller(policy, model, agent=agent, **rest)
        self.another = partial(Controller, policy, model, agent=agent, **rest)
        self.drive = drive_of(settings.drive)
        if isinstance(self.drive, FixedRate):
            self.controller.step_by_step()
        self.deadline = settings.deadline
        self.on_no_observation = settings.on_no_observation
        unseen = unobserved(self.on_no_observation, self.controller.symbols.observation_space)
        self.ticks = Ticks(self, self.drive, unseen)
        self.guard: Safety | None = None
        self.source: Source = OwnChannels(self)
        self.running = False
        self.alarms = 0
        self.takes_states = self.controller.takes == "state"
        self.event_driven = isinstance(self.drive, OnEvent)
        self._see = self.controller.see
        self._last_epoch = sys.maxsize if self.controller.horizon is None else self.controller.horizon
        self.state: int | None = None
        self.decided: tuple[int, int | None] = -1, None
        self.planner: Planner | None = None
        self.asking: Asking | None = None
        if getattr(self.controller.policy, "deliberates", False):
            policy = cast("Deliberating", self.controller.policy)
            self.planner = Planner(policy, drive=self.drive, deadline=self.deadline)
            self.asking = Asking(self)
            self.add(self.planner)
        # At its deadline the planner's fallback answers, and the loop may be a little late.
        patience = 0.0 if self.asking is None else PATIENCE
        latest = None if self.deadline is None else round((self.deadline + patience) * 1e9)
        self.output = Output(self.controller, latest, self._refuses)

    # -- Commands ------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin deciding at epoch 0; a policy over beliefs begins from the initial belief."""
        self._command("start")

    def stop(self) -> None:
        """Publish nothing more until started again."""
        self._command("stop")

    def reset(self) -> None:
        """Begin a new episode now: epoch 0, the initial belief."""
        self._command("reset")

    def resume(self) -> None:
        """Begin deciding at epoch 0, from the belief as it is."""
        self._command("resume")

    def _command(self, command: Literal["start", "stop", "reset", "resume"]) -> None:
        self.owner.channel("control", Control).publish(Control(self.runtime.now(), command))

    def command(self, command: Literal["start", "stop", "resume"]) -> None:
        """Start, stop or resume, as what is above or around it brings about: it is nobody's input."""
        self.owner.channel("control", Control).derive(Control(self.runtime.now(), command))

    @property
    def belief(self) -> Vector | None:
        """The present belief (S numbers, read-only), or None for a policy over states or a plan."""
        return self.controller.belief

    @property
    def latency(self) -> Histogram:
        """The histogram of times from stimulus to decision."""
        return self.output.latency

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen; deciding begins with `start`."""
        self.output.open(self)
        # Publishing is the last thing that its own handlers do; a team has more to do behind it.
        shared = self.source.shared
        self._tell = self.output.publish if shared else self.output.publish_last
        self._acts = self.takes_states and not shared and self.asking is None
        self.running = False
        self.state = None
        self.ticks.open()
        if self.asking is not None:
            self.asking.open()
        self.source.open()

    def on_stop(self) -> None:
        """Decide nothing more."""
        self.running = False

    def on_control(self, control: Control) -> None:
        """Start, stop, or begin another episode."""
        command = control.command
        if command == "stop":
            self.pause()
        elif command == "reset":
            self.begin_episode()
            if self.running:
                self._begin(control.time, command)
        elif command == "decide_again":
            self.source.decide_again(control.time)
        elif command != "release" and not self.running and self.source.may_begin:
            self.begin_episode(keep=command == "resume")
            self.ticks.begin()
            if self.source.may_decide:
                self.running = True
                self._begin(control.time, command)

    def _begin(self, time: int, command: str) -> None:
        """Decide on a command, where that is possible now."""
        if self.blind:
            if self.guard is not None:
                self.guard.blind(time)
        elif self.event_driven:
            self.decide(time, command)

    def pause(self) -> None:
        """Decide no more until started again."""
        self.running = False
        self.ticks.end()

    @property
    def acted(self) -> int | None:
        """The last action that was published in this episode, or None."""
        return self.output.acted

    @property
    def blind(self) -> bool:
        """Whether it decides on states, and knows none."""
        return self.takes_states and self.state is None

    def withdraw(self) -> None:
        """Heed no answer of the planner that is open."""
        if self.asking is not None:
            self.asking.stimulus = None

    def reopen(self, kinds: frozenset[str], time: int) -> None:
        """Tell that causes of a safe mode are gone."""
        if self.guard is not None:
            self.guard.reopen(kinds, time)

    def begin_episode(self, *, keep: bool = False) -> None:
        """Start an episode; a question open from the one before decides nothing in it."""
        self.withdraw()
        self.ticks.forget()
        self.output.acted = None
        self.decided = -1, None
        self.controller.reset(keep=keep)

    # -- Stimuli -------------------------------------------------------------------------------------------------

    def on_state(self, state: State) -> None:
        """Decide on a state, where events make decisions; else keep it for the next tick."""
        # Hot path, as all that a state leads to up to the action's message.
        told: Any = state  # publishers may count states by numpy's integers
        given = told.index
        index: int | None = given if given.__class__ is int or given is None else operator.index(given)
        self.state = index
        if index is None or not self.running or not self.event_driven:
            if self.guard is not None and (index is None or (not self.running and self.source.held)):
                self._on_state_aside(state)
            return
        if self._acts and self.output.act_last(index, state.time):
            return
        cause = "episode" if self.controller.epoch >= self._last_epoch else "state"
        if self.asking is not None:
            self.decide(state.time, cause)
            return
        try:
            step = self._see(index)
        except ModelError as error:
            self._undecided(error, state.time)
        else:
            self._tell(step, state.time, cause, None, index)

    def _on_state_aside(self, state: State) -> None:
        """Take a state on which nothing is decided: it is unknown, or the ensemble is safe."""
        assert self.guard is not None
        if state.index is None:
            if not self.source.catching_up:
                self.guard.blind(state.time)
        else:
            self.guard.reopen(AT_KNOWN, state.time)

    def on_observation(self, observation: Observation) -> None:
        """Decide on an observation, where events make decisions; else keep it for the next tick."""
        if not self.running:
            self.source.observe_aside(observation)
            return
        if not self.event_driven:
            self.ticks.keep(observation)
        elif self.controller.epoch and self.controller.over:
            self.begin_episode()
            self.decide(observation.time, "episode")
        else:
            symbol = symbol_of(observation)
            if not self.advance(symbol, observation.time):
                return
            if self.controller.problem is not None and self.source.held:
                self.source.answer_later("observation", symbol)
            else:
                self.decide(observation.time, "observation", symbol, tell=self._tell)

    # -- Decisions -----------------------------------------------------------------------------------------------

    def advance(self, observation: Observed, time: int) -> bool:
        """Hand the controller an observation; report one that is refused or impossible.

        Returns:
            Whether it was taken in, and not refused: nothing is decided as if it had been.
        """
        controller = self.controller
        if controller.given:
            observation = None
        try:
            controller.advance(observation)
        except (ModelError, TypeError) as error:
            self.report("observation", f"{text_of(error)}; it is not taken in", time=time)
            return False
        if controller.problem is not None:
            fault = Fault(time, self.path, "impossible_observation", controller.problem)
            if controller.on_impossible == "safe_action":
                self._alarm(fault)
            else:
                self.runtime.faults.publish(fault)
        return True

    def _alarm(self, fault: Fault) -> bool:
        """Report a fault that endangers the ensemble; return whether that makes it safe."""
        self.alarms += 1
        if self.guard is not None and not self.source.catching_up:
            return self.guard.alarm(fault)
        self.runtime.faults.publish(fault)
        return False

    def decide(
        self,
        time: int,
        cause: str,
        observation: Observed = None,
        *,
        tell: Callable[[Step, int, str, Observed, int | None], None] | None = None,
    ) -> None:
        """Let the controller choose, or ask the planner, and publish the chosen action.

        Args:
            time: That of the stimulus.
            cause: The kind of stimulus, as in `Decision`.
            observation: The observation that is answered, if any.
            tell: Publishes it; by default it is not the last thing that is done.
        """
        state = self.state
        try:
            if self.asking is not None:
                self.asking.ask(time, cause, observation, state)
                return
            step = self.controller.decide() if state is None else self._see(state)
        except ModelError as error:
            self._undecided(error, time)
            return
        (self.output.publish if tell is None else tell)(step, time, cause, observation, state)

    def _undecided(self, error: ModelError, time: int) -> None:
        """Report that nothing could be chosen; an error in a policy's code is a failure where nothing goes safe."""
        raised = isinstance(error, PolicyError)
        fault = Fault(time, self.path, "state" if self.takes_states and not raised else "policy", text_of(error))
        if not self._alarm(fault) and raised:
            raise error

    def _refuses(self, step: Step, latency: int, time: int) -> bool:
        """Report a decision that comes too late; return whether it is not carried out."""
        if not self.source.shared:  # the action published before goes on
            self.controller.last_action = self.output.acted
        if self.late(latency, time) and not self.source.shared:
            return True
        self.controller.last_action = step.action
        return False

    def late(self, latency: int, time: int) -> bool:
        """Report a missed deadline; return whether the ensemble is safe in place of the decided action."""
        text = f"a decision came {latency / 1e6:.3f} ms after its stimulus; the deadline is {self.deadline} s"
        return self._alarm(Fault(time, self.path, "deadline", text))

    def statistics(self) -> ControlStatistics:
        """Return the layer's counts so far."""
        return ControlStatistics(
            **msgspec.structs.asdict(super().statistics()),
            decisions=self.decisions,
            impossible=self.controller.impossible,
            superseded=self.ticks.superseded,
            undecided=self.ticks.undecided,
            missed=self.ticks.missed,
            latency=self.latency,
        )

    @property
    def decisions(self) -> int:
        """The number of actions published."""
        return self.output.decisions


class Ticks:
    """Decides at a fixed rate, on the latest state or observation; while another drive decides it does nothing.

    Args:
        control: The layer.
        drive: Its drive.
        unseen: What a tick without a new observation means: ``predict``, ``repeat``, or an observation's index.

    Attributes:
        superseded: Observations in whose place a newer one was taken.
        undecided: Ticks without a known state.
        missed: Ticks that the event loop came too late for.
    """

    def __init__(self, control: ControlLayer, drive: Drive, unseen: int | Literal["predict", "repeat"]) -> None:
        self.superseded = self.undecided = self.missed = 0
        self._control = control
        self._rate = drive.rate if isinstance(drive, FixedRate) else None
        self._unseen = unseen
        self._ticker: Ticker | None = None
        self._kept: Observation | None = None
        self._last: Observed = None

    def open(self) -> None:
        """Begin a life of the layer, without a ticker."""
        self._ticker = None
        self._heard = self._control.owner.channel("tick", Tick)

    def begin(self) -> None:
        """Tick from now on, where the drive says so."""
        if self._rate is not None and self._ticker is None:
            self._ticker = self._control.every(self._rate, self._on_tick)

    def end(self) -> None:
        """Tick no more."""
        if self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    def forget(self) -> None:
        """Forget all observations: an episode begins."""
        self._kept = self._last = None

    def keep(self, observation: Observation, *, counts: bool = True) -> None:
        """Keep an observation for the next tick; where another waited, count that, unless nothing is decided now."""
        self.superseded += counts and self._kept is not None
        self._kept = observation

    def kept(self) -> Observation | None:
        """Return the observation that was kept, which is then kept no more."""
        observation, self._kept = self._kept, None
        return observation

    def advance(self, symbol: Observed, time: int) -> bool:
        """Hand the controller an observation, to be repeated; return whether it was taken in."""
        control = self._control
        taken = control.advance(symbol, time)
        if taken:
            self._last = None if control.controller.given else symbol
        return taken

    def _on_tick(self, tick: Tick) -> None:
        control = self._control
        if self._heard.heard:
            self._heard.emit(tick)
        if not control.running:
            control.source.tick_aside(tick)  # which may end a safe mode
        if control.running:
            self._tick(control, tick)

    def _tick(self, control: ControlLayer, tick: Tick) -> None:
        cause, symbol = "tick", None
        control.output.overdue = 0
        if tick.missed:
            assert self._rate is not None
            self.missed += tick.missed
            control.output.overdue = round(tick.missed * 1e9 / self._rate)
            control.output.record(tick.late + control.output.overdue)
        observation = self.kept()
        if control.controller.over:
            control.begin_episode()
            cause = "episode"
        elif not control.takes_states and control.controller.last_action is not None:
            if observation is not None:
                symbol = symbol_of(observation)
            elif self._unseen == "repeat":
                symbol = self._last
            elif self._unseen != "predict":
                symbol = self._unseen
            symbol = self._taken_in(control, symbol, tick.time)
            if not control.running:  # any more, for the observation is impossible
                return
        if control.blind:
            self.undecided += 1
        else:
            control.decide(tick.time, cause, symbol)

    def _taken_in(self, control: ControlLayer, symbol: Observed, time: int) -> Observed:
        """Advance at a tick; return the observation, None where there is none or it was refused: time has passed."""
        if control.controller.given:
            symbol = None
        if not self.advance(symbol, time) and symbol is not None:
            symbol = None
            self.advance(None, time)
        return symbol


def unobserved(given: str, space: Space | None) -> int | Literal["predict", "repeat"]:
    """Return the meaning of a tick without a new observation: itself, or the index of the observation that it names.

    Raises:
        ConfigError: If it is nothing of these.
    """
    if given == "predict":
        return "predict"
    if given == "repeat":
        return "repeat"
    if space is None:
        raise ConfigError(
            f"on_no_observation names {given!r}, but there is no model with observations", key="on_no_observation"
        )
    try:
        return int(space.index(given))
    except ModelError as error:
        raise ConfigError(
            f"on_no_observation is 'predict', 'repeat' or an observation's name: {error}", key="on_no_observation"
        ) from None
