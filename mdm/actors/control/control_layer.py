"""The control layer: a controller with a drive, messages and faults around it.

Event-driven and fixed-rate control share one path from a stimulus to a decision; only the trigger differs. Where the
policy's answer comes later, as a search's does, the layer asks its planner and decides when the answer is there.
"""

from __future__ import annotations

import operator
import sys
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Protocol, Unpack, cast

import msgspec

from mdm.actors.control.drive import FixedRate, OnEvent, drive_of, unobserved
from mdm.actors.control.output import Output
from mdm.actors.control.planner import PATIENCE, Planner
from mdm.actors.layer import Layer
from mdm.actors.modes import AT_INPUT, AT_KNOWN, AT_STIMULUS
from mdm.actors.options import ControlOptions
from mdm.controller import Controller
from mdm.errors import ConfigError, Error, ModelError
from mdm.messages import Action, Answer, Belief, Control, Fault, Observation, Question, State, Tick
from mdm.options import check_options
from mdm.runtime import ActorStatistics, Histogram
from mdm.runtime.clock import check_seconds
from mdm.runtime.supervision import text_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.actors.control.output import Observed
    from mdm.controller import Step
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.matrices import Vector
    from mdm.policies import Deliberating
    from mdm.runtime import Ticker

__all__ = ["ControlLayer", "ControlStatistics"]

_opened = msgspec.msgpack.Decoder(tuple[bytes, bool, int | None, int | None]).decode
"""What a snapshot holds: that of the controller, whether it runs, the state, and the action that was published."""


class Guard(Protocol):
    """Whom a control layer tells what endangers it, and who decides whether that makes the ensemble safe."""

    @property
    def deciding(self) -> bool:
        """Whether the layer may decide."""

    @property
    def returning(self) -> bool:
        """Whether it may not now, and may when a safe mode is over."""

    def alarm(self, fault: Fault) -> bool:
        """Report a fault; return whether nothing that was or is decided may start."""

    def reopen(self, kinds: frozenset[str], time: int) -> None:
        """Take causes of a safe mode as gone."""

    def blind(self, time: int) -> None:
        """Take it that no state is known."""


class Lead(Protocol):
    """Who tells a control layer what to decide on, in place of its own channels: a team, for which it is one copy."""

    def command(self, command: Literal["start", "stop", "reset", "resume"]) -> None:
        """Take what somebody asks of the ensemble here: it concerns the whole team."""


_OWN = ("drive", "on_no_observation", "deadline")


class ControlStatistics(ActorStatistics, frozen=True):
    """What a control layer has decided: actions published, observations that were impossible or superseded.

    ``undecided`` counts ticks without a known state, ``missed`` those that the event loop came too late for.
    ``latency`` is from stimulus to decision, and after missed ticks once more from the first of them.
    """

    decisions: int
    impossible: int
    superseded: int
    undecided: int
    missed: int
    latency: Histogram


class ControlLayer(Layer):
    """Drives a `Controller`: tells it what is seen or observed, and publishes what it decides.

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
        guard: Whom it tells what endangers it; None where it stands alone.
        lead: Who calls `take` with what it decides on; None where it listens to channels. It then goes on deciding in
            safe modes, as the team's other copies do, and only what is decided is not done.
        controller: What decides.
        output: What publishes it.
        planner: Who searches, where the policy's answer comes later; else None.
    """

    # What each decision reads or writes, close together: among many ensembles what is far apart is not in the cache.
    __slots__ = (
        "_acts",
        "_event_driven",
        "_held",
        "_last_epoch",
        "_last_observation",
        "_see",
        "_state",
        "_tell",
        "controller",
        "output",
        "planner",
        "running",
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
        check_options(options, ControlOptions)
        own: Any = {name: options[name] for name in _OWN if name in options}  # type: ignore[literal-required]
        rest: Any = {name: value for name, value in options.items() if name not in _OWN}
        self.controller = Controller(policy, model, agent=agent, **rest)
        self._another = partial(Controller, policy, model, agent=agent, **rest)
        self.drive = drive_of(own.get("drive"))
        if isinstance(self.drive, FixedRate):
            self.controller.step_by_step()
        deadline = own.get("deadline")
        if deadline is not None:
            check_seconds(deadline, "a deadline", key="deadline")
        self.deadline = None if deadline is None else float(deadline)
        unseen = own.get("on_no_observation", "predict")
        self._no_observation = unobserved(unseen, self.controller.symbols.observation_space)
        self.on_no_observation: str = unseen
        self.guard: Guard | None = None
        self.lead: Lead | None = None
        self.running = False
        self._held = False
        self._alarmed = self._taking = False
        self._catching_up = False
        self._informed = False
        self.superseded = 0
        self.undecided = 0
        self.missed = 0
        self._takes_states = self.controller.takes == "state"
        self._event_driven = isinstance(self.drive, OnEvent)
        self._see = self.controller.see
        self._last_epoch = sys.maxsize if self.controller.horizon is None else self.controller.horizon
        self._state: int | None = None
        self._observation: Observation | None = None
        self._last_observation: Observed = None
        self._ticker: Ticker | None = None
        self.planner: Planner | None = None
        self._question = 0
        self._open: tuple[int, str, Observed, int | None] | None = None
        self._moved = False
        self._unanswered: tuple[str, Observed] = ("release", None)
        if getattr(self.controller.policy, "deliberates", False):
            self.planner = Planner(
                cast("Deliberating", self.controller.policy), drive=self.drive, deadline=self.deadline
            )
            self.add(self.planner)
        # At its deadline the planner's fallback answers, and the loop may be a little late.
        patience = 0.0 if self.planner is None else PATIENCE
        latest = None if self.deadline is None else round((self.deadline + patience) * 1e9)
        self.output = Output(self.controller, latest, self._refuses)

    # -- Checks --------------------------------------------------------------------------------------------------

    def problems(self) -> Iterator[ConfigError]:
        """Yield nothing: a control layer that could be built can start."""
        yield from ()

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
        self.owner.channel("control", Control).publish(Control(self.runtime.clock.now(), command))

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
        # What a handler of its own does last; whoever leads the layer has more to do behind it.
        self._tell = self.output.publish_last if self.lead is None else self.output.publish
        self._acts = self._takes_states and self.lead is None and self.planner is None
        self.running = self._held = False
        self._ticker = None
        self._state = None
        self._open = None
        if self.planner is not None:
            self._questions = channel("question", Question)
            self.subscribe(channel("answer", Answer), self._on_answer)
        if self.lead is not None:
            for name in ("external_belief", "initial_belief"):
                self.subscribe(channel(name, Belief, retain=name == "initial_belief"), self._refuse_own_belief)
            return
        if self._takes_states:
            self.subscribe(channel("state", State, retain=True), self._on_state)
        else:
            self.subscribe(channel("observation", Observation), self._on_observation)
            self.subscribe(channel("external_belief", Belief), self._on_external_belief)
            self.subscribe(channel("initial_belief", Belief, retain=True), self._on_initial_belief)
        self.subscribe(channel("control", Control), self._on_control)

    def on_stop(self) -> None:
        """Decide nothing more."""
        self.running = False

    def take(self, message: Control | State | Observation) -> None:
        """Decide on a message now, in this call, as if it had come on its channel; for whoever leads the layer."""
        if isinstance(message, Control):
            self._on_control(message)
            return
        self._alarmed = False
        self._taking = True  # what is decided now need not be said twice where it ends a safe mode
        if isinstance(message, State):
            self._on_state(message)
        else:
            self._on_observation(message)
        if self.guard is not None and not self._alarmed and (self._state is not None or not self._takes_states):
            self.guard.reopen(AT_KNOWN, message.time)
        self._taking = False

    def _on_control(self, control: Control) -> None:
        command = control.command
        if command == "stop":
            self.pause()
        elif command == "reset":
            self._begin_episode()
            if self.running:
                self._begin(control.time, command)
        elif command != "release" and not self.running and self._may_begin:
            self._begin_episode(keep=command == "resume")
            if isinstance(self.drive, FixedRate) and self._ticker is None:
                self._ticker = self.every(self.drive.rate, self._on_tick)
            if self.guard is None or self.guard.deciding or self.lead is not None:
                self.running = True
                self._begin(control.time, command)

    @property
    def _may_begin(self) -> bool:
        """Whether an episode may begin; that of a team does, whatever the mode of this agent."""
        guard = self.guard
        return guard is None or guard.deciding or guard.returning or self.lead is not None

    def _begin(self, time: int, command: str) -> None:
        """Decide on a command, where that is possible now."""
        if self.blind:
            if self.guard is not None:
                self.guard.blind(time)
        elif self._event_driven:
            self._decide(time, command, state=self._state)

    def pause(self) -> None:
        """Decide no more until started again."""
        self.running = False
        if self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    @property
    def event_driven(self) -> bool:
        """Whether it decides on each input, and not at ticks."""
        return self._event_driven

    @property
    def acted(self) -> int | None:
        """The last action that was published in this episode, or None."""
        return self.output.acted

    @property
    def blind(self) -> bool:
        """Whether it decides on states, and knows none."""
        return self._takes_states and self._state is None

    # -- Safe modes ----------------------------------------------------------------------------------------------

    def hold(self, done: int | None) -> None:
        """Decide nothing while the ensemble is safe.

        Args:
            done: The safe action, where it is one of the model's: the belief then goes by it.
        """
        if self.lead is not None:
            return
        self.running = False
        self._held = True
        self._open = None
        self._informed = done is not None and not self._takes_states
        self._moved = False
        self._unanswered = ("release", None)
        if done is not None:
            self.controller.last_action = self.output.acted = done

    def let_go(self) -> None:
        """Take it that the ensemble is stopped."""
        if self.lead is None:
            self.running = self._held = False

    def go_on(self, time: int, *, anew: bool, predict: bool) -> None:
        """Decide again after a safe mode.

        Args:
            time: When.
            anew: Begin a new episode: nobody knows what the safe action has done to the state.
            predict: Time has passed, of which the belief does not know.
        """
        if self.lead is not None:
            if not self._taking:
                self.repeat(time)
            return
        self._held, self.running = False, True
        controller = self.controller
        if not self._takes_states:
            if (anew and not controller.given) or controller.over:
                self._begin_episode()
                self._unanswered = ("release", None)
            elif predict and self._event_driven and not self._moved:
                self._advance(None, time)
        if self.running and self._event_driven and not self.blind:
            cause, observation = self._unanswered
            self._decide(time, cause, observation, state=self._state)

    def catch_up(self, time: int, *, over: bool) -> None:
        """Decide what others have decided long ago, of which nothing is done; when that is over, do what is done now.

        Args:
            time: When.
            over: Whether it is.
        """
        self._catching_up = not over
        self.output.mute(muted=not over)
        if over and self.running and self.blind and self.guard is not None:
            self.guard.blind(time)
        elif over:
            self.repeat(time)

    def carry_out(self, action: Action, belief: Vector | None = None) -> None:
        """Publish what was decided elsewhere, as if it had been decided here; on a belief, where one is known."""
        self._alarmed = False
        self._taking = True
        self.running = True
        self.output.publish_foreign(action, belief)
        if self.guard is not None:
            self.guard.reopen(AT_KNOWN | {"lost_controller"}, action.time)
        self._taking = False

    def announce(self, step: Step, time: int, cause: str, observation: Observed = None) -> None:
        """Publish what whoever leads this layer has had its controller decide, as if it had come of an input here."""
        self._alarmed = False
        self._taking = True
        self.output.publish(step, time, cause, observation, None)
        if self.guard is not None and not self._alarmed:
            self.guard.reopen(AT_KNOWN, time)
        self._taking = False

    def another(self) -> Controller:
        """Return another controller of the same policy, model and options."""
        return self._another()

    def repeat(self, time: int) -> None:
        """Publish the present action once more, where there is one."""
        if self.running:
            self.output.repeat(time, self._state)

    @property
    def asks(self) -> bool:
        """Whether it waits for its planner's answer."""
        return self._open is not None

    def decide_again(self, time: int) -> None:
        """Decide once more on what is known, as one decision more of the episode, where inputs alone have it decide.

        Nothing was observed, so that no belief is updated by it. What a team has decided is done once more.
        """
        if self.lead is not None:
            self.repeat(time)
        elif self.running and self._event_driven and not self.blind and self._open is None:
            cause = "again"
            if self.controller.over:
                cause = "episode"
                self._begin_episode()
            self._decide(time, cause, state=self._state)

    def snapshot(self) -> bytes:
        """Return what it takes to go on from here elsewhere; for whoever leads the layer."""
        held = [self.controller.snapshot(), self.running, self._state, self.output.acted]
        return msgspec.msgpack.encode(held)

    def restore(self, snapshot: bytes) -> None:
        """Go on from a snapshot of a layer of the same configuration.

        Raises:
            ModelError: If it is invalid or of another configuration; the layer is unchanged.
        """
        try:
            controller, running, state, acted = _opened(snapshot)
        except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
            raise ModelError(f"this is not a snapshot of a control layer: {error}") from None
        for what, index, size in (
            ("state", state, self.controller.symbols.num_states),
            ("action", acted, self.controller.policy.num_actions),
        ):
            if index is not None and size is not None and not 0 <= index < size:
                raise ModelError(f"this is not a snapshot of a control layer: there is no {what} {index} of {size}")
        self.controller.restore(controller)
        self.running, self._state, self.output.acted = running, state, acted

    def _reopen(self, kinds: frozenset[str], time: int) -> None:
        if self.guard is not None:
            self.guard.reopen(kinds, time)

    def _observe_safely(self, observation: Observation) -> None:
        """Take an observation in while the ensemble is safe: into the belief, where it knows what is done."""
        if not self._event_driven:
            self._observation = observation
        elif self._informed and not self.controller.over:
            self._moved = True
            self._advance(_symbol(observation), observation.time)
        self._reopen(AT_INPUT, observation.time)

    def _tick_safely(self, tick: Tick) -> bool:
        """Take a tick while the ensemble is safe; return whether it may decide again."""
        self._reopen(AT_STIMULUS, tick.time)
        if not self.running and self._informed and not self.controller.over:
            observation, self._observation = self._observation, None
            symbol: Observed = None
            if observation is not None:
                symbol = _symbol(observation)
            self._advance(symbol, tick.time)
        return self.running

    def _begin_episode(self, *, keep: bool = False) -> None:
        """Start an episode; what was asked in the one before decides nothing in it."""
        self._open = None
        self._observation = None
        self._last_observation = None
        self.output.acted = None
        self.controller.reset(keep=keep)

    # -- Stimuli -------------------------------------------------------------------------------------------------

    def _on_state(self, state: State) -> None:
        # Hot path, as all that a state leads to up to the action's message.
        told: Any = state  # whoever publishes states may count them by numpy's integers
        given = told.index
        index: int | None = given if given.__class__ is int or given is None else operator.index(given)
        self._state = index
        if index is None or not self.running or not self._event_driven:
            if self.guard is not None and (index is None or self._held):
                self._on_state_aside(state)
            return
        if self._acts and self.output.act_last(index, state.time):
            return
        cause = "episode" if self.controller.epoch >= self._last_epoch else "state"
        if self.planner is not None:
            self._decide(state.time, cause, state=index)
            return
        try:
            step = self._see(index)
        except ModelError as error:
            self._alarm(Fault(state.time, self.path, "state", text_of(error)))
        else:
            self._tell(step, state.time, cause, None, index)

    def _on_state_aside(self, state: State) -> None:
        """Take a state on which nothing is decided: it is unknown, or the ensemble is safe."""
        assert self.guard is not None
        if state.index is None:
            if not self._catching_up:
                self.guard.blind(state.time)
        else:
            self.guard.reopen(AT_KNOWN, state.time)

    def _on_observation(self, observation: Observation) -> None:
        if not self.running:
            if self._held:
                self._observe_safely(observation)
            return
        if not self._event_driven:
            if self._observation is not None:
                self.superseded += 1
            self._observation = observation
        elif self.controller.epoch and self.controller.over:
            self._begin_episode()
            self._decide(observation.time, "episode")
        else:
            symbol = _symbol(observation)
            self._advance(symbol, observation.time)
            if self._held:  # by now, for it was impossible
                self._unanswered = ("observation", symbol)
            else:
                self._decide(observation.time, "observation", symbol, tell=self._tell)

    def _on_tick(self, tick: Tick) -> None:
        if not self.running and not self._tick_safely(tick):
            return
        cause, symbol = "tick", None
        self.output.overdue = 0
        if tick.missed:
            assert isinstance(self.drive, FixedRate)
            self.missed += tick.missed
            self.output.overdue = round(tick.missed * 1e9 / self.drive.rate)
            self.output.record(tick.late + self.output.overdue)
        observation, self._observation = self._observation, None
        if self.controller.over:
            self._begin_episode()
            cause = "episode"
        elif not self._takes_states and self.controller.last_action is not None:
            if observation is not None:
                symbol = _symbol(observation)
            elif self._no_observation == "repeat":
                symbol = self._last_observation
            elif self._no_observation != "predict":
                symbol = self._no_observation
            symbol = self._advance(symbol, tick.time)
            if self._held:  # by now, for what was observed is impossible
                return
        if self._takes_states and self._state is None:
            self.undecided += 1
        else:
            self._decide(tick.time, cause, symbol, state=self._state)

    def _on_external_belief(self, belief: Belief) -> None:
        if not self.running and not self._held:
            return
        over = self.controller.over
        try:
            self.controller.believe(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            self._refuse_belief("external_belief", belief, error)
            return
        self._observation = None
        if self._held:
            self._reopen(AT_INPUT, belief.time)
        elif self._event_driven:
            self._decide(belief.time, "episode" if over else "belief")
        elif self._open is not None:  # a tick's search begins anew from there
            time, cause, observation, state = self._open
            self._decide(time, cause, observation, state=state)

    def _on_initial_belief(self, belief: Belief) -> None:
        try:
            self.controller.begin_from(belief.probabilities)
        except (Error, ValueError, TypeError) as error:
            self._refuse_belief("initial_belief", belief, error)

    def _refuse_own_belief(self, belief: Belief) -> None:
        self.report("belief", "refused a belief from outside: the team's agents share theirs", time=belief.time)

    def _refuse_belief(self, channel: str, belief: Belief, error: Exception) -> None:
        self.report("belief", f"refused a belief on {self.owner.path}/{channel}: {text_of(error)}", time=belief.time)

    # -- Decisions -----------------------------------------------------------------------------------------------

    def _advance(self, observation: Observed, time: int) -> Observed:
        """Tell the controller what was observed; report what is no observation, or an impossible one.

        Returns:
            What was taken in; None where nothing was.
        """
        controller = self.controller
        if controller.given:
            observation = None
        try:
            controller.advance(observation)
        except (ModelError, TypeError) as error:
            self.report("observation", text_of(error), time=time)
            return observation
        self._last_observation = observation
        if controller.problem is not None:
            fault = Fault(time, self.path, "impossible_observation", controller.problem)
            if controller.on_impossible == "safe_action":
                self._alarm(fault)
            else:
                self.runtime.faults.publish(fault)
        return observation

    def _alarm(self, fault: Fault) -> bool:
        """Report what endangers the ensemble; return whether that makes it safe."""
        self._alarmed = True
        if self.guard is not None and not self._catching_up:
            return self.guard.alarm(fault)
        self.runtime.faults.publish(fault)
        return False

    def _decide(
        self,
        time: int,
        cause: str,
        observation: Observed = None,
        *,
        state: int | None = None,
        tell: Callable[[Step, int, str, Observed, int | None], None] | None = None,
    ) -> None:
        """Let the controller choose, or ask the planner, and publish what was chosen."""
        try:
            if self.planner is not None:
                self._deliberate(time, cause, observation, state)
                return
            step = self.controller.decide() if state is None else self._see(state)
        except ModelError as error:
            self._alarm(Fault(time, self.path, "state" if self._takes_states else "policy", text_of(error)))
            return
        (self.output.publish if tell is None else tell)(step, time, cause, observation, state)

    def _deliberate(self, time: int, cause: str, observation: Observed, state: int | None) -> None:
        """Ask the planner; a question that is still open is asked no more, and the answer decides for both."""
        controller = self.controller
        if state is not None:
            if controller.over:
                self._begin_episode()
            controller.advance(controller.symbols.state_index(state))
        self._question += 1
        self._open = (time, cause, observation, state)
        self._questions.publish(
            Question(time, self._question, controller.information.current if state is None else state)
        )

    def _on_answer(self, answer: Answer) -> None:
        if self._open is None or answer.number != self._question or not self.running:
            return
        (time, cause, observation, state), self._open = self._open, None
        if answer.action is None:
            self._late(self._now() - time, time)
            return
        self.output.publish(self.controller.decide(answer.action), time, cause, observation, state)

    def _refuses(self, step: Step, latency: int, time: int) -> bool:
        """Report a decision that comes too late; return whether it is not carried out."""
        if self.lead is None:  # what was done before is still what is done
            self.controller.last_action = self.output.acted
        if self._late(latency, time) and self.lead is None:
            return True
        self.controller.last_action = step.action
        return False

    def _late(self, latency: int, time: int) -> bool:
        """Report a missed deadline; return whether the ensemble is safe in place of doing what was decided."""
        text = f"a decision came {latency / 1e6:.3f} ms after its stimulus; the deadline is {self.deadline} s"
        return self._alarm(Fault(time, self.path, "deadline", text))

    def statistics(self) -> ControlStatistics:
        """Return what the layer has decided so far."""
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


def _symbol(observation: Observation) -> Observed:
    """Return what was observed: its index, or its components where one is missing."""
    told: Any = observation  # whose index may be one of numpy's integers
    index = told.index
    if index is None:
        return observation.values
    found: int = index if index.__class__ is int else operator.index(index)
    return found
