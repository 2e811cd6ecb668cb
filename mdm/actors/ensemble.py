"""The ensemble: the layers that together run one decision process, under one parent actor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

import anyio
import numpy as np

from mdm.actors.action_layer import ActionLayer
from mdm.actors.control_layer import ControlLayer, ControlOptions
from mdm.actors.drive import FixedRate
from mdm.actors.layer import Layer
from mdm.actors.observation_layer import ObservationFactor, ObservationLayer
from mdm.actors.state_layer import StateFactor, StateLayer
from mdm.errors import ConfigError
from mdm.messages import Belief, Control, Fault, Observation, PredicateUpdate, State
from mdm.symbols import agent_index

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import numpy.typing as npt

    from mdm.actors.binding import Binding, Callback
    from mdm.actors.predicate_manager import PredicateManager
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.space import Symbol
    from mdm.runtime import Supervision

__all__ = ["MOST_LEVELS", "Ensemble"]

MOST_LEVELS = 100
"""Levels of a hierarchy."""


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
        agent: Of a team, the agent under whose scope this ensemble acts, by index or name.
        local: Run that agent's own controller of a `JointController`, on its own observations alone; otherwise the
            policy decides for the whole team, on all that the team observes.
        safe_action: What leaves the robot safe: an action's name or a function. It runs on a failure that nobody
            could help, on a missed deadline, on input that grew too old, and when the runtime ends.
        supervision: What its failure means.
        options: Of its control layer, see `ControlOptions`: ``drive``, ``horizon``, ``deadline`` and others.

    Raises:
        ConfigError: If sizes or names do not fit each other.
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
        safe_action: str | Callback | None = None,
        supervision: Supervision = "escalate",
        **options: Unpack[ControlOptions],
    ) -> None:
        super().__init__(name, supervision=supervision)
        self.predicates = predicates
        self.active = False
        self._idle: list[Callable[[], None]] = []
        self._safe_due = False
        try:
            self.control = ControlLayer(policy, model, agent=agent if local else None, **options)
            controller = self.controller = self.control.controller
            names, component = _agent_actions(self.control, actions, 0 if local else agent)
            self.action = ActionLayer(
                names, actions, component=component, predicates=predicates, safe_action=safe_action
            )
            if controller.symbols.action_space is None:
                self.control.action_names = names
            self.control.has_safe_action = self.action.safe is not None
            if controller.on_impossible == "safe_action" and self.action.safe is None:
                raise ConfigError("on_impossible asks for the safe action, but there is none", key="safe_action")
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
        self.subensembles = tuple(
            {id(b.ensemble): b.ensemble for b in self.action.bindings if b.ensemble is not None}.values()
        )
        self.levels: int = 1 + max((below.levels for below in self.subensembles), default=0)
        if self.levels > MOST_LEVELS:
            raise ConfigError(
                f"ensemble {name!r} is the top of more than {MOST_LEVELS} levels", key=f"ensembles.{name}.actions"
            )
        for child in (*self.subensembles, self.action, self.control, self.observation, self.state):
            if child is not None:
                self.add(child)

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
        for layer in (self.state, self.observation, self.action):
            if layer is not None:
                yield from layer.problems()
        space = None if self.controller.model is None else self.controller.model.state_space
        if self.state is not None:
            product = 1
            for factor in self.state.factors:
                product *= factor.size
            expected = self.controller.symbols.num_states
            if (
                expected is not None
                and product != expected
                and (space is None or len(self.state.factors) == len(space.factors))
            ):
                yield ConfigError(
                    f"the state factors of {self.name!r} make {product} states, but the policy is for {expected}",
                    key=f"ensembles.{self.name}.states",
                )

    def notes(self) -> Iterator[str]:
        """Yield what is allowed, but odd: input that nothing here gives, or nothing takes; of this ensemble alone."""
        over_states = self.controller.takes == "state"
        wanted, other = ("states", "observations") if over_states else ("observations", "states")
        given = {"states": self.state, "observations": self.observation}
        if given[wanted] is None:
            yield f"ensemble {self.name!r} has no {wanted}: it waits for code that publishes what it decides on"
        if given[other] is not None:
            yield f"ensemble {self.name!r} has {other}, but its policy decides on {wanted}"

    def tree(self) -> str:
        """Return the ensemble and those below it, a line each, indented, with the action that each is bound to."""
        lines = [f"{self.name} ({self.summary()})"]
        for name, binding in zip(self.action.names, self.action.bindings, strict=True):
            if binding.ensemble is None:
                lines.append(f"  {name}: {getattr(binding.target, '__name__', type(binding.target).__name__)}()")
            else:
                first, *rest = binding.ensemble.tree().splitlines()
                lines += [f"  {name}: {first}", *(f"  {line}" for line in rest)]
        return "\n".join(lines)

    def summary(self) -> str:
        """Return what kind of process it is, in a few words."""
        policy, drive = self.controller.policy, self.control.drive
        kind = {"state": "MDP", "belief": "POMDP"}.get(getattr(policy, "input", ""), getattr(policy, "form", "policy"))
        facts = policy.facts() if hasattr(policy, "facts") else {"actions": policy.num_actions}
        told = [f"{facts[what]} {what}" for what in ("states", "nodes", "actions") if facts.get(what) is not None]
        when = f"{drive.rate:g} Hz" if isinstance(drive, FixedRate) else "event-driven"
        return ", ".join([kind, *told, when])

    # -- Channels that users publish on --------------------------------------------------------------------------

    def publish_state(self, state: Symbol) -> None:
        """Say which state the process is in, by index or name, where there is no state layer.

        Raises:
            ModelError: If there is no such state.
        """
        index = self.controller.symbols.state_index(state)
        self.channel("state", State, retain=True).publish(State(self.runtime.clock.now(), index, (index,)))

    def publish_observation(self, observation: Symbol | Sequence[str | int | None]) -> None:
        """Say what was observed, where there is no observation layer.

        Args:
            observation: By index or name; or a component per agent, None where one is missing.

        Raises:
            ModelError: If there is no such observation.
        """
        index, values = self.controller.symbols.observed(observation)
        mask = tuple(value is not None for value in values)
        now = self.runtime.clock.now()
        self.channel("observation", Observation).publish(Observation(now, index, values, mask))

    def publish_belief(self, belief: npt.ArrayLike | str) -> None:
        """Give the control layer a belief from outside, in place of its own update.

        Args:
            belief: S numbers; or the index or name of a state that is certain.
        """
        self.channel("external_belief", Belief).publish(self._belief(belief))

    def publish_initial_belief(self, belief: npt.ArrayLike | str) -> None:
        """Set the belief from which the next episode starts.

        Args:
            belief: S numbers; or the index or name of a state that is certain.
        """
        self.channel("initial_belief", Belief, retain=True).publish(self._belief(belief))

    def _belief(self, belief: npt.ArrayLike | str) -> Belief:
        given = self.controller.symbols.belief_of(belief) if isinstance(belief, str | int) else belief
        return Belief(self.runtime.clock.now(), np.array(given, dtype=np.float64))

    # -- Deciding ------------------------------------------------------------------------------------------------

    def start(self, *, resume: bool = False) -> None:
        """Begin to decide: from the initial belief, or from the present one."""
        if resume:
            self.control.resume()
        else:
            self.control.start()

    def stop(self) -> None:
        """Decide no more and end the running action; what is below stops first. `when_idle` tells when it is done."""
        self.control.stop()

    def reset(self) -> None:
        """Begin a new episode now."""
        self.control.reset()

    async def ready(self) -> None:
        """Wait until the process of a tree search is ready; at once where the policy is of another kind."""
        if self.control.planner is not None:
            await self.control.planner.ready()

    def when_idle(self, call: Callable[[], None]) -> None:
        """Call back, once, in a turn, when the ensemble is next stopped and none of its actions lives."""
        self._idle.append(call)

    def _on_safety(self, fault: Fault) -> None:
        """Report a fault, and run the safe action in place of what is live."""
        self.runtime.faults.publish(fault)
        if self.active:
            self.action.make_safe(fault.time)

    def _on_control(self, control: Control) -> None:
        if control.command in {"start", "resume"}:
            self.active = True
            self.action.admit()
        elif control.command == "stop" and self.active:
            self.active = False
            self.action.halt(self._became_idle)

    def _became_idle(self) -> None:
        idle, self._idle = self._idle, []
        for call in idle:
            call()

    # -- Life ----------------------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Check everything, and start the predicate manager where nobody else did."""
        for problem in self.problems():
            raise problem
        if self.predicates is not None and self.predicates.parent is None:
            self.add(self.predicates, first=True)
        self.subscribe(self.channel("control", Control), self._on_control)
        self.subscribe(self.channel("safety", Fault), self._on_safety)
        watched = self._watched()
        if watched and self.predicates is not None:
            self._subscribe_stale(self.predicates, watched)

    def _watched(self) -> frozenset[str]:
        """The sensors with a largest age that this ensemble depends on."""
        manager = self.predicates
        if manager is None:
            return frozenset()
        names = [name for factor in (self.state.factors if self.state else ()) for name in factor.predicates]
        events = [name for factor in (self.observation.factors if self.observation else ()) for name in factor.events]
        names += [name for name in events if name is not None]
        return frozenset(sensor for name in names for sensor in manager.inputs_of(name) if sensor in manager.aged)

    def _subscribe_stale(self, manager: PredicateManager, watched: frozenset[str]) -> None:
        def look(update: PredicateUpdate) -> None:
            lost = watched.intersection(update.unknown) if self.active else ()
            if lost:
                text = f"input is too old: {', '.join(sorted(lost))}"
                self._on_safety(Fault(update.time, self.path, "stale_input", text))

        self.subscribe(self.runtime.channel(f"{manager.path}/updates", PredicateUpdate), look)

    def on_running(self) -> None:
        """Begin to decide, unless another ensemble's action is what starts this one."""
        if not isinstance(self.parent, Ensemble):
            self.start()

    async def on_stopping(self) -> None:
        """End the running action and what is below, then run the safe action."""
        for ensemble in self._below():
            ensemble._safe_due = ensemble._safe_due or ensemble.active  # noqa: SLF001 - one family
        if self.active:
            self.active = False
            self.control.running = False
            await self._settled(self.action.halt)
        self._became_idle()
        if self._safe_due and self.action.safe is not None:
            self.action.make_safe(self.runtime.clock.now())
            await self._settled(self.action.when_idle)
        self._safe_due = False

    async def _settled(self, tell: Callable[[Callable[[], None]], None]) -> None:
        done = anyio.Event()
        with anyio.move_on_after(self.patience):
            tell(done.set)
            await done.wait()

    @property
    def patience(self) -> float:
        """Seconds after which whatever is live here or below has ended, or was abandoned."""
        return 0.5 + max(
            binding.grace if binding.ensemble is None else binding.ensemble.patience for binding in self.action.bindings
        )

    def _below(self) -> Iterator[Ensemble]:
        yield self
        for ensemble in self.subensembles:
            yield from ensemble._below()  # noqa: SLF001 - one family


def _agent_actions(
    control: ControlLayer, actions: Mapping[Any, Any], agent: int | str
) -> tuple[tuple[str, ...], Callable[[int], int] | None]:
    """Return the names of one agent's actions, and how to find its component of what is decided."""
    space, count = control.controller.symbols.action_space, control.controller.policy.num_actions
    if space is None:
        if actions and all(isinstance(key, str) for key in actions):
            if len(actions) != count:
                raise ConfigError(f"the policy has {count} actions, but {len(actions)} are bound", key="actions")
            return tuple(actions), None
        return tuple(str(index) for index in range(count)), None
    agents = space.factors
    own = agent_index(agent, [factor.name for factor in agents], len(agents))
    if len(agents) == 1:
        return tuple(space.names), None
    components = [space.unravel(index)[own] for index in range(len(space))]
    return tuple(agents[own].names), components.__getitem__
