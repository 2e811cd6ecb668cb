"""Durations: how long actions take, and the model whose discounted values are those of a process in real time.

A semi-Markov decision process decides when an action is over. Its action lasts a random time tau, and a reward is worth
the discount to the power of the seconds that have gone by since the start. `in_time` gives the Markov decision process
with the same values: each transition is taken with the share D(s, a) / max D, where D is the expectation of the
discount to the power of tau, and what is left of its probability ends in a state of no reward (M. L. Puterman, *Markov
Decision Processes*, 1994, section 11.3, has the values). It is for solving alone: beliefs move with the model itself.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from mdm.errors import ModelError
from mdm.models.matrices import csr, numbers, read_only
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

__all__ = ["OVER", "Durations", "discounts_in_time", "in_time"]

OVER = "over"
"""The name of the state that takes up what time has discounted."""


class Durations:
    """How long each action takes in each state: a sum of equal exponential stages (Erlang), one by default.

    More stages vary less: the standard deviation is the mean divided by the root of their number.

    Args:
        means: The expected seconds: S x A numbers, A numbers for all states alike, or one for all.
        stages: The number of stages, from 1, in the same forms.

    Raises:
        ModelError: If a mean is not positive or a number of stages is no whole number from 1.

    Example::

        drive = mdm.models.Durations([[12.0, 3.0], [8.0, 3.0]], stages=[4, 1])
    """

    def __init__(self, means: npt.ArrayLike, stages: npt.ArrayLike = 1) -> None:
        self.means: Vector = read_only(numbers(means, "the durations"))
        """The expected seconds, as they were given."""
        counts = numbers(stages, "the stages")
        if self.means.ndim > 2 or counts.ndim > 2:
            raise ModelError("durations are S x A numbers, A numbers, or one")
        if not self.means.size or not counts.size:
            raise ModelError("there are none: durations are S x A numbers, A numbers, or one")
        try:
            np.broadcast_shapes(self.means.shape, counts.shape)
        except ValueError:
            raise ModelError(
                f"the durations have the shape {self.means.shape}, their stages {counts.shape}: they do not go together"
            ) from None
        wrong = ~(np.isfinite(self.means) & (self.means > 0))
        if wrong.any():
            raise ModelError(f"a duration is {self.means[wrong].flat[0]:g}: give seconds above 0")
        if not (np.isfinite(counts) & (counts >= 1) & (counts == np.round(counts))).all():
            raise ModelError("the stages of a duration are whole numbers from 1")
        self.stages: Vector = read_only(counts)
        """The numbers of stages, as they were given."""

    def table(self, model: MDP) -> tuple[Vector, Vector]:
        """Return the means and the stages for each state and action of a model, S x A each.

        Raises:
            ModelError: If they are for other numbers of states or actions.
        """
        shape = len(model.state_space), len(model.action_space)
        try:
            return np.broadcast_to(self.means, shape), np.broadcast_to(self.stages, shape)
        except ValueError:
            given = self.means.shape if np.ndim(self.stages) == 0 else (self.means.shape, self.stages.shape)
            raise ModelError(
                f"the durations have the shape {given}; the model has {shape[0]} states and {shape[1]} actions"
            ) from None

    def discounts(self, model: MDP) -> Vector:
        """Return D(s, a), the expected discount of an action's whole duration, S x A.

        A model's discount is that of a second.
        """
        means, stages = self.table(model)
        rate = -math.log(model.discount)
        result: Vector = (1 + rate * means / stages) ** -stages
        return result

    def __repr__(self) -> str:
        return f"<Durations: {self.means.min():g} to {self.means.max():g} s>"


def discounts_in_time(model: MDP, durations: Durations) -> Vector:
    """Return D(s, a), S x A, of a model whose actions may take time.

    Raises:
        ModelError: If the durations are none, or the model's discount is 1, its observations are events, or one is a
            false negative; or if an action is so short that its discount is 1, or all are so long that it is 0.
    """
    if not isinstance(durations, Durations):
        raise ModelError(f"durations are mdm.models.Durations(…), not {durations!r}")
    if model.discount >= 1:
        raise ModelError("with a discount of 1 time costs nothing: leave the durations out")
    if model.event_observations or model.false_negative is not None:
        raise ModelError("durations are for observations of states, P(o | a, s'), none of which is a false negative")
    discounts = durations.discounts(model)
    if not 0 < discounts.max() < 1:
        short = "an action is so short that its time costs nothing"
        what = short if discounts.max() else "each action is so long that nothing counts after it"
        raise ModelError(f"at a discount of {model.discount:g} a second {what}: give the durations in seconds")
    return discounts


@overload
def in_time(model: POMDP, durations: Durations) -> POMDP: ...


@overload
def in_time(model: MDP, durations: Durations) -> MDP: ...


def in_time(model: MDP, durations: Durations) -> MDP:
    """Return the Markov decision process whose values are those of a model with durations.

    Rewards are paid when an action is decided. The result has a state more, the last, `OVER`, which nothing leaves.

    Args:
        model: The model; its discount is that of a second.
        durations: How long its actions take.

    Raises:
        ModelError: As of `discounts_in_time`.

    Example::

        forest = mdm.problems.forest()
        in_time = mdm.models.in_time(forest, mdm.models.Durations([[30.0, 2.0]] * 3))
        len(in_time.state_space), round(in_time.discount, 3)  # 4, 0.826
    """
    discounts = discounts_in_time(model, durations)
    discount = float(discounts.max())
    actions = range(len(model.action_space))
    transitions = [_scaled(model.transition_matrix(action), discounts[:, action] / discount) for action in actions]
    rewards = np.vstack([model.rewards, np.zeros(len(model.action_space))])
    over = OVER
    while over in model.state_space.names:
        over += "_"
    names = [*model.state_space.names, over]
    start = np.append(model.initial_belief, 0.0)
    common: dict[str, Any] = {"discount": discount, "states": names, "actions": model.action_space}
    common["initial_belief"] = start
    made: MDP
    if (pomdp := model.pomdp) is None:
        made = MDP(transitions, rewards, **common)
    else:
        observations = [_blind_at_last(pomdp.observation_matrix(action)) for action in actions]
        made = POMDP(transitions, observations, rewards, observation_names=pomdp.observation_space, **common)
    if model.available is not None:
        made.available = np.vstack([model.available, np.ones(len(model.action_space), dtype=bool)])
    return made


def _scaled(matrix: Matrix, shares: Vector) -> Matrix:
    """Return a transition matrix with so much of each row, what is left of it in a column more, and an end."""
    given, count = csr(matrix), len(shares)
    every = np.arange(count)
    before = np.repeat(every, np.diff(given.indptr))
    values = np.concatenate([given.data * shares[before], 1 - shares, [1.0]])
    rows, columns = [*before, *every, count], [*given.indices, *[count] * (count + 1)]
    return csr((values, (rows, columns)), (count + 1, count + 1))


def _blind_at_last(matrix: Matrix) -> Matrix:
    """Return an observation matrix with a row more, in which the first symbol is all that is seen."""
    given = csr(matrix)
    count, width = given.shape
    rows = np.append(np.repeat(np.arange(count), np.diff(given.indptr)), count)
    return csr((np.append(given.data, 1.0), (rows, np.append(given.indices, 0))), (count + 1, width))
