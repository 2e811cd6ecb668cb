"""Episodes of a policy in its model without the decision loop: many in step, or one after the other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.beliefs import Support
from mdm.controller import Controller
from mdm.errors import ConfigError
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics
from mdm.policies.batch import ENDED
from mdm.simulation.batch_sampler import BatchSampler, ended_states
from mdm.simulation.sampler import Sampler

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

__all__ = ["EpisodeBatch", "EpisodeStep", "Limits", "Single", "limits", "one_by_one"]

_REST = 1e-6
"""The weight of what comes after the last step, where the discount ends an episode."""
_LONGEST = 10_000
"""So many steps in a row without an observation end an episode."""


class Limits(NamedTuple):
    """Where an episode ends.

    Attributes:
        decisions: After so many.
        moves: After so many steps of time, which are more than decisions where there are false negatives.
    """

    decisions: float
    moves: float


def limits(model: MDP, policy: Any, steps: int | None) -> Limits:
    """Return where episodes end.

    Raises:
        ConfigError: If they do not.
    """
    horizon = getattr(policy, "horizon", None)  # a plan's own end, of controllers and staged policies
    if steps is not None:
        return Limits(steps if horizon is None else min(steps, horizon), math.inf)
    if model.discount < 1:
        moves = max(1, math.ceil(math.log(_REST) / math.log(model.discount)))
        return Limits(math.inf if horizon is None else horizon, moves)
    if horizon is None:
        raise ConfigError("with a discount of 1 an episode needs an end: give a discount or the number of steps")
    return Limits(horizon, math.inf)


class EpisodeBatch:
    """Runs many episodes in step.

    Args:
        model: The model.
        batch: The policy's decisions.
        observed: Whether the policy goes by what is observed.
        ends: Where an episode ends.
    """

    def __init__(self, model: MDP, batch: Batch, ends: Limits, *, observed: bool) -> None:
        self._sampler = BatchSampler(model, observed=observed)
        self._discount = model.discount
        self._batch = batch
        self._observed = observed
        false_negative = model.false_negative
        self._false_negative = self._sampler.nothing if false_negative is None else false_negative
        self._ends = ends

    def __call__(self, episodes: int, random: np.random.Generator) -> tuple[Vector, int]:
        """Run some episodes; return their discounted returns, and how many steps of time they took in all.

        Every episode has its own numbers at every step, whatever the policy did and which others have ended.
        """
        sampler = self._sampler
        returns = np.zeros(episodes)
        states = sampler.first(random.random(episodes))
        actions = self._batch.begin(states, random.random(episodes))
        decisions, waited, going = np.ones_like(states), np.zeros_like(states), np.arange(episodes)
        weight, moves, time = 1.0, 0, 0
        goes = ~sampler.ended[states]
        while True:
            if not goes.all():
                states, actions, decisions = states[goes], actions[goes], decisions[goes]
                waited, going = waited[goes], going[goes]
                self._batch.keep(goes)
            if not len(going):
                return returns, moves
            returns[going] += weight * sampler.rewards[states, actions]
            weight *= self._discount
            time += 1
            moves += len(going)
            if time >= self._ends.moves:
                return returns, moves
            numbers = random.random((3, episodes))[:, going]
            states, seen = sampler.move(states, actions, numbers)
            goes = (decisions < self._ends.decisions) & ~sampler.ended[states]
            decides = goes
            if self._observed:
                decides = goes & (seen != self._false_negative) & (seen != sampler.nothing)
                waited = np.where(decides, 0, waited + 1)
                goes &= waited < _LONGEST
            which = np.flatnonzero(decides)
            if not len(which):
                continue
            chosen = self._batch.next(which, states[which], actions[which], seen[which], numbers[2, which])
            actions[which] = chosen
            decisions[which] += 1
            goes[which[chosen == ENDED]] = False


class EpisodeStep(NamedTuple):
    """A step of time in an episode.

    Attributes:
        state: The state before.
        belief: What the policy knows of it; None where it sees it.
        action: What is done; that of the last decision where nothing was observed since.
        seen: What was observed at the decision; None at the first one, and where nothing was.
        decided: Whether this is a decision.
    """

    state: int
    belief: Vector | Support | None
    action: int
    seen: int | None
    decided: bool


class Single:
    """Runs single episodes of a controller in its model.

    Args:
        model: The model.
        policy: The policy, of any kind.
    """

    def __init__(self, model: MDP, policy: Any) -> None:
        self._model = model
        self._controller = Controller(policy, model)
        self._sampler = Sampler(model)
        self._ended = ended_states(Dynamics(model))

    def __call__(self, seed: int | np.random.SeedSequence | None) -> Iterator[EpisodeStep]:
        """Run an episode until nothing more can come of it; the caller may end it at any moment."""
        model, sampler, controller = self._model, self._sampler, self._controller
        sees, false_negative = controller.takes == "state", model.false_negative
        sampler.seed(seed)
        state, seen, waited = sampler.first_state(), None, 0
        if sees:
            step = controller.start(state)
        else:
            assert isinstance(model, POMDP)
            knows = controller.symbols.num_states is not None  # a plan may know nothing of states
            step = controller.start(model.belief_at_start(state) if knows else None)
        decided = True
        while not self._ended[state] and waited < _LONGEST:
            yield EpisodeStep(state, self._known(), step.action, seen, decided)
            if controller.over:
                return
            before, state = state, sampler.next_state(state, step.action)
            if sees:
                step = controller.see(state)
                continue
            seen = sampler.observation(step.action, before, state)
            decided = seen is not None and seen != false_negative
            if decided:
                step, waited = controller.observe(seen), 0  # rounding may make it impossible: time passes then
            else:
                seen, waited = None, waited + 1

    def _known(self) -> Vector | Support | None:
        """Return the belief as it is held; None where there is none."""
        current = None if self._controller.takes == "state" else self._controller.information.current
        return current if isinstance(current, np.ndarray | Support) else self._controller.belief


def one_by_one(model: MDP, policy: Any, ends: Limits, *, episodes: int, seed: int) -> tuple[Vector, int]:
    """Run episodes one after the other, for policies of any kind.

    Returns:
        Their discounted returns, and how many steps of time they took in all.
    """
    run, rewards, discount = Single(model, policy), model.rewards, model.discount
    returns, moves = np.zeros(episodes), 0
    for episode, stream in enumerate(np.random.SeedSequence(seed).spawn(episodes)):
        weight, total, decisions, time = 1.0, 0.0, 0, 0
        for moment in run(stream):
            total += weight * float(rewards[moment.state, moment.action])
            weight *= discount
            time += 1
            decisions += moment.decided
            if decisions >= ends.decisions or time >= ends.moves:
                break
        returns[episode] = total
        moves += time
    return returns, moves
