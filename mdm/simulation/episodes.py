"""Episodes of a policy in its model without the decision loop: in batches, or one at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mdm.beliefs import Support
from mdm.controller import Controller
from mdm.errors import ConfigError
from mdm.models.dynamics import Dynamics
from mdm.policies.batch import ENDED
from mdm.simulation.sampler import BatchSampler, Sampler, ended_states

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

__all__ = ["EpisodeBatch", "EpisodeRunner", "EpisodeStep", "Limits", "limits", "one_by_one"]

_REST = 1e-6
"""The discounted weight of the rest at which an episode ends."""
_LONGEST = 10_000
"""The number of time steps without an observation that ends an episode."""


class Limits(NamedTuple):
    """The end of an episode.

    Attributes:
        decisions: The most decisions.
        moves: The most time steps, which false negatives make more than decisions.
    """

    decisions: float
    moves: float


def limits(model: MDP, policy: Any, steps: int | None, discount: float | None = None) -> Limits:
    """Return the end of episodes.

    Args:
        model: The model.
        policy: The policy.
        steps: Decisions.
        discount: In place of the model's, the most that a time step may have.

    Raises:
        ConfigError: If they have none.
    """
    horizon = getattr(policy, "horizon", None)  # of plans and staged policies
    if steps is not None:
        return Limits(steps if horizon is None else min(steps, horizon), math.inf)
    discount = model.discount if discount is None else discount
    if discount < 1:
        moves = max(1, math.ceil(math.log(_REST) / math.log(discount)))
        return Limits(math.inf if horizon is None else horizon, moves)
    if horizon is None:
        raise ConfigError(
            "with a discount of 1 an episode needs an end: give a discount (--discount) or decisions (--steps)"
        )
    return Limits(horizon, math.inf)


class EpisodeBatch:
    """Runs a batch of episodes as arrays.

    Args:
        model: The model.
        batch: The policy's decisions.
        observed: Whether the policy needs observations.
        ends: The end of an episode.
        discounts: Of each state and action, S x A; by default that of the model.
    """

    def __init__(
        self, model: MDP, batch: Batch, ends: Limits, *, observed: bool, discounts: Vector | None = None
    ) -> None:
        self._sampler = BatchSampler(model, observed=observed)
        self._discount = model.discount
        self._discounts = discounts
        self._batch = batch
        self._observed = observed
        false_negative = model.false_negative
        self._false_negative = self._sampler.nothing if false_negative is None else false_negative
        self._ends = ends

    def __call__(
        self, episodes: int, random: np.random.Generator, ends: Callable[[int], bool] = lambda _: False
    ) -> tuple[Vector, int] | None:
        """Run some episodes; return their discounted returns, and the total number of time steps.

        The random numbers of an episode and time step depend neither on the policy nor on other episodes.

        Args:
            episodes: How many.
            random: The source of random numbers.
            ends: Told at each time step how many have ended; where it returns True, there is no result.
        """
        sampler = self._sampler
        returns = np.zeros(episodes)
        states = sampler.first(random.random(episodes))
        actions = self._batch.begin(states, random.random(episodes))
        decisions, waited, going = np.ones_like(states), np.zeros_like(states), np.arange(episodes)
        weight: float | Vector = 1.0 if self._discounts is None else np.ones(episodes)
        moves = time = 0
        goes = ~sampler.ended[states]
        while True:
            if not goes.all():
                states, actions, decisions = states[goes], actions[goes], decisions[goes]
                waited, going = waited[goes], going[goes]
                weight = weight[goes] if isinstance(weight, np.ndarray) else weight
                self._batch.keep(goes)
            if not len(going):
                return returns, moves
            if ends(episodes - len(going)):
                return None
            returns[going] += weight * sampler.rewards[states, actions]
            weight = weight * (self._discount if self._discounts is None else self._discounts[states, actions])
            time += 1
            moves += len(going)
            if time >= self._ends.moves:
                return returns, moves
            numbers = random.random((3, episodes))[:, going]
            states, seen = sampler.move(states, actions, numbers)
            goes = (decisions < self._ends.decisions) & ~sampler.ended[states]
            if self._ends.moves < math.inf:
                goes &= weight >= _REST  # after long actions that is sooner
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
    """A time step of an episode.

    Attributes:
        state: The state before the action.
        belief: The belief, or its support; None for policies over states.
        action: The action: that of the last decision.
        seen: The last observation; None at the first decision, and for no observation.
        decided: Whether there was a decision at this time step.
    """

    state: int
    belief: Vector | Support | None
    action: int
    seen: int | None
    decided: bool


class EpisodeRunner:
    """Runs one episode of a policy at a time.

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
        """Yield the time steps of an episode until no further reward is possible; the caller may stop before."""
        model, sampler, controller = self._model, self._sampler, self._controller
        sees, false_negative = controller.takes == "state", model.false_negative
        sampler.seed(seed)
        state, seen, waited = sampler.first_state(), None, 0
        if sees:
            step = controller.start(state)
        else:
            assert model.pomdp is not None
            knows = controller.symbols.num_states is not None  # not so for a plan without values
            step = controller.start(model.pomdp.belief_at_start(state) if knows else None)
        decided = True
        while not self._ended[state] and waited < _LONGEST:
            known = None if sees else controller.information.current
            belief = known if isinstance(known, np.ndarray | Support) else controller.belief
            yield EpisodeStep(state, belief, step.action, seen, decided)
            if controller.over:
                return
            before, state = state, sampler.next_state(state, step.action)
            if sees:
                step = controller.see(state)
                continue
            seen = sampler.observation(step.action, before, state)
            decided = seen is not None and seen != false_negative
            if decided:
                step, waited = controller.observe(seen), 0  # a prediction, if it is impossible by rounding
            else:
                seen, waited = None, waited + 1


def one_by_one(
    model: MDP,
    policy: Any,
    ends: Limits,
    *,
    episodes: int,
    seed: int,
    discounts: Vector | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[Vector, int]:
    """Run episodes one at a time, for policies of any kind.

    Args:
        model: The model.
        policy: The policy.
        ends: The end of an episode.
        episodes: How many.
        seed: Of their random numbers.
        discounts: Of each state and action, S x A; by default that of the model.
        progress: Told at each time step how many have ended; where it returns True, there are no more.

    Returns:
        The discounted returns of those that have ended, and the total number of time steps.
    """
    run, rewards, discount = EpisodeRunner(model, policy), model.rewards, model.discount
    returns, moves = np.zeros(episodes), 0
    for episode, stream in enumerate(np.random.SeedSequence(seed).spawn(episodes)):
        weight, total, decisions, time = 1.0, 0.0, 0, 0
        for step in run(stream):
            total += weight * float(rewards[step.state, step.action])
            weight *= discount if discounts is None else float(discounts[step.state, step.action])
            time += 1
            decisions += step.decided
            if decisions >= ends.decisions or time >= ends.moves or (weight < _REST and ends.moves < math.inf):
                break
            if progress is not None and progress(episode, episodes) is True:
                return returns[:episode], moves
        returns[episode] = total
        moves += time
    return returns, moves
