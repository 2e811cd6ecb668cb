"""The ensemble: the layers that together run one decision process, under one parent actor."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, Unpack

import anyio
import msgspec

from mdm.actors.abstraction.factors import ObservationFactor, StateFactor
from mdm.actors.abstraction.layers import ObservationLayer, StateLayer
from mdm.actors.actions.action_layer import ActionLayer
from mdm.actors.control.control_layer import ControlLayer
from mdm.actors.control.naming import Naming
from mdm.actors.control.source import JointProcess
from mdm.actors.layer import Layer
from mdm.actors.options import ControlSettings, Drive, FixedRate, SafetyOptions, SafetySettings
from mdm.actors.predicates.predicate_manager import PredicateManager
from mdm.actors.safety.liveness import Liveness
from mdm.actors.safety.notes import notes
from mdm.actors.safety.safety import Safety
from mdm.checks import check_flag
from mdm.controller.step import KEPT
from mdm.errors import ConfigError, Error
from mdm.messages import Belief, Cause, Control, ModeName, Observation, State
from mdm.models import Factor, Space
from mdm.runtime import ActorStatistics
from mdm.runtime.channel import Subscription
from mdm.runtime.supervision import text_of
from mdm.symbols import agent_index
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    import numpy.typing as npt

    from mdm.actors.actions.binding import Binding, Callback
    from mdm.actors.control.source import Team
    from mdm.explanation import Case, Explanation
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.space import Symbol
    from mdm.policies import Policy
    from mdm.runtime import Supervision

MOST_LEVELS = 100
"""Levels of a hierarchy."""

_ROOM = 20


class EnsembleStatistics(ActorStatistics, frozen=True):
    """The mode of an ensemble, and why it waits.

    Attributes:
        mode: ``waiting``, ``deciding``, ``safe`` or ``stopped``.
        since: When it came into it, in nanoseconds.
        causes: Why it is safe.
        waiting: The unknown predicates that keep it from deciding, or the pause before it decides again.
        safe_actions: Runs of the safe action.
        idle: For how many seconds it has had nothing to do, in all.
        live: For how many seconds each live action has lived, by name: one that never ends shows here.
    """

    mode: ModeName
    since: int
    causes: tuple[Cause, ...]
    waiting: tuple[str, ...]
    safe_actions: int
    idle: float = 0.0
    live: dict[str, float] = msgspec.field(default_factory=dict)


class EnsembleStatus(msgspec.Struct, frozen=True):
    """An ensemble at one moment: all that may be read from outside of its layers.

    Attributes:
        mode: ``stopped``, ``deciding`` or ``safe``.
        since: When it came into it, in nanoseconds.
        causes: Why it is safe.
        waiting: The unknown predicates that keep it from deciding, or the pause before it decides again.
        idle_since: Nanoseconds since when it has had nothing to do; None where it has.
        repeats: How often it was decided again in an episode for no other reason than that an action had ended.
        decisions: The number of joint actions published.
        action: The last one of this episode, by index; None before the first.
        action_name: Its name; empty before the first.
        cause: The kind of stimulus on which it was decided, as in `Decision`.
        drive: When it decides.
        deadline: Seconds from stimulus to decision; None where there is no limit.
        on_no_observation: See `ControlOptions`.
        searches: Whether a tree search decides.
        missed: Ticks that the event loop came too late for.
    """

    mode: ModeName
    since: int
    causes: tuple[Cause, ...]
    waiting: tuple[str, ...]
    idle_since: int | None
    repeats: int
    decisions: int
    action: int | None
    action_name: str
    cause: str
    drive: Drive
    deadline: float | None
    on_no_observation: str
    searches: bool
    missed: int


class Ensemble(Layer):
    """A decision process: abstraction, control and action layers that start and stop together.

    At the top of a runtime it begins to decide as soon as it has started; bound to another ensemble's action, it
    decides while that action is chosen.

    Args:
        name: Its name, which prefixes its channels: ``patrol/state``, ``patrol/action``.
        policy: From a state index or a belief to a joint action; a controller, see `ControlLayer`; or a `TreeSearch`,
            which runs in a process of its own, see `Planner`.
        actions: Code for every action, by name or by index, not both: functions, async functions, ensembles, or any
            of them with options (`bind`). Without a model that has names, names here stand in the policy's order.
        model: Needed by a policy over beliefs, for rewards, and to check names and sizes.
        predicates: The predicate manager that the factors refer to; started with the ensemble unless it already runs.
        states: Factors of the state layer; without them, publish `State` messages on ``states``.
        observations: Factors of the observation layer; without them, publish `Observation` on ``observation``.
        agent: Of a team, the agent that this ensemble acts for, by index or name.
        local: Run that agent's own controller of a `JointController`, on its own observations alone; otherwise the
            policy decides for the whole team, on all that the team observes.
        safe_action: Leaves the robot safe: an action by name, or a function or `bind`. See the page on safety.
        supervision: How its failure is handled.
        options: See `SafetyOptions` and `ControlOptions`: ``drive``, ``horizon``, ``deadline`` and others.

    Raises:
        ConfigError: If sizes or names do not fit each other.

    Attributes:
        interrupted: Whether the action that it is bound to has ended it, and it is not idle yet.
        settings: Its options.
        made_of: Its policy, model and agent, as they were given.
    """

    def __init__(
        self,
        name: str,
        *,
        policy: GivenPolicy,
        actions: Mapping[str, Callback | Ensemble | Binding] | Mapping[int, Callback | Ensemble | Binding],
        model: GivenModel | None = None,
        predicates: PredicateManager | None = None,
        states: Sequence[StateFactor] = (),
        observations: Sequence[ObservationFactor] = (),
        agent: int | str = 0,
        local: bool = False,
        safe_action: str | Callback | Binding | None = None,
        supervision: Supervision = "escalate",
        **options: Unpack[SafetyOptions],
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ConfigError(f"the name of an ensemble is a text, not {name!r}", key="ensembles")
        try:
            super().__init__(name, supervision=supervision)
            self.predicates = predicates
            self.made_of = policy, model, agent
            self._idle: list[Callable[[], None]] = []
            self.local = local
            self._asked: Literal["start", "resume", "stop"] | None = None
            self.interrupted = False
            _check_settings(predicates, states, observations, agent, local=local)
            settings = self.settings = SafetySettings.from_keywords(options)
            control = settings.as_arguments(ControlSettings)
            self.control = ControlLayer(policy, model, agent=agent if local else None, **control)
            controller = self.controller = self.control.controller
            names, component, self.agent = _agent_actions(self.control, actions, 0 if local else agent)
            self.action = ActionLayer(
                *(names, actions),
                component=component,
                predicates=predicates,
                safe_action=safe_action,
                safe_timeout=settings.safe_timeout,
            )
            if controller.symbols.action_space is None:
                self.control.output.action_names = names
            if controller.on_impossible == "safe_action" and self.action.safe is None:
                raise ConfigError("on_impossible asks for the safe action, but there is none", key="safe_action")
            self.subensembles = tuple(
                {id(b.ensemble): b.ensemble for b in self.action.bindings if b.ensemble is not None}.values()
            )
            self.safety = Safety(self, settings)
            self.liveness = Liveness(self, settings)
        except ConfigError as error:
            raise ConfigError(error.message, key=".".join(filter(None, ("ensembles", name, error.key)))) from None
        self.state: StateLayer | None = None
        self.observation: ObservationLayer | None = None
        if states:
            self.state = StateLayer(
                states, self._manager("states"), space=getattr(controller.model, "state_space", None)
            )
        if observations:
            self.observation = ObservationLayer(
                observations, self._manager("observations"), space=controller.symbols.observation_space
            )
            self._divide(self.observation)
        self._name_factors()
        self.action.adopt(self)
        self.levels: int = 1 + max((below.levels for below in self.subensembles), default=0)
        if self.levels > MOST_LEVELS:
            raise ConfigError(
                f"ensemble {name!r} is the top of more than {MOST_LEVELS} levels", key=f"ensembles.{name}.actions"
            )
        for child in (*self.subensembles, self.action, self.control, self.observation, self.state):
            if child is not None:
                self.add(child)

    def _divide(self, layer: ObservationLayer) -> None:
        """Tell the controller of which factors an observation is made, where the model does not divide it."""
        space = self.controller.symbols.observation_space
        if space is not None and len(space.factors) == 1 < len(layer.factors):
            sizes = [factor.size for factor in layer.factors]
            if math.prod(sizes) == len(space):  # else the layer has reported it
                self.controller.divide_observations(sizes)

    def _name_factors(self) -> None:
        """Tell the control layer how the factors name their values, where the model does not."""
        symbols = self.controller.symbols
        self.control.output.naming = Naming(
            symbols,
            () if self.state is None else self.state.factors,
            () if self.observation is None else self.observation.factors,
        )
        for kind, layer in (("state", self.state), ("observation", self.observation)):
            space = symbols.state_space if kind == "state" else symbols.observation_space
            if layer is not None and (space is None or all(factor.names[0] == "0" for factor in space.factors)):
                self.control.output.factor_names[kind] = {
                    factor.name: tuple(wire.name for wire in factor.wires()) for factor in layer.factors
                }

    def _manager(self, factors: str) -> PredicateManager:
        if self.predicates is None:
            raise ConfigError(
                f"ensemble {self.name!r} has {factors}, but no predicate manager to take them from",
                key=f"ensembles.{self.name}.{factors}",
            )
        return self.predicates

    # -- Checks --------------------------------------------------------------------------------------------------

    def problems(self) -> Iterator[ConfigError]:
        """Yield everything that would keep the ensemble, or one below it, from starting."""
        yield from self.misfits()
        if self.observation is not None:
            yield from self.observation.shared_events()
        if self.safety.on_lost_teammate is not None and not self.shared:
            yield ConfigError(
                f"on_lost_teammate is for ensembles of a team, and {self.name!r} belongs to none",
                key=f"ensembles.{self.name}.on_lost_teammate",
            )

    def misfits(self) -> Iterator[ConfigError]:
        """Yield what does not fit, whichever agents of a team have the factors, which only its member knows."""
        if self.state is not None:
            yield from self.state.problems()
        if self.observation is not None:
            yield from self.observation.misfits()
        yield from self.action.problems()
        if self.observation is not None and self.controller.divided and self.controller.can_end:
            for factor in self.observation.factors:
                if factor.idle is None and not factor.hold:
                    yield ConfigError(
                        f"observation factor {factor.name!r} may be missing, but the policy has an edge for each whole "
                        "observation: give the factor 'idle' or 'hold'",
                        key=f"ensembles.{self.name}.observations.{factor.name}",
                    )
        if self.state is not None:
            product = math.prod(factor.size for factor in self.state.factors)
            expected = self.controller.symbols.num_states
            if expected is not None and product != expected and self.controller.model is None:
                yield ConfigError(
                    f"the state factors of {self.name!r} make {product} states, but the policy is for {expected}",
                    key=f"ensembles.{self.name}.states",
                )

    @property
    def bound(self) -> bool:
        """Whether it is bound to an action of an ensemble above it."""
        return isinstance(self.parent, Ensemble)

    def notes(self) -> Iterator[str]:
        """Yield allowed oddities: input that nothing here gives, or nothing takes; of this ensemble alone."""
        yield from notes(self)

    def inputs(self) -> set[str]:
        """Return the names of all that its decisions depend on, as its factors have it."""
        layers = (self.state, self.observation)
        return set[str]().union(*(layer.inputs() for layer in layers if layer is not None))

    def given(self) -> set[str]:
        """Return those of its inputs that no formula of others defines."""
        if self.predicates is None:
            return set()
        declared = self.predicates.declared
        return {
            name
            for name in self.inputs()
            if name not in declared.names or declared.senses(name) or declared.raises(name)
        }

    def tree(self) -> str:
        """Return the ensemble and those below it, a line each, indented, with the action that each is bound to."""
        lines = [f"{self.name} ({self.summary()})"]
        for name, binding in zip(self.action.names, self.action.bindings, strict=True):
            if binding.ensemble is None:
                lines.append(f"  {name}: {_call(binding.target)}")
            else:
                first, *rest = binding.ensemble.tree().splitlines()
                lines += [f"  {name}: {first}", *(f"  {line}" for line in rest)]
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Return its name, its process and its mode."""
        if not hasattr(self, "controller") or not hasattr(self, "safety"):  # its construction failed half way
            return f"<Ensemble {self.name!r}>"
        return f"<Ensemble {self.name!r}: {self.summary()}, {self.mode}>"

    @property
    def policy(self) -> Policy:
        """The policy, which stays the one that the ensemble was made with."""
        return self.controller.policy

    @policy.setter
    def policy(self, policy: object) -> None:
        raise ConfigError(
            f"an ensemble keeps the policy that it was made with: make another one with policy={policy!r}; a TOML file "
            "names one of your own as policy = 'module:name'",
            key=f"ensembles.{self.name}.policy",
        )

    def summary(self) -> str:
        """Return the kind of its process, in a few words."""
        policy, drive = self.controller.policy, self.control.drive
        kind = {"state": "MDP", "belief": "POMDP"}.get(getattr(policy, "input", ""), getattr(policy, "form", "policy"))
        facts = policy.facts() if hasattr(policy, "facts") else {"actions": policy.num_actions}
        counts = [
            (facts[f"{what}s"], what) for what in ("state", "node", "action") if facts.get(f"{what}s") is not None
        ]
        told = [counted(count, what) for count, what in counts]
        when = f"{drive.rate:g} Hz" if isinstance(drive, FixedRate) else "event-driven"
        if (period := getattr(self.control.source, "period", None)) is not None:
            when = f"a step of the team every {period:g} s"
        return ", ".join([kind, *told, when])

    # -- Channels that users publish on --------------------------------------------------------------------------

    def publish_state(self, state: Symbol) -> None:
        """Say which state the process is in, by index or name, where there is no state layer.

        Raises:
            ModelError: If there is no such state.
            Error: If it is of a team, where each agent's state factors tell its own part.
        """
        if self.shared:
            raise Error(
                f"ensemble {self.name!r} is of a team, to which each agent tells the state factors that it owns: set "
                "their predicates"
            )
        index = self.controller.symbols.state_index(state)
        self.channel("state", State, retain=True).publish(State(self.runtime.now(), index, (index,)))

    def publish_observation(self, observation: Symbol | Sequence[str | int | None]) -> None:
        """Publish an observation, where there is no observation layer; in a team, this agent's own.

        Args:
            observation: By index or name; or a component per agent, None where one is missing.

        Raises:
            ModelError: If there is no such observation.
        """
        index, values = self.controller.symbols.observed(observation)
        mask = tuple([value is not None for value in values])
        now = self.runtime.dispatcher.now()
        name = "own_observation" if self.shared else "observation"
        self.channel(name, Observation).publish(Observation(now, index, values, mask))

    def publish_belief(self, belief: npt.ArrayLike | str) -> None:
        """Give the control layer a belief from outside, in place of its own update.

        Args:
            belief: S numbers; or the index or name of a state that is certain.

        Raises:
            ModelError: If it is no distribution over the states, or the policy takes none: nothing is published.
        """
        self.channel("external_belief", Belief).publish(self._belief(belief))

    def publish_initial_belief(self, belief: npt.ArrayLike | str) -> None:
        """Set the belief from which the next episode starts.

        Args:
            belief: S numbers; or the index or name of a state that is certain.

        Raises:
            ModelError: As `publish_belief`.
        """
        self.channel("initial_belief", Belief, retain=True).publish(self._belief(belief))

    def _belief(self, belief: npt.ArrayLike | str) -> Belief:
        return Belief(self.runtime.now(), self.controller.symbols.belief_of(belief))

    # -- Deciding ------------------------------------------------------------------------------------------------

    def start(self, *, resume: bool = False) -> None:
        """Begin to decide: from the initial belief, or from the present one; as soon as the layers have started.

        A request between a failure and the restart after it holds when the layers have started again.
        """
        command: Literal["resume", "start"] = "resume" if resume else "start"
        if self._put_off(command):
            self._note(command)
        elif resume:
            self.control.resume()
        else:
            self.control.start()

    def begin(self, *, resume: bool = False) -> None:
        """Begin to decide, as an ensemble above or its own start brings about."""
        command: Literal["resume", "start"] = "resume" if resume else "start"
        if not self._put_off(command):
            self.control.command(command)

    def _note(self, command: Literal["start", "resume", "stop"]) -> None:
        """Note a command that is kept for later as input of the run, as those are that are published."""
        now = self.runtime.now()
        self.runtime.observers.message(self.channel("control", Control), Control(now, command), now)

    def stop(self) -> None:
        """Decide no more and end the running action; ensembles below stop first. `when_idle` tells when it is done."""
        if self._put_off("stop"):
            self._note("stop")
        else:
            self.control.stop()

    def _put_off(self, command: Literal["start", "resume", "stop"]) -> bool:
        """Keep a command until the layers that it is for have all started; return whether they have not."""
        put_off = self.life in {"starting", "restarting"} or self._starts_anew
        if put_off:
            self._asked = command
        return put_off

    @property
    def _starts_anew(self) -> bool:
        """Whether it has failed, and ends to be started again: an end for good is a life of its own."""
        return self.failing and self.life == "running"

    def reset(self) -> None:
        """Begin a new episode now."""
        self.control.reset()

    def release(self) -> None:
        """End the safe mode: the caller answers for its causes. The safe action comes to its end first."""
        self.channel("control", Control).publish(Control(self.runtime.now(), "release"))

    def decide_again(self) -> None:
        """Decide once more on the present state or belief, as one decision more of the episode; from any thread.

        Nothing is decided while it is stopped or safe, its state is unknown or a search goes on; nor at a fixed rate,
        where the next tick decides.

        Raises:
            Error: If it is of a team, which decides together.
        """
        if self.shared:
            raise Error(f"ensemble {self.name!r} is part of a team, which decides on what all tell: set a predicate")
        self.channel("control", Control).publish(Control(self.runtime.now(), "decide_again"))

    def follow(self, team: Team, owned: Collection[str], *, acts: bool = True) -> JointProcess:
        """Decide on a team's input; call this before the start.

        Args:
            team: Receives the requests to the ensemble.
            owned: The state and observation factors that this agent's sensors tell, on ``own_state`` and
                ``own_observation``.
            acts: Whether this agent carries out a component of the joint actions.

        Returns:
            This agent's copy of the process, which the team has decide.
        """
        process = self.control.source = JointProcess(self.control, team)
        if not acts:
            self.action.lives.delegate()
        for layer in (self.state, self.observation):
            if layer is not None:
                layer.cover(owned)
        return process

    def show(self, message: Control | State | Observation) -> None:
        """Publish input that the team decides on, as if it had been seen here; begin or end with its commands."""
        if isinstance(message, Control):
            self._command(message)
        elif isinstance(message, State):
            if self.state is not None:
                self.state.joint = message.values
            self.channel("state", State, retain=True).derive(message)
        else:
            self.channel("observation", Observation).derive(message)

    def interrupt(self) -> None:
        """Stop within the call, so that nothing that was decided before starts."""
        limit = sys.getrecursionlimit()
        sys.setrecursionlimit(limit + _ROOM)  # room for one level; there may be many, and the stack deep already
        try:
            self.control.pause()
            self.interrupted = self.awaited and (self.active or bool(self.action.live))
            self.safety.stop(self.runtime.now())
            self.control.command("stop")
        finally:
            sys.setrecursionlimit(limit)

    @property
    def mode(self) -> ModeName:
        """``stopped``, ``deciding`` or ``safe``."""
        return self.safety.modes.mode

    @property
    def active(self) -> bool:
        """Whether it was started and not stopped: it decides, or is safe."""
        return self.mode != "stopped"

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Why it is safe."""
        return tuple(self.safety.modes.causes.values())

    async def ready(self) -> None:
        """Wait until the process of a tree search is ready; at once where the policy is of another kind."""
        if self.control.planner is not None:
            await self.control.planner.ready()

    def when_idle(self, call: Callable[[], None]) -> None:
        """Call back, once, in a turn, when the ensemble is next stopped and none of its actions lives."""
        self._idle.append(call)

    @property
    def awaited(self) -> bool:
        """Whether somebody waits for its end, as the action does that it is bound to."""
        return bool(self._idle)

    def safe_above(self) -> Ensemble | None:
        """Return the nearest ensemble above this one that is safe or ends, if any."""
        above = self.parent
        while isinstance(above, Ensemble):
            if above.mode == "safe" or above.safety.ending:
                return above
            above = above.parent
        return None

    def _on_control(self, control: Control) -> None:
        command = control.command
        if command == "decide_again" or (command != "release" and self.control.source.asked(command)):
            return  # the first is the control layer's
        if command == "reset" or command == "release" or not self._put_off(command):  # noqa: PLR1714 - mypy
            self._command(control)

    def _command(self, control: Control) -> None:
        if control.command in {"start", "resume"}:
            self.safety.start(control.time)
        elif control.command == "stop":
            self.safety.stop(control.time)
        elif control.command == "release":
            # Behind all effects of this turn, so that no state is decided on which it makes unknown.
            behind: Subscription[int] = Subscription(None, self, self.safety.release)
            self.runtime.dispatcher.deliver_behind(behind, control.time)

    def became_idle(self) -> None:
        """Notify the callers that wait for it: the ensemble is stopped, and nothing of it lives."""
        self.interrupted = False
        idle, self._idle = self._idle, []
        for call in idle:
            call()

    @property
    def shared(self) -> bool:
        """Whether a team decides, and not this ensemble alone."""
        return self.control.source.shared

    @property
    def decides_alone(self) -> bool:
        """Whether nothing but its own input has it decide: no tick, and no team."""
        return self.control.event_driven and not self.shared

    @property
    def absence(self) -> str:
        """Who of the team is not there whose factors are unknown, and what to do, in words; empty where nobody is."""
        return self.control.source.absence

    @property
    def waiting(self) -> tuple[str, ...]:
        """The unknown predicates that keep it from deciding, or the pause before it decides again."""
        return self.safety.waiting.names + self.liveness.waiting

    def status(self) -> EnsembleStatus:
        """Return how the ensemble is now: what may be read from outside of its layers."""
        modes, control = self.safety.modes, self.control
        action = control.acted
        return EnsembleStatus(
            mode=modes.mode,
            since=modes.since,
            causes=self.causes,
            waiting=self.waiting,
            idle_since=self.liveness.since,
            repeats=self.liveness.repeats,
            decisions=control.decisions,
            action=action,
            action_name="" if action is None else self.joint_name(action),
            cause=control.output.cause,
            drive=control.drive,
            deadline=control.deadline,
            on_no_observation=control.on_no_observation,
            searches=control.planner is not None,
            missed=control.ticks.missed,
        )

    def joint_name(self, action: int) -> str:
        """Return the name of a joint action, by its index."""
        return self.control.output.name_of(action)

    def named(self, case: Case) -> Case:
        """Return a case with the names of the wiring, where no model has names of actions or of states."""
        names = self.control.output.action_names
        if case.actions is None and names:
            case = case._replace(actions=Space.single("action", names))
        if case.states is not None or self.state is None:
            return case
        factors = [Factor(each.name, [str(wire.source) for wire in each.wires()]) for each in self.state.factors]
        states = Space(factors)
        return case._replace(states=states if len(states) == self.controller.symbols.num_states else None)

    def case(self, last: int = KEPT) -> Case:
        """Return its last decision with its inputs, and not a safe action behind it; arguments as of `Step.explain`.

        Raises:
            ModelError: If nothing was decided in this episode.
        """
        case = self.named(self.controller.case(last))
        epoch, action = self.control.decided
        return case if action is None or epoch != self.controller.epoch else case._replace(action=action)

    def explain(self, last: int = KEPT) -> Explanation:
        """Return why it has decided as it did last; arguments as of `Step.explain`.

        Raises:
            ModelError: If nothing was decided in this episode.
        """
        from mdm.explanation import explain  # noqa: PLC0415 - see `Step.explain`

        return explain(self.case(last))

    def layer_statistics(self) -> dict[str, ActorStatistics]:
        """Return the statistics of the control layer, of its planner where there is one, and of the action layer."""
        layers = {"control": self.control, "planner": self.control.planner, "action": self.action}
        return {name: layer.statistics() for name, layer in layers.items() if layer is not None}

    def statistics(self) -> EnsembleStatistics:
        """Return the mode, and why the ensemble waits."""
        modes = self.safety.modes
        return EnsembleStatistics(
            **msgspec.structs.asdict(super().statistics()),
            mode=modes.mode,
            since=modes.since,
            causes=self.causes,
            waiting=self.waiting,
            safe_actions=self.safety.runs,
            idle=self.liveness.idle,
            live=self.action.ages,
        )

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Check everything, and use the predicate manager: where nobody else has, the runtime starts it."""
        for problem in self.problems():
            raise problem
        self.interrupted = False
        if self.predicates is not None:
            self.share(self.predicates)
        control = self.channel("control", Control)
        control.input = True
        self.subscribe(control, self._on_control)
        self.safety.open()

    def on_running(self) -> None:
        """Begin to decide, unless it was told otherwise meanwhile, or an ensemble above or a team starts it."""
        asked, self._asked = self._asked, None
        if asked is None and not self.bound and not self.shared:
            asked = "start"
        if asked in {"start", "resume"}:
            self.begin(resume=asked == "resume")

    def on_failing(self, error: BaseException) -> None:
        """Go safe in the turn of the failure, with no way back but a restart, before which sensors are still heard."""
        if self.predicates is not None:
            self.predicates.keep()
        self.safety.last_word.end("failure", f"{type(error).__name__}: {text_of(error)}", lambda: None)

    def on_ending(self) -> None:
        """Go safe with the runtime, not only when those that stop before have come to their ends."""
        above = self.parent
        if not (isinstance(above, Ensemble) and above.life == "running"):  # else that one ends this one
            self.safety.last_word.end("end", "the runtime ends", lambda: None)

    def on_starved(self, detail: str) -> None:
        """Go safe while a turn goes on without end and other input comes."""
        now = self.runtime.now()
        if detail:
            self.safety.endanger("starved", detail, now)
        else:
            self.safety.reopen(frozenset({"starved"}), now)

    async def on_stopping(self) -> None:
        """End the running action and the ensembles below, and run the safe actions: the outermost has the last word."""
        done = anyio.Event()
        await self.come_to("stop", lambda _: self.safety.last_word.end("end", "the ensemble ends", done.set))
        with anyio.move_on_after(self.patience) as scope:
            await done.wait()
        if scope.cancelled_caught:
            self.report("safe_action", f"what lives did not come to its end within {self.patience:g} s")

    def on_stop(self) -> None:
        """Forget the state: input from before an end is not decided on after it."""
        if not self._starts_anew:
            self._asked = None
        self.safety.close()
        self.safety.waiting.end()
        self.channel("state", State, retain=True).forget()
        if self.predicates is not None and self.runtime.sharing.users(self.predicates) != (self,):
            self.predicates.keep_no_more()  # others have it live on

    @property
    def settling(self) -> float:
        """Seconds after which all lives here or below have ended, or were abandoned."""
        return 0.5 + max(
            binding.grace if binding.ensemble is None else binding.ensemble.patience for binding in self.action.bindings
        )

    @property
    def patience(self) -> float:
        """Seconds after which the safe action has ended besides, or has failed twice, as the last word."""
        safe = self.action.safe
        own = max((binding.grace for binding in self.action.bindings if binding.ensemble is None), default=0.0)
        # Of those below one may decide, or else an action of its own live, and another have stopped: it comes after.
        last, *before = sorted((below.patience for below in self.subensembles), reverse=True) or [0.0]
        below = last + max([own, *before])
        if safe is None:
            return 0.5 + below
        once = self.action.safe_timeout + safe.grace
        # One that begins when all has settled here, and not below, comes to its end, too, before it is the last word.
        early = 0.5 + max(last, own) + once if self.subensembles else 0.0
        return 0.5 + max(below, early) + 2 * once


def _call(target: object) -> str:
    """Return how an action is called, in short: ``dock()``, or ``way('Up')`` where its name gives the argument."""
    name, opened, given = str(getattr(target, "__qualname__", "")).partition("(")
    if opened:
        return f"{name.rpartition('.')[2]}({given}"
    return f"{getattr(target, '__name__', type(target).__name__)}()"


def _check_settings(predicates: object, states: object, observations: object, agent: object, *, local: object) -> None:
    """Refuse settings of another kind than an ensemble takes."""
    if predicates is not None and not isinstance(predicates, PredicateManager):
        raise ConfigError(f"predicates is a PredicateManager, not {predicates!r}", key="predicates")
    for key, given, kind in (("states", states, StateFactor), ("observations", observations, ObservationFactor)):
        if not isinstance(given, list | tuple) or not all(isinstance(factor, kind) for factor in given):
            raise ConfigError(f"{key} is a list of {kind.__name__}(...), not {given!r}", key=key)
    if isinstance(agent, bool) or not isinstance(agent, int | str):
        raise ConfigError(f"an agent is given by index or by name, not by {agent!r}", key="agent")
    check_flag(local, "local", key="local")


def _agent_actions(
    control: ControlLayer, actions: Mapping[Any, Any], agent: int | str
) -> tuple[tuple[str, ...], Callable[[int], int] | None, int]:
    """Return the names of one agent's actions, how to find its component of a joint action, and the agent's index."""
    space, count = control.controller.symbols.action_space, control.controller.policy.num_actions
    if space is None:
        if agent != 0:
            raise ConfigError(f"there is no agent {agent!r}: without a model there is one, 0", key="agent")
        if isinstance(actions, Mapping) and actions and all(isinstance(key, str) for key in actions):
            if len(actions) != count:
                are = "one is" if len(actions) == 1 else f"{len(actions)} are"
                text = (
                    f"the policy has {count} actions, but {are} bound ({', '.join(actions)}): each needs one, in order"
                )
                raise ConfigError(text, key="actions")
            return tuple(actions), None, 0
        return tuple(str(index) for index in range(count)), None, 0
    agents = space.factors
    own = agent_index(agent, [factor.name for factor in agents], len(agents))
    if len(agents) == 1:
        return tuple(space.names), None, own
    components = [space.unravel(index)[own] for index in range(len(space))]
    return tuple(agents[own].names), components.__getitem__, own
