"""Durations: how long actions take, and the model whose discounted values are those of a process in real time.

A semi-Markov decision process decides when an action is over. Its action lasts a random time tau, and a reward is worth
the discount to the power of the seconds that have gone by since the start. `in_time` gives the Markov decision process
with the same values: each transition is taken with the share D(s, a) / max D, where D is the expectation of the
discount to the power of tau, and the rest of its probability ends in a state of no reward (M. L. Puterman, *Markov
Decision Processes*, 1994, section 11.3, has the values). It is for solving alone: beliefs move with the model itself.

A reward that is paid by time, at a rate r(s, a), adds its expected discounted integral to that of an action: r(s, a) (1
- D(s, a)) / alpha, where the discount of a time t is exp(-alpha t) (ibid., section 11.3.1).
"""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from mdm.errors import ModelError
from mdm.models.availability import standing_in
from mdm.models.matrices import csr, numbers, read_only
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP
from mdm.models.units import in_words, ratio

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

OVER = "over"
"""The name of the state that takes up the part that time has discounted."""


class Durations:
    """How long each action takes in each state: a sum of equal exponential stages (Erlang), one by default.

    More stages vary less: the standard deviation is the mean divided by the root of their number.

    Args:
        means: The expected seconds: S x A numbers, A numbers for all states alike, or one for all.
        stages: The number of stages, from 1, in the same forms.
        rates: The reward of each second, beside that of the model, which is paid once an action; in the same forms.
        of: The unit of means and rates: ``"second"``, or ``"step"`` for steps of the model.

    Raises:
        ModelError: If a mean is not positive, a number of stages is no whole number from 1, or a rate is not finite.

    Example::

        drive = mdm.models.Durations([[12.0, 3.0], [8.0, 3.0]], stages=[4, 1])
    """

    def __init__(
        self,
        means: npt.ArrayLike,
        stages: npt.ArrayLike = 1,
        rates: npt.ArrayLike = 0.0,
        *,
        of: Literal["step", "second"] = "second",
    ) -> None:
        if of not in ("step", "second"):
            raise ModelError(f"durations are of 'second' or of 'step', not {of!r}")
        self.of = of
        """The unit of means and rates."""
        self.means: Vector = read_only(numbers(means, "the durations"))
        """The expected times, as they were given."""
        counts = numbers(stages, "the stages")
        self.rates: Vector = read_only(numbers(rates, "the rates"))
        """The reward of a unit of time, as it was given."""
        given = {"stages": counts, "rates": self.rates}
        if self.means.ndim > 2 or any(each.ndim > 2 for each in given.values()):
            raise ModelError("durations are S x A numbers, A numbers, or one")
        if not self.means.size or not all(each.size for each in given.values()):
            raise ModelError("no durations were given: give S x A numbers, A numbers, or one")
        for name, each in given.items():
            try:
                np.broadcast_shapes(self.means.shape, each.shape)
            except ValueError:
                raise ModelError(
                    f"the durations have the shape {self.means.shape}, their {name} {each.shape}: they do not go "
                    f"together"
                ) from None
        if not np.isfinite(self.rates).all():
            raise ModelError("a rate of rewards is not finite")
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
            means, stages, _ = (np.broadcast_to(each, shape) for each in (self.means, self.stages, self.rates))
        except ValueError:
            shapes = (self.means.shape, self.stages.shape, self.rates.shape)
            given = shapes[: 1 + max((place for place in (1, 2) if shapes[place]), default=0)]
            given = given[0] if len(given) == 1 else given
            raise ModelError(
                f"the durations have the shape {given}; the model has {shape[0]} states and {shape[1]} actions"
            ) from None
        return means, stages

    def discounts(self, model: MDP) -> Vector:
        """Return D(s, a), the expected discount of an action's whole duration, S x A.

        Raises:
            ModelError: If they are for other numbers of states or actions, or it is not known how long a step takes.
        """
        means, stages = self.table(model)
        result: Vector = (1 + self.interest(model) * means / stages) ** -stages
        return result if model.available is None else np.asarray(standing_in(result, model.available))

    def interest(self, model: MDP) -> float:
        """Return alpha, where exp(-alpha) is the model's discount of the durations' unit.

        Raises:
            ModelError: If it is not known how long a step of the model takes.
        """
        by_steps = self.of == "step" and model.discount_of != "second"
        units = 1.0 if by_steps else ratio(model.discount_of, self.of)
        if units is None:
            raise ModelError(
                f"the model's discount is of {in_words(model.discount_of)}, the durations count {self.of}s, and mdm "
                f"has to know how long a step takes: say what the discount is of (--discount-of second, or the seconds "
                f"of a step; model.with_discount(…, of=…))"
            )
        return -math.log(model.discount) / units

    def rewards(self, model: MDP) -> Vector:
        """Return the expected discounted reward of each action while it lasts, S x A.

        Raises:
            ModelError: As of `discounts`.
        """
        if not self.rates.any():
            return model.rewards
        rates = np.broadcast_to(self.rates, model.rewards.shape)
        if model.available is not None:
            rates = standing_in(rates, model.available)
        result: Vector = model.rewards + rates * (1 - self.discounts(model)) / self.interest(model)
        return result

    def __repr__(self) -> str:
        unit = "s" if self.of == "second" else "steps"
        paid = ", with rewards by time" if self.rates.any() else ""
        return f"<Durations: {self.means.min():g} to {self.means.max():g} {unit}{paid}>"


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
        unit = in_words(model.discount_of)
        raise ModelError(f"at a discount of {model.discount:g} {unit} {what}: give the durations in {durations.of}s")
    return discounts


def paid_in_time(model: MDP, durations: Durations) -> MDP:
    """Return a model that pays at each decision the expected pay by time of its action, too.

    Raises:
        ModelError: As of `discounts_in_time`.
    """
    if not durations.rates.any():
        return model
    other = copy.copy(model.flatten())
    vars(other).update(_rewards=read_only(durations.rewards(model)), outcome_rewards=None, stacked={})
    return other


@overload
def in_time(model: POMDP, durations: Durations) -> POMDP: ...


@overload
def in_time(model: MDP, durations: Durations) -> MDP: ...


def in_time(model: MDP, durations: Durations) -> MDP:
    """Return the Markov decision process whose values are those of a model with durations.

    Rewards are paid when an action is decided, and those by time while it lasts. The result has a state more, the
    last, `OVER`, which nothing leaves.

    Args:
        model: The model; what its discount is of, the durations count, too, or it can be converted.
        durations: How long its actions take.

    Raises:
        ModelError: As of `discounts_in_time`.

    Example::

        forest = mdm.problems.forest()
        forest = forest.with_discount(forest.discount, of="second")
        in_time = mdm.models.in_time(forest, mdm.models.Durations([[30.0, 2.0]] * 3))
        len(in_time.state_space), round(in_time.discount, 3)  # 4, 0.826
    """
    discounts = discounts_in_time(model, durations)
    discount = float(discounts.max())
    actions = range(len(model.action_space))
    transitions = [_scaled(model.transition_matrix(action), discounts[:, action] / discount) for action in actions]
    rewards = np.vstack([durations.rewards(model), np.zeros(len(model.action_space))])
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
    """Return a transition matrix with so much of each row, the rest of it in a column more, and an end."""
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
