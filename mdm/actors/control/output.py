"""Output: decisions become messages, the action first."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import replace

from mdm.actors.control.naming import Naming
from mdm.beliefs import Support
from mdm.messages import Action, Belief, Decision, Reward
from mdm.runtime import Latencies
from mdm.runtime.statistics import FULL
from mdm.stimuli import Late

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.actors.layer import Layer
    from mdm.controller import Controller, Step
    from mdm.messages import Observation
    from mdm.models.matrices import Vector
    from mdm.runtime import Channel, Histogram
    from mdm.runtime.observing import Choices, Observers

Observed = int | tuple[int | None, ...] | None
"""An observation by its index, or by components, None where one is missing."""


_NAMED = 10_000
_EACH = 16
"""Decisions from one call to the next that looks at more than a length: what is read for each would be far apart."""


def symbol_of(observation: Observation) -> Observed:
    """Return the observed symbol: its index, or its components where one is missing."""
    told: Any = observation  # its index may be one of numpy's integers
    index = told.index
    if index is None:
        return observation.values
    found: int = index if index.__class__ is int else operator.index(index)
    return found


class _Muted:
    """Discards the decided actions."""

    def emit(self, _: Action) -> None:
        """Discard an action."""


class _Relay:
    """Emits the decided actions on a channel, and then tells somebody of each.

    Args:
        actions: The channel.
        tell: Told of each action.
    """

    def __init__(self, actions: Channel[Action], tell: Callable[[Action], object]) -> None:
        self._actions = actions
        self._tell = tell

    def emit(self, action: Action) -> None:
        """Emit an action, and pass it on."""
        self._actions.emit(action)
        self._tell(action)


class _Telling:
    """Sends the decisions of a shielded policy on with the action, and its name, that its original wanted."""

    def __init__(self, channel: Any, wanted: Callable[[str], tuple[int | None, str | None]]) -> None:
        self._channel = channel
        self._wanted = wanted

    @property
    def heard(self) -> bool:
        """Whether anybody hears."""
        return bool(self._channel.heard)

    def emit(self, action: Action) -> None:
        """Emit an action."""
        wanted, _ = self._wanted("")
        self._channel.emit(action if wanted is None else replace(action, wanted=wanted))

    def publish(self, decision: Decision) -> None:
        """Publish a decision."""
        wanted, name = self._wanted(decision.cause)
        self._channel.publish(decision if wanted is None else replace(decision, wanted=wanted, wanted_name=name))


class Output:
    """Publishes decisions: ``action``, ``reward`` and ``belief`` of an ensemble, and `Decision` on the runtime's.

    Args:
        controller: The controller that decides.
        deadline: Nanoseconds from stimulus to decision, or None.
        refuses: Told of a decision that comes later, by the step, the nanoseconds since its stimulus and that one's
            time; says whether it is not published.

    Attributes:
        action_names: By index; empty where the controller itself knows them.
        factor_names: The names of values by factor, of ``state`` and ``observation``, where the controller has none.
        naming: Names states and observations, for people.
        acted: The last action that was published in this episode, or None.
        cause: The kind of stimulus on which it was decided, as in `Decision`.
        overdue: Nanoseconds from the first of the ticks that were missed to the present one.
        waited: Nanoseconds for which the stimulus of the planner's question had waited for the event loop.
        look: Called now and then to look how quickly decisions come; returns after how many more it is to be called.
    """

    # The attributes that each decision reads or writes, close together: many ensembles do not all fit the cache.
    __slots__ = (
        "__weakref__",
        "_actions",
        "_alone",
        "_beliefs",
        "_choices",
        "_controller",
        "_deadline",
        "_decisions",
        "_due",
        "_has_belief",
        "_latencies",
        "_now",
        "_observed",
        "_observers",
        "_outlet",
        "_path",
        "_pending",
        "_refuses",
        "_rewards",
        "_tells_current",
        "_wait_of",
        "acted",
        "action_names",
        "cause",
        "factor_names",
        "look",
        "naming",
        "overdue",
        "record",
        "waited",
    )

    def __init__(self, controller: Controller, deadline: int | None, refuses: Callable[[Step, int, int], bool]) -> None:
        space = controller.symbols.action_space
        self.action_names: Sequence[str] = () if space is None else space.names
        self.factor_names: dict[str, dict[str, tuple[str, ...]]] = {}
        self.naming = Naming(controller.symbols)
        self.acted: int | None = None
        self.cause = ""
        self.overdue = 0
        self.waited = 0
        self._controller = controller
        self._deadline = deadline
        self._refuses = refuses
        self._has_belief = controller.takes != "state"
        self._tells_current = self._has_belief or controller.wanted is not None
        self._latencies = Latencies()
        self.record = self._latencies.record
        self._pending = self._latencies.pending
        self.look: Callable[[], int] = lambda: FULL
        self._due = 0
        # Whether the outlet is the channel of actions itself, whenever it is decided.
        self._alone = deadline is None
        self._outlet: Channel[Action] | _Muted | _Relay | _Telling = _Muted()
        self._path = ""
        self._observed = False

    def open(self, layer: Layer) -> None:
        """Publish under the name of a layer's ensemble."""
        channel = layer.owner.channel
        self._now = layer.runtime.clock.reader()
        self._actions: Channel[Action] = channel("action", Action)
        self._let_out(self._actions)
        self._rewards = channel("reward", Reward, retain=True)
        self._beliefs = channel("belief", Belief, retain=True)
        self._decisions: Any = layer.runtime.decisions
        if self._controller.wanted is not None:
            self._decisions = _Telling(self._decisions, self._last_wanted)
        self._path = layer.owner.path
        self._wait_of = layer.runtime.dispatcher.waited
        self._choices: Choices = layer.runtime.dispatcher.choices
        self._choices.controls(self)
        self._observers: Observers = layer.runtime.observers
        self._observers.control(self)
        self._observers.watch(self._count_observers)

    def _count_observers(self) -> None:
        self._observed = self._observers.hears_steps

    @property
    def draws(self) -> str:
        """The state of the random numbers by which the policy draws its actions; empty where it does not."""
        draws: str = getattr(self._controller.information, "draws", "")
        return draws

    def draw_from(self, draws: str) -> None:
        """Let the policy draw on from that state."""
        information: Any = self._controller.information
        if hasattr(information, "draws"):
            information.draws = draws

    @property
    def decisions(self) -> int:
        """The number of actions published."""
        return self._actions.published if self._path else 0

    @property
    def latency(self) -> Histogram:
        """The histogram of times from stimulus to decision."""
        return self._latencies.snapshot()

    def publish(self, step: Step, time: int, cause: str, observation: Observed, state: int | None) -> None:
        """Publish a decision on a stimulus of that time, unless it comes too late and is refused."""
        # Hot path.
        latency = (_ := self._now)() - time
        self._pending.append(latency)
        if not len(self._pending) % _EACH:
            self._fold()
        if self._deadline is not None and self._is_refused(step, latency, time):
            return
        if self._observed:
            self._tell(step, time, cause, observation, state)
        action = step.action
        self._outlet.emit(Action(time, step.epoch, action, state))
        self.acted = action
        self.cause = cause
        if step.reward is not None:
            self._rewards.emit(Reward(time, step.epoch, step.reward))
        if self._has_belief:
            self._publish_belief(time)
        if self._decisions.heard:
            name = self.action_names[action] if self.action_names else step.action_name
            self._decisions.publish(
                Decision(
                    *(time, self._path, step.epoch, cause, state, observation),
                    *(self._controller.belief, action, name, step.reward),
                )
            )

    def publish_last(self, step: Step, time: int, cause: str, observation: Observed, state: int | None) -> None:
        """As `publish`, as the last thing that a handler does, so that the action may begin by a call."""
        reward = step.reward
        if (
            self._decisions.heard
            or not self._alone
            or (reward is not None and self._rewards.heard)
            or (self._has_belief and self._beliefs.heard)
        ):  # of which the action is not the last
            self.publish(step, time, cause, observation, state)
            return
        # Hot path.
        self._pending.append((_ := self._now)() - time)
        if not len(self._pending) % _EACH:
            self._fold()
        if self._observed:
            self._tell(step, time, cause, observation, state)
        self.acted = action = step.action
        self.cause = cause
        if reward is not None:
            self._rewards.emit(Reward(time, step.epoch, reward))
        if self._has_belief:
            self._publish_belief(time)
        self._actions.emit_last(Action(time, step.epoch, action, state))

    def act_last(self, state: int, time: int) -> bool:
        """Decide on a state by a table, and publish the action, as the last thing that a handler does.

        Returns:
            Whether that was all there is to it; otherwise nothing was done.
        """
        if self._decisions.heard or not self._alone:
            return False
        epoch = self._controller.epoch
        action = self._controller.look_up(state)
        if action < 0:
            return False
        # Hot path.
        self._pending.append((_ := self._now)() - time)
        if not len(self._pending) % _EACH:
            self._fold()
        if self._observed:
            self._observers.step(self, time, epoch, "state", state, None, None, action, None)
        self.acted = action
        self.cause = "state"
        self._actions.emit_last(Action(time, epoch, action, state))
        return True

    def _fold(self) -> None:
        """Count the latencies where many wait, and look how quickly decisions come where that is due."""
        if len(self._pending) >= FULL:
            self._latencies.fold()
            self._due = 0
        if len(self._pending) >= self._due:
            self._due = len(self._pending) + self.look()

    def _is_refused(self, step: Step, latency: int, time: int) -> bool:
        """Whether a decision comes past its deadline, and is not published."""
        assert self._deadline is not None
        latency += self.waited or self._wait_of(time)
        latency = self._choices.latency(self._path, step.epoch, time, latency)
        if latency > self._deadline - self.overdue:
            self._observers.tell(Late, time, self._path, step.epoch, latency)
        latency += self.overdue
        return latency > self._deadline and self._refuses(step, latency, time)

    # -- For observers ---------------------------------------------------------------------------------------------

    def _tell(self, step: Step, time: int, cause: str, observation: Observed, state: int | None) -> None:
        current = self._controller.decided_by if self._tells_current else None
        self._observers.step(self, time, step.epoch, cause, state, observation, current, step.action, step.reward)

    @property
    def ensemble(self) -> str:
        """The path of the ensemble that decides."""
        return self._path

    def facts(self) -> dict[str, Any]:
        """Return what decides, as plain data: digests, their parts, the seed, and the names of spaces by their factors.

        Spaces of more than 10,000 symbols have no names.
        """
        controller = self._controller
        facts: dict[str, Any] = {"configuration": controller.configuration, **controller.digests()}
        facts["parts"] = controller.parts()
        if controller.seed is not None:
            facts["seed"] = controller.seed
        if self.draws:
            facts["draws"] = self.draws
        for key in ("state", "action", "observation"):
            space = getattr(controller.symbols, f"{key}_space")
            if space is not None and len(space) <= _NAMED:
                facts[f"{key}s"] = list(space.names)
            factors = self.factor_names.get(key, {})
            if not factors and key != "action" and space is not None and len(space.factors) > 1:
                factors = {factor.name: tuple(factor.names) for factor in space.factors}
            if factors and sum(map(len, factors.values())) <= _NAMED:
                facts[f"{key}_factors"] = factors
        return facts

    def name_of(self, action: int) -> str:
        """Return the name of an action."""
        return self.action_names[action] if self.action_names else self._controller.symbols.action_name(action)

    @property
    def avoids(self) -> str:
        """A formula of all that its policy's shield keeps it out of; empty where it has none."""
        return str(getattr(self._controller.policy, "avoid", "")) if self._controller.wanted is not None else ""

    def wanted(self, cause: str, current: Any) -> tuple[int | None, str | None]:
        """Return the action in whose place a shield has taken another one on an information state, and its name.

        Both are None where it has not, and of decisions of a team that were made elsewhere, by their cause.
        """
        asked = self._controller.wanted
        action = None if asked is None or current is None or cause == "team" else asked(current)
        return action, None if action is None else self.name_of(action)

    def _last_wanted(self, cause: str) -> tuple[int | None, str | None]:
        return self.wanted(cause, self._controller.decided_by)

    def words(self, state: int | None, observation: Observed) -> dict[str, object]:
        """Return the names of the state and the observation that it decides on, by these words."""
        return self.naming.words(state, observation)

    def belief_of(self, current: Any) -> Vector | None:
        """Return an information state as a belief, of S numbers; None where it is none."""
        if current.__class__ is np.ndarray:
            found: Vector = current
            return found
        size = self._controller.symbols.num_states
        return current.dense(size) if isinstance(current, Support) and size is not None else None

    def _publish_belief(self, time: int) -> None:
        """Publish the belief, if one is tracked; of a belief by its support an array is made only for somebody."""
        current = self._controller.decided_by
        if current.__class__ is np.ndarray:
            self._beliefs.emit(Belief(time, current))
        elif isinstance(current, Support) and not self._beliefs.heard:
            size = self._controller.symbols.num_states
            assert size is not None
            self._beliefs.emit_later(time, lambda: Belief(time, current.dense(size)))
        else:
            belief = self._controller.belief
            if belief is not None:
                self._beliefs.emit(Belief(time, belief))

    # -- For the layer's team -----------------------------------------------------------------------------

    def publish_foreign(self, action: Action, belief: Vector | None) -> None:
        """Publish an action decided elsewhere, on a belief where one is known."""
        self._observers.step(self, action.time, action.epoch, "team", None, None, belief, action.index, None)
        self.acted = action.index
        self.cause = "team"
        self._actions.emit(action)
        if belief is not None:
            self._beliefs.emit(Belief(action.time, belief))
        if self._decisions.heard:
            name = self.name_of(action.index)
            told = (action.time, self._path, action.epoch, "team", None, None, belief, action.index, name, None)
            self._decisions.publish(Decision(*told))

    def repeat(self, time: int, state: int | None) -> None:
        """Publish the present action once more, where there is one, and the state that it was decided on."""
        if self.acted is not None:
            self._actions.emit(Action(time, max(self._controller.epoch - 1, 0), self.acted, state))

    def mute(self, *, muted: bool) -> None:
        """Let no decided action begin, or let them begin again."""
        self._let_out(_Muted() if muted else self._actions)

    def relay(self, tell: Callable[[Action], object]) -> None:
        """Pass each decision on to somebody, too, until the layer starts again."""
        self._let_out(_Relay(self._actions, tell))

    def _let_out(self, outlet: Channel[Action] | _Muted | _Relay) -> None:
        shielded = self._controller.wanted is not None
        told = shielded and not isinstance(outlet, _Muted)
        self._outlet = _Telling(outlet, self._last_wanted) if told else outlet
        self._alone = outlet is self._actions and self._deadline is None and not shielded
