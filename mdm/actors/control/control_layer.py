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

from mdm.actors.control.output import Output
from mdm.actors.control.planner import PATIENCE, Planner
from mdm.actors.control.source import OwnChannels
from mdm.actors.layer import Layer
from mdm.actors.options import ControlOptions, ControlSettings, FixedRate, OnEvent, drive_of
from mdm.actors.safety.modes import AT_INPUT, AT_KNOWN
from mdm.controller import Controller
from mdm.errors import ConfigError, Error, ModelError, PolicyError
from mdm.messages import Answer, Belief, Control, Fault, Observation, Question, State, Tick
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

__all__ = ["ControlLayer", "ControlStatistics", "unobserved"]


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
        alarms: How often it has told of something that endangers the ensemble.
        controller: The controller that decides.
        output: Publishes its decisions.
        planner: Searches for an answer, where the policy's comes later; else None.
    """

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = (
        "_acts",
        "_last_epoch",
        "_last_observation",
        "_see",
        "_tell",
        "controller",
        "event_driven",
        "output",
        "planner",
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
        self._another = partial(Controller, policy, model, agent=agent, **rest)
        self.drive = drive_of(settings.drive)
        if isinstance(self.drive, FixedRate):
            self.controller.step_by_step()
        self.deadline = settings.deadline
        self.on_no_observation = settings.on_no_observation
        self._no_observation = unobserved(self.on_no_observation, self.controller.symbols.observation_space)
        self.guard: Safety | None = None
        self.source: Source = OwnChannels(self)
        self.running = False
        self.alarms = 0
        self.superseded = 0
        self.undecided = 0
        self.missed = 0
        self.takes_states = self.controller.takes == "state"
        self.event_driven = isinstance(self.drive, OnEvent)
        self._see = self.controller.see
        self._last_epoch = sys.maxsize if self.controller.horizon is None else self.controller.horizon
        self.state: int | None = None
        self._observation: Observation | None = None
        self._last_observation: Observed = None
        self._ticker: Ticker | None = None
        self.planner: Planner | None = None
        self._question = 0
        self._open: tuple[int, str, Observed, int | None] | None = None
        if getattr(self.controller.policy, "deliberates", False):
            self.planner = Planner(
                cast("Deliberating", self.controller.policy), drive=self.drive, deadline=self.deadline
            )
            self.add(self.planner)
        # At its deadline the planner's fallback answers, and the loop may be a little late.
        patience = 0.0 if self.planner is None else PATIENCE
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

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Listen; deciding begins with `start`."""
        channel = self.owner.channel
        self._now = self.runtime.clock.reader()
        self.output.open(self)
        # Publishing is the last thing that its own handlers do; a team has more to do behind it.
        shared = self.source.shared
        self._tell = self.output.publish if shared else self.output.publish_last
        self._acts = self.takes_states and not shared and self.planner is None
        self.running = False
        self._ticker = None
        self.state = None
        self._open = None
        self._ticks = channel("tick", Tick)
        if self.planner is not None:
            self._questions = channel("question", Question)
            self.subscribe(channel("answer", Answer), self._on_answer)
        self.source.open()

    def on_stop(self) -> None:
        """Decide nothing more."""
        self.running = False

    def on_control(self, control: Control) -> None:
        """Start, stop, or begin anew."""
        command = control.command
        if command == "stop":
            self.pause()
        elif command == "reset":
            self.begin_episode()
            if self.running:
                self._begin(control.time, command)
        elif command != "release" and not self.running and self.source.may_begin:
            self.begin_episode(keep=command == "resume")
            if isinstance(self.drive, FixedRate) and self._ticker is None:
                self._ticker = self.every(self.drive.rate, self._on_tick)
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
        if self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    @property
    def acted(self) -> int | None:
        """The last action that was published in this episode, or None."""
        return self.output.acted

    @property
    def blind(self) -> bool:
        """Whether it decides on states, and knows none."""
        return self.takes_states and self.state is None

    def another(self) -> Controller:
        """Return another controller of the same policy, model and options."""
        return self._another()

    @property
    def asks(self) -> bool:
        """Whether it waits for its planner's answer."""
        return self._open is not None

    def withdraw(self) -> None:
        """Heed no answer of the planner that is open."""
        self._open = None

    def keep(self, observation: Observation) -> None:
        """Keep an observation for the next tick."""
        self._observation = observation

    def kept(self) -> Observation | None:
        """Return the observation that was kept, which is then kept no more."""
        observation, self._observation = self._observation, None
        return observation

    def reopen(self, kinds: frozenset[str], time: int) -> None:
        """Tell that causes of a safe mode are gone."""
        if self.guard is not None:
            self.guard.reopen(kinds, time)

    def begin_episode(self, *, keep: bool = False) -> None:
        """Start an episode; a question open from the one before decides nothing in it."""
        self._open = None
        self._observation = None
        self._last_observation = None
        self.output.acted = None
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
        if self.planner is not None:
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
            if self._observation is not None:
                self.superseded += 1
            self._observation = observation
        elif self.controller.epoch and self.controller.over:
            self.begin_episode()
            self.decide(observation.time, "episode")
        else:
            symbol = self.symbol(observation)
            if not self.advance(symbol, observation.time):
                return
            if self.controller.problem is not None and self.source.held:
                self.source.answer_later("observation", symbol)
            else:
                self.decide(observation.time, "observation", symbol, tell=self._tell)

    def _on_tick(self, tick: Tick) -> None:
        if self._ticks.heard:
            self._ticks.emit(tick)
        if not self.running:
            self.source.tick_aside(tick)  # which may end a safe mode
        if self.running:
            self._tick(tick)

    def _tick(self, tick: Tick) -> None:
        cause, symbol = "tick", None
        self.output.overdue = 0
        if tick.missed:
            assert isinstance(self.drive, FixedRate)
            self.missed += tick.missed
            self.output.overdue = round(tick.missed * 1e9 / self.drive.rate)
            self.output.record(tick.late + self.output.overdue)
        observation = self.kept()
        if self.controller.over:
            self.begin_episode()
            cause = "episode"
        elif not self.takes_states and self.controller.last_action is not None:
            if observation is not None:
                symbol = self.symbol(observation)
            elif self._no_observation == "repeat":
                symbol = self._last_observation
            elif self._no_observation != "predict":
                symbol = self._no_observation
            symbol = self._taken_in(symbol, tick.time)
            if not self.running:  # any more, for the observation is impossible
                return
        if self.takes_states and self.state is None:
            self.undecided += 1
        else:
            self.decide(tick.time, cause, symbol)

    def _taken_in(self, symbol: Observed, time: int) -> Observed:
        """Advance at a tick; return the observation, None where there is none or it was refused: time has passed."""
        if self.controller.given:
            symbol = None
        if not self.advance(symbol, time) and symbol is not None:
            symbol = None
            self.advance(None, time)
        return symbol

    def on_external_belief(self, belief: Belief) -> None:
        """Decide on a belief from outside, in place of the layer's own."""
        if not self.running and not self.source.held:
            return
        over = self.controller.over
        try:
            self.controller.believe(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            self._refuse_belief("external_belief", belief, error)
            return
        self._observation = None
        if self.source.held:
            self.reopen(AT_INPUT, belief.time)
        elif self.event_driven:
            self.decide(belief.time, "episode" if over else "belief")
        elif self._open is not None:  # a tick's search begins anew from there
            time, cause, observation, _ = self._open
            self.decide(time, cause, observation)

    def on_initial_belief(self, belief: Belief) -> None:
        """Take a belief as that from which the next episode begins."""
        try:
            self.controller.begin_from(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            self._refuse_belief("initial_belief", belief, error)

    def _refuse_belief(self, channel: str, belief: Belief, error: Exception) -> None:
        self.report("belief", f"refused a belief on {self.owner.path}/{channel}: {text_of(error)}", time=belief.time)

    @staticmethod
    def symbol(observation: Observation) -> Observed:
        """Return the observed symbol: its index, or its components where one is missing."""
        told: Any = observation  # its index may be one of numpy's integers
        index = told.index
        if index is None:
            return observation.values
        found: int = index if index.__class__ is int else operator.index(index)
        return found

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
        self._last_observation = observation
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
            if self.planner is not None:
                self._deliberate(time, cause, observation, state)
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

    def _deliberate(self, time: int, cause: str, observation: Observed, state: int | None) -> None:
        """Ask the planner; a question that is still open is asked no more, and the answer decides for both."""
        controller = self.controller
        if state is not None:
            if controller.over:
                self.begin_episode()
            controller.advance(controller.symbols.state_index(state))
        self._question += 1
        self.output.waited = self.runtime.dispatcher.waited(time)
        self._open = (time, cause, observation, state)
        self._questions.publish(
            Question(time, self._question, controller.information.current if state is None else state)
        )

    def _on_answer(self, answer: Answer) -> None:
        if self._open is None or answer.number != self._question or not self.running:
            return
        (time, cause, observation, state), self._open = self._open, None
        if answer.action is None:
            self._late(self._now() - time + self.output.waited, time)
            return
        self.output.publish(self.controller.decide(answer.action), time, cause, observation, state)

    def _refuses(self, step: Step, latency: int, time: int) -> bool:
        """Report a decision that comes too late; return whether it is not carried out."""
        if not self.source.shared:  # the action published before goes on
            self.controller.last_action = self.output.acted
        if self._late(latency, time) and not self.source.shared:
            return True
        self.controller.last_action = step.action
        return False

    def _late(self, latency: int, time: int) -> bool:
        """Report a missed deadline; return whether the ensemble is safe in place of the decided action."""
        text = f"a decision came {latency / 1e6:.3f} ms after its stimulus; the deadline is {self.deadline} s"
        return self._alarm(Fault(time, self.path, "deadline", text))

    def statistics(self) -> ControlStatistics:
        """Return the layer's counts so far."""
        return ControlStatistics(
            **msgspec.structs.asdict(super().statistics()),
            decisions=self.decisions,
            impossible=self.controller.impossible,
            superseded=self.superseded,
            undecided=self.undecided,
            missed=self.missed,
            latency=self.latency,
        )

    @property
    def decisions(self) -> int:
        """The number of actions published."""
        return self.output.decisions

    @property
    def latency(self) -> Histogram:
        """The histogram of times from stimulus to decision."""
        return self.output.latency


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
