"""Episodes of a policy in its model without the decision loop: many in step, or one after the other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.errors import ConfigError
from mdm.models import POMDP, BeliefTracker
from mdm.policies import FiniteStateController, JointController
from mdm.simulation.choices import ENDED, Choices
from mdm.simulation.crowd import Crowd
from mdm.simulation.sampler import Sampler

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Vector

__all__ = ["Limits", "Together", "limits", "one_by_one"]

_REST = 1e-6
"""The weight of what comes after the last step, where the discount ends an episode."""
_SILENCE = 10_000
"""So many steps in a row in which nothing is noticed end an episode."""


class Limits(NamedTuple):
    """Where an episode ends.

    Attributes:
        decisions: After so many.
        moves: After so many steps of time, which are more than decisions where events go unnoticed.
    """

    decisions: float
    moves: float


def limits(model: MDP, policy: Any, steps: int | None) -> Limits:
    """Return where episodes end.

    Raises:
        ConfigError: If they do not.
    """
    if steps is not None:
        return Limits(steps, math.inf)
    if model.discount < 1:
        return Limits(math.inf, max(1, math.ceil(math.log(_REST) / math.log(model.discount))))
    controllers = policy.controllers if isinstance(policy, JointController) else [policy]
    lengths = [_length(each) for each in controllers if isinstance(each, FiniteStateController)]
    if not any(lengths):
        raise ConfigError("with a discount of 1 an episode needs an end: give a discount or the number of steps")
    return Limits(min(filter(None, lengths)), math.inf)


def _length(controller: FiniteStateController) -> int:
    """Return after how many decisions a controller's plan ends; 0 where it does not."""
    nodes = {controller.start} if controller.values is None else set(range(controller.num_nodes))
    for length in range(controller.num_nodes):
        nodes = {after for node in nodes for after in controller.successors[node] if after is not None}
        if not nodes:
            return length + 1
    return 0


class Together:
    """Runs many episodes in step.

    Args:
        model: The model.
        choices: The policy.
        unnoticed: The observation that stands for an event that nobody noticed, if there is one.
        observed: Whether the policy goes by what is observed.
        ends: Where an episode ends.
    """

    def __init__(self, model: MDP, choices: Choices, unnoticed: int | None, ends: Limits, *, observed: bool) -> None:
        self._crowd = Crowd(model, observed=observed)
        self._discount = model.discount
        self._choices = choices
        self._observed = observed
        self._unnoticed = self._crowd.nothing if unnoticed is None else unnoticed
        self._ends = ends

    def __call__(self, episodes: int, random: np.random.Generator) -> tuple[Vector, int]:
        """Run some episodes; return their discounted returns, and how many steps of time they took in all.

        Every episode has its own numbers at every step, whatever the policy did and which others have ended.
        """
        crowd = self._crowd
        returns = np.zeros(episodes)
        states = crowd.first(random.random(episodes))
        actions = self._choices.begin(states, random.random(episodes))
        decisions, silence, going = np.ones_like(states), np.zeros_like(states), np.arange(episodes)
        weight, moves, time = 1.0, 0, 0
        goes = ~crowd.ended[states]
        while True:
            if not goes.all():
                states, actions, decisions = states[goes], actions[goes], decisions[goes]
                silence, going = silence[goes], going[goes]
                self._choices.keep(goes)
            if not len(going):
                return returns, moves
            returns[going] += weight * crowd.rewards[states, actions]
            weight *= self._discount
            time += 1
            moves += len(going)
            if time >= self._ends.moves:
                return returns, moves
            numbers = random.random((3, episodes))[:, going]
            states, seen = crowd.move(states, actions, numbers)
            goes = (decisions < self._ends.decisions) & ~crowd.ended[states]
            noticed = goes
            if self._observed:
                noticed = goes & (seen != self._unnoticed) & (seen != crowd.nothing)
                silence = np.where(noticed, 0, silence + 1)
                goes &= silence < _SILENCE
            which = np.flatnonzero(noticed)
            if not len(which):
                continue
            chosen = self._choices.next(which, states[which], actions[which], seen[which], numbers[2, which])
            actions[which] = chosen
            decisions[which] += 1
            goes[which[chosen == ENDED]] = False


def one_by_one(
    model: MDP, policy: Any, unnoticed: int | None, ends: Limits, *, episodes: int, seed: int
) -> tuple[Vector, int]:
    """Run episodes one after the other, for any policy that goes by states or beliefs.

    Returns:
        Their discounted returns, and how many steps of time they took in all.
    """
    tracker = BeliefTracker(model, false_negative=unnoticed) if isinstance(model, POMDP) else None
    by_belief = policy.input == "belief"
    sampler, rewards, discount = Sampler(model), model.rewards, model.discount
    ended = Crowd(model, observed=False).ended
    returns, moves = np.zeros(episodes), 0
    for episode, stream in enumerate(np.random.SeedSequence(seed).spawn(episodes)):
        sampler.seed(stream)
        state = sampler.first_state()
        if by_belief:
            assert tracker is not None
            assert isinstance(model, POMDP)
            tracker.reset(model.belief_at_start(state))
        weight, total, decisions, silence, time = 1.0, 0.0, 0, 0, 0
        action = None
        while not ended[state] and time < ends.moves and silence < _SILENCE:
            if action is None:
                action = policy.action(tracker.belief if by_belief and tracker is not None else state)
                decisions += 1
            total += weight * float(rewards[state, action])
            weight *= discount
            time += 1
            if decisions >= ends.decisions:
                break
            before, state = state, sampler.next_state(state, action)
            if not by_belief:
                action = None
                continue
            assert tracker is not None
            seen = sampler.observation(action, before, state)
            if seen is None or seen == unnoticed:
                silence += 1
                continue
            if not tracker.update(action, seen) > 0:
                tracker.update(action, None)  # rounding made it impossible: time passes, as in a control layer
            action, silence = None, 0
        returns[episode] = total
        moves += time
    return returns, moves
