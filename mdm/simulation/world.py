"""The world: an actor that a model drives, which takes an ensemble's actions and gives it states or observations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.actors import Ensemble, FixedRate
from mdm.errors import ConfigError
from mdm.messages import Action, Belief, Fault, Observation, State
from mdm.models import POMDP, MixedPOMDP
from mdm.runtime import Actor
from mdm.simulation.sampler import Sampler

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.actors import StateLayer
    from mdm.models import MDP
    from mdm.models.matrices import Vector

__all__ = ["World"]

_LONGEST = 10_000
"""So many steps in a row without an observation are no accident."""


class World(Actor):
    """Closes the loop around an ensemble without a robot.

    After each decision it draws the next state and, for a POMDP, an observation, and makes them known: by the sensors
    of the ensemble's state factors and the events of its observation factors where it has such and code sets them, and
    as messages on its channels otherwise. Start it before the ensemble. What a `MixedPOMDP` shows of an episode's first
    state is the ensemble's initial belief.

    A false negative of the model, or an event without an observation, leads to no decision: the action goes on, each
    such step with its reward, until something is observed; a fixed-rate ensemble decides all the same. An episode in
    which nothing is observed for 10,000 steps ends, with a fault.

    Args:
        ensemble: Whose actions count.
        model: How the world goes; by default the ensemble's own model.
        seed: Makes a run reproducible.
        period: Seconds that an action takes until its outcome shows; 0 shows it in the same turn. A fixed-rate
            ensemble sees outcomes at its ticks, whatever the period.
        steps: Decisions in an episode; by default the ensemble's horizon. The end of a controller's plan ends it, too.
        finished: Called with each episode's discounted return.
    """

    def __init__(
        self,
        ensemble: Ensemble,
        model: MDP | None = None,
        *,
        seed: int | None = None,
        period: float = 1.0,
        steps: int | None = None,
        finished: Callable[[float], object] | None = None,
        name: str = "world",
    ) -> None:
        super().__init__(name)
        given = ensemble.controller.model if model is None else model
        if given is None:
            raise ConfigError(f"a world for ensemble {ensemble.name!r} needs a model, but the ensemble has none")
        if ensemble.controller.takes != "state" and not isinstance(given, POMDP):
            raise ConfigError(f"ensemble {ensemble.name!r} decides by what is observed: its world needs observations")
        if len(given.action_space) != ensemble.controller.policy.num_actions:
            raise ConfigError(
                f"ensemble {ensemble.name!r} decides on {ensemble.controller.policy.num_actions} actions, but its "
                f"world has {len(given.action_space)}: one agent's part of a team is no world's whole"
            )
        self.ensemble = ensemble
        self.model: MDP = given
        self.state = 0
        self.steps = ensemble.controller.horizon if steps is None else steps
        # A controller that has nothing to do with states has no use for a belief.
        self._belief_at_start: Callable[[int], Vector] | None = None
        if isinstance(given, MixedPOMDP) and ensemble.controller.symbols.num_states is not None:
            self._belief_at_start = given.belief_at_start
        self._false_negative = None if ensemble.controller.takes == "state" else given.false_negative
        self._waits = not isinstance(ensemble.control.drive, FixedRate)
        self._period = 0.0 if isinstance(ensemble.control.drive, FixedRate) else period
        self._sampler = Sampler(given, seed)
        self._finished = finished
        self._rewards: list[list[float]] = given.rewards.tolist()
        self._return = 0.0
        self._weight = 1.0
        self._step = 0
        self.moves = 0
        """Steps of time in the present episode."""

    def on_start(self) -> None:
        """Listen for actions, and begin in a first state."""
        path, channel = self.ensemble.path, self.runtime.channel
        self._states = channel(f"{path}/state", State, retain=True)
        self._observations = channel(f"{path}/observation", Observation)
        self._initial_beliefs = channel(f"{path}/initial_belief", Belief, retain=True)
        self.subscribe(channel(f"{path}/action", Action), self._on_action)
        self._begin_episode()
        if self.ensemble.controller.takes == "state":
            self._show_state(changed=True)

    def _begin_episode(self) -> None:
        self.state = self._sampler.first_state()
        self._return = 0.0
        self._weight = 1.0
        self._step = 0
        self.moves = 0
        if self._belief_at_start is not None:
            self._initial_beliefs.publish(Belief(self.runtime.clock.now(), self._belief_at_start(self.state)))

    def _on_action(self, action: Action) -> None:
        self._return += self._weight * self._rewards[self.state][action.index]
        self._weight *= self.model.discount
        self._step += 1
        self.moves += 1
        if self._step == self.steps or self.ensemble.controller.over:
            self._end_episode()
            # The next stimulus begins a new episode; what is observed in it does not count.
            self._later(lambda: self._show(observation=0, changed=True))
            return
        before = self.state
        observation, steps = self._move(action.index)
        if observation is not None:
            self._later(lambda: self._show(observation, changed=self.state != before), steps)
        elif self._waits:
            self._tell_no_observation(action.index)
            self._end_episode()
            self._later(self.ensemble.reset)

    def _end_episode(self) -> None:
        if self._finished is not None:
            self._finished(self._return)
        self._begin_episode()

    def _move(self, action: int) -> tuple[int | None, int]:
        """Go on until something is observed; return what, or None, and after how many steps."""
        for steps in range(1, _LONGEST):
            before, self.state = self.state, self._sampler.next_state(self.state, action)
            if not isinstance(self.model, POMDP):
                return 0, steps
            observation = self._sampler.observation(action, before, self.state)
            if observation == self._false_negative:
                observation = None
            if observation is not None or not self._waits:
                return observation, steps
            self._return += self._weight * self._rewards[self.state][action]
            self.moves += 1
            self._weight *= self.model.discount
        return None, _LONGEST

    def _tell_no_observation(self, action: int) -> None:
        names = self.model.state_space.names[self.state], self.model.action_space.names[action]
        text = (
            f"nothing is observed any more in state {names[0]!r} during action {names[1]!r}, in {_LONGEST} steps: the "
            f"episode ends"
        )
        self.runtime.faults.publish(Fault(self.runtime.clock.now(), self.path, "no_observation", text))

    def _later(self, show: Callable[[], object], steps: int = 1) -> None:
        if self._period > 0:
            self.call_later(steps * self._period, show)
        else:
            show()

    def _show(self, observation: int, *, changed: bool) -> None:
        if self.ensemble.controller.takes == "state":
            self._show_state(changed=changed)
        else:
            self._show_observation(observation)

    def _show_state(self, *, changed: bool) -> None:
        layer = self.ensemble.state
        values = self.model.state_space.unravel(self.state)
        if changed and layer is not None and _settable(layer):
            with layer.predicates.batch():
                for factor, value in zip(layer.factors, values, strict=True):
                    for name, holds in factor.truth(value).items():
                        layer.predicates.sense(name, holds)
        else:
            self._states.publish(State(self.runtime.clock.now(), self.state, values))

    def _show_observation(self, index: int) -> None:
        layer = self.ensemble.observation
        assert isinstance(self.model, POMDP)
        values = self.model.observation_space.unravel(index)
        if layer is not None and len(layer.factors) == len(values):
            events = [factor.events[value] for factor, value in zip(layer.factors, values, strict=True)]
            raised = [event for event in events if event is not None and layer.predicates.raises(event)]
            if len(raised) == len(events):
                layer.predicates.occur(*raised)
                return
        mask = (True,) * len(values)
        self._observations.publish(Observation(self.runtime.clock.now(), index, values, mask))


def _settable(layer: StateLayer) -> bool:
    return all(layer.predicates.senses(name) for factor in layer.factors for name in factor.predicates)
