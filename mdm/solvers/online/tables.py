"""What a tree search looks ahead in: a model as arrays, and bounds of what its states are worth.

Bounds of a belief's value, for each action that may come first: above, that the state is known from then on (QMDP),
by value iteration from above, so that it may stop at any time; below, that the action goes on for ever (a blind
policy), by the same from below (M. Hauskrecht, *Value-function approximations for partially observable Markov decision
processes*, Journal of Artificial Intelligence Research 13, 2000). A sweep costs the non-zeros of all T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models import POMDP
from mdm.models.compressed import csr
from mdm.models.events import by_entry
from mdm.policies.blind_policy import blind_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP
    from mdm.models.matrices import Matrix

__all__ = ["Rows", "SearchTables", "known_state_values", "search_tables"]

Whole = npt.NDArray[np.int64]
Real = npt.NDArray[np.float64]

_CLOSE = 1e-6
_SWEEPS = 10_000


class Rows(NamedTuple):
    """Distributions, one a row, in CSR.

    Attributes:
        first: For each action the row where its own begin.
        starts: Where each row begins, and where the last ends.
        chances: The probabilities.
        symbols: What they are of.
    """

    first: Whole
    starts: Whole
    chances: Real
    symbols: Whole


class SearchTables(NamedTuple):
    """A model as compiled code reads it.

    Attributes:
        transitions: P(s' | s, a): a row for each action and state.
        observations: A row for each action and next state; for events a row for each entry of ``transitions``. An
            MDP's observation is the next state. One more than there are stands for no detection: for the false
            negative, and for events without an observation.
        by_entry: Whether the observations are events.
        num_observations: How many there are.
        rewards: R(s, a), S x A.
        discount: Below 1.
        upper: What an action is worth in a state at most, S x A.
        lower: What plans are worth in a state at least, S x N.
        actions: The first action of each plan.
    """

    transitions: Rows
    observations: Rows
    by_entry: bool
    num_observations: int
    rewards: Real
    discount: float
    upper: Real
    lower: Real
    actions: Whole


def search_tables(model: MDP, *, upper: Real | None, lower: tuple[Real, Sequence[int]] | None) -> SearchTables:
    """Return a model as arrays.

    Args:
        model: The model.
        upper: See `SearchTables`; None computes it.
        lower: N x S values of plans, and the first action of each; those of blind policies are there in any case.

    Raises:
        ModelError: If the discount is 1: nothing bounds the values of what never ends.
    """
    if model.discount >= 1:
        raise ModelError("a tree search needs a discount below 1: give the model one with with_discount(...)")
    flat = model.flatten()
    count = len(flat.action_space)
    matrices = [flat.transition_matrix(a) for a in range(count)]
    events = flat.events if isinstance(flat, POMDP) else None
    # Rows of events belong to the entries of T: actions with one T in common have it once each then.
    transitions = _rows(matrices, shared=events is None)
    if events is not None:
        observations = _rows([by_entry(events, a, matrix) for a, matrix in enumerate(matrices)])
    elif isinstance(flat, POMDP):
        observations = _rows([flat.observation_matrix(a) for a in range(count)])
    else:
        states = np.arange(len(flat.state_space) + 1)
        observations = Rows(np.zeros(count, dtype=np.int64), states, np.ones(len(states) - 1), states[:-1])
    if isinstance(flat, POMDP) and flat.false_negative is not None:
        observations.symbols[observations.symbols == flat.false_negative] = len(flat.observation_space)
    values = blind_values(np.ascontiguousarray(flat.rewards.T), matrices, flat.discount, _CLOSE)
    actions = list(range(count))
    if lower is not None:
        values, actions = np.concatenate([values, lower[0]]), [*actions, *lower[1]]
    return SearchTables(
        transitions=transitions,
        observations=observations,
        by_entry=events is not None,
        num_observations=len(flat.observation_space) if isinstance(flat, POMDP) else len(flat.state_space),
        rewards=np.array(flat.rewards),
        discount=flat.discount,
        upper=known_state_values(flat) if upper is None else np.array(upper),
        lower=np.array(values.T, order="C"),
        actions=np.array(actions, dtype=np.int64),
    )


def known_state_values(model: MDP) -> Real:
    """Return Q(s, a) of acting with the state known, S x A: never too small, and by less than 1e-6 too large."""
    rewards, discount = model.rewards, model.discount
    values = np.full(rewards.shape, rewards.max() / (1 - discount))
    for _ in range(_SWEEPS):
        best = values.max(axis=1)
        newer = np.empty_like(values)
        for action in range(rewards.shape[1]):
            newer[:, action] = rewards[:, action] + discount * (model.transition_matrix(action) @ best)
        done = np.abs(values - newer).max() * discount <= _CLOSE * (1 - discount)
        values = newer
        if done:
            break
    return values


def _rows(matrices: Sequence[Matrix], *, shared: bool = True) -> Rows:
    """Return the rows of a matrix per action; one object that stands for several is kept once, where they may share."""
    begins: dict[int, int] = {}
    first: list[int] = []
    kept: list[Any] = []
    count = 0
    for action, matrix in enumerate(matrices):
        key = id(matrix) if shared else action
        if key not in begins:
            begins[key] = count
            kept.append(csr(matrix, copy=False))
            count += matrix.shape[0]
        first.append(begins[key])
    return Rows(
        np.array(first, dtype=np.int64),
        np.concatenate(([0], np.cumsum(np.concatenate([np.diff(matrix.indptr) for matrix in kept])))).astype(np.int64),
        np.concatenate([matrix.data for matrix in kept]),
        np.concatenate([matrix.indices for matrix in kept]).astype(np.int64),
    )
