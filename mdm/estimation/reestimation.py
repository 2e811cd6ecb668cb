"""Re-estimation: the model in use, with what was counted in place of what was assumed.

A row of the old model weighs as much as one visit: its estimate is (n_j + p_j) / (n + 1). So rows that were never
visited stay as they are, rows that were visited often are their frequencies, and what the old model holds possible
stays possible: beliefs meet no observation of probability 0 that they did not meet before.
"""

from __future__ import annotations

import math
from copy import copy
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.estimation.rows import support
from mdm.models.matrices import Vector, csr, is_compressed, read_only
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mdm.estimation.rows import Row
    from mdm.models.matrices import Matrix

__all__ = ["WEIGHT", "blended", "expected_reward", "possible", "reestimated", "replaced"]

WEIGHT = 1.0
"""The visits that a row of the old model weighs as much as."""

Changes = dict[int, list[tuple[int, npt.NDArray[np.intp], Vector]]]
"""Other rows of T, by action: the state, those that follow, and their probabilities."""


def blended(row: Row) -> Vector:
    """Return the probabilities of a row in the new model."""
    result: Vector = (row.counts + WEIGHT * row.model) / (row.counts.sum() + WEIGHT)
    return result


def reestimated(model: MDP, transitions: Iterable[Row], observations: Iterable[Row] = ()) -> MDP:
    """Return a model with the rows that were estimated, and all else of the old one; flat, and of the same kind.

    Rows of jumps, which leave out staying, share what the old row leaves for them.

    Args:
        model: The model in use, whose rows weigh as much as one visit.
        transitions: Rows of T.
        observations: Rows of O.
    """
    flat = model.flatten()
    changes: Changes = {}
    for row in transitions:
        matrix = flat.transition_matrix(row.action)
        before = np.array([matrix[row.state, symbol] for symbol in row.symbols.tolist()])
        share = float(before.sum())
        if share > 0:
            new = share * blended(msgspec.structs.replace(row, model=before / share))
            changes.setdefault(row.action, []).append((row.state, row.symbols, new))
    seen = None if flat.pomdp is None or flat.event_observations else _seen(flat.pomdp, observations)
    actions = range(len(flat.action_space))
    matrices = [_with_rows(flat.transition_matrix(action), changes.get(action, [])) for action in actions]
    return replaced(flat, matrices, seen)


def _seen(model: POMDP, rows: Iterable[Row]) -> list[Matrix]:
    changes: Changes = {}
    for row in rows:
        changes.setdefault(row.action, []).append((row.state, row.symbols, blended(row)))
    actions = range(len(model.action_space))
    return [_with_rows(model.observation_matrix(action), changes.get(action, [])) for action in actions]


def _with_rows(matrix: Matrix, changes: Sequence[tuple[int, npt.NDArray[np.intp], Vector]]) -> Matrix:
    """Return a matrix with other numbers at some places of some rows."""
    if not changes:
        return matrix
    if is_compressed(matrix):
        other = csr(matrix).tolil()
        for row, columns, values in changes:
            other[row, columns] = values
        return other.tocsr()
    dense = np.array(matrix)
    for row, columns, values in changes:
        dense[row, columns] = values
    return dense


def replaced(flat: MDP, transitions: Sequence[Matrix], observations: Sequence[Matrix] | None) -> MDP:
    """Return a flat model with other matrices; observations of events stay as they are."""
    names: dict[str, Any] = {
        "discount": flat.discount,
        "states": flat.state_space,
        "actions": flat.action_space,
        "initial_belief": flat.initial_belief,
        "available": flat.available,
        "sparse": flat.is_sparse,
    }
    if flat.pomdp is None:
        return _earning(flat, MDP(transitions, flat.rewards, outcome_rewards=flat.outcome_rewards, **names))
    seen: Any = observations
    if observations is None:
        count = range(len(flat.pomdp.observation_space))
        seen = [[flat.pomdp.event_matrix(a, o) for o in count] for a in range(len(flat.action_space))]
    result = POMDP(
        transitions,
        seen,
        flat.rewards,
        observation_names=flat.pomdp.observation_space,
        event_observations=observations is None,
        outcome_rewards=flat.outcome_rewards,
        **names,
    )
    return _earning(flat, result.with_false_negatives(flat.false_negative))


def possible(model: MDP, number: int) -> Iterator[MDP]:
    """Yield models that records leave possible: an estimated one, with rows drawn from its posterior.

    A row has the Dirichlet distribution of which it is the mean, by the visits that it rests on and the weight of the
    old model. Of a network these are the rows of each factor; those that are equal are drawn as one.
    """
    assert model.visits is not None
    flat, generator = model.flatten(), np.random.default_rng(0)
    matrices = [flat.transition_matrix(action) for action in range(len(flat.action_space))]
    sizes = [len(flat.state_space)] if model.network is None else [len(each) for each in flat.state_space.factors]
    rows = np.concatenate([m.toarray() if is_compressed(m) else m for m in matrices]).reshape(-1, *sizes)
    for _ in range(number):
        new = np.ones(rows.shape)
        for axis, size in enumerate(sizes, 1):
            own = rows.sum(axis=tuple({*range(1, rows.ndim)} - {axis})).round(12)
            means, places = own, np.arange(len(own))
            if model.network is not None:
                means, places = np.unique(own, axis=0, return_inverse=True)
            weights = np.zeros((len(means), 1))
            np.maximum.at(weights[:, 0], places.ravel(), WEIGHT + model.visits.T.ravel())
            drawn = np.where(means > 0, np.maximum(generator.gamma(means * weights), 1e-300), 0)
            shape = [-1, *(size if other == axis else 1 for other in range(1, rows.ndim))]
            new *= (drawn / drawn.sum(axis=1, keepdims=True))[places.ravel()].reshape(shape)
        yield replaced(flat, list(new.reshape(len(matrices), *[len(flat.state_space)] * 2)), None)


def _earning(old: MDP, new: MDP) -> MDP:
    """Return a new model with the expectations of the old one's rewards of outcomes."""
    new = new.timed_as(old)
    if old.outcome_rewards is None:
        return new
    rewards = np.array(new.rewards)
    for state, action in np.ndindex(*rewards.shape):
        symbols, row = support(new.transition_matrix(action), state)
        rewards[state, action] = expected_reward(new, action, state, symbols, row)
    other = copy(new)
    vars(other)["_rewards"] = read_only(rewards)
    return other


def expected_reward(model: MDP, action: int, state: int, symbols: npt.NDArray[np.intp], row: Vector) -> float:
    """Return R(s, a) of rewards of outcomes, where so probable states follow."""
    outcomes, pomdp, total = model.outcome_rewards, model.pomdp, 0.0
    assert outcomes is not None
    for following, probability in zip(symbols.tolist(), row.tolist(), strict=True):
        if pomdp is None:
            total += probability * outcomes.at(action, state, following, None)
            continue
        chances = pomdp.observation(action, following, state=state)
        told = np.flatnonzero(chances).tolist()
        total += probability * math.fsum(chances[o] * outcomes.at(action, state, following, o) for o in told)
    return total
