"""The tables of a tree search: a model as arrays, and bounds of values that do not depend on the tree.

For each first action a belief's value is bounded above by the values of known states (QMDP), and below by that of the
blind policy of this action; see `mdm.solvers.bounds`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.models.dynamics import Dynamics, Rows
from mdm.solvers.bounds import blind_values, known_state_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP

Whole = npt.NDArray[np.int64]
Real = npt.NDArray[np.float64]


class SearchTables(NamedTuple):
    """A model for compiled code.

    Attributes:
        transitions: P(s' | s, a): a row for each action and state.
        observations: A row for each action and next state; for events a row for each entry of ``transitions``. An
            MDP's observation is the next state. The index ``num_observations`` stands for no detection.
        by_transition: Whether the observations are events.
        num_observations: How many there are.
        rewards: R(s, a), S x A.
        discount: Below 1.
        upper: Upper bounds of the value of an action in a state, S x A.
        lower: Lower bounds of the value of plans in a state, S x N.
        actions: The first action of each plan.
    """

    transitions: Rows
    observations: Rows
    by_transition: bool
    num_observations: int
    rewards: Real
    discount: float
    upper: Real
    lower: Real
    actions: Whole


class SentTables(NamedTuple):
    """Tables for another process of this machine, which maps T, O and R from the file from which this one has them.

    Attributes:
        tables: The tables, where T and R are left out, and O if it is in the file as well.
        model: The model whose T, O and R they are.
    """

    tables: SearchTables
    model: MDP


_LEFT_OUT = Rows(np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.uint32), np.zeros(0))


def sent(tables: SearchTables, model: MDP) -> SentTables:
    """Return the tables of a model without the parts that another process can map from a file."""
    tables = tables._replace(transitions=_LEFT_OUT, rewards=np.zeros((0, 0)))
    if model.pomdp is None or tables.by_transition or model.false_negative is not None:
        return SentTables(tables, model)  # what is observed is made for the search
    return SentTables(tables._replace(observations=_LEFT_OUT), model)


def received(given: SearchTables | SentTables) -> SearchTables:
    """Return tables that another process has sent, with the parts left out."""
    if isinstance(given, SearchTables):
        return given
    dynamics = Dynamics(given.model)
    tables = given.tables._replace(transitions=dynamics.transitions, rewards=_rewards(dynamics))
    return tables if len(tables.observations.starts) else tables._replace(observations=dynamics.observations)


def search_tables(model: MDP, *, upper: Real | None, lower: tuple[Real, Sequence[int]] | None) -> SearchTables:
    """Return a model as arrays.

    Args:
        model: The model.
        upper: See `SearchTables`; None computes it.
        lower: N x S values of plans, and the first action of each, beside those of blind policies.

    Raises:
        ModelError: If the discount is 1: values have no bounds then.
    """
    if model.discount >= 1:
        raise ModelError("a tree search needs a discount below 1: give the model one with with_discount(...)")
    dynamics = Dynamics(model)
    if model.pomdp is None:  # an MDP's observations are its next states
        num_observations = size = dynamics.num_states
        first = np.zeros(dynamics.num_actions, dtype=np.int64)
        starts, columns = np.arange(size + 1, dtype=np.uint64), np.arange(size, dtype=np.uint32)
        observations = Rows(first, starts, columns, np.ones(size))
    else:
        observations, num_observations = dynamics.observations, dynamics.num_observations
    if model.false_negative is not None:
        missed = observations.columns == model.false_negative
        columns = np.where(missed, np.uint32(num_observations), observations.columns)
        observations = observations._replace(columns=columns)
    values, actions = blind_values(dynamics), list(range(dynamics.num_actions))
    if lower is not None:
        values, actions = np.concatenate([values, lower[0]]), [*actions, *lower[1]]
    return SearchTables(
        transitions=dynamics.transitions,
        observations=observations,
        by_transition=dynamics.by_transition,
        num_observations=num_observations,
        rewards=_rewards(dynamics),
        discount=dynamics.discount,
        upper=known_state_values(dynamics) if upper is None else np.array(upper),
        lower=np.array(values.T, order="C"),
        actions=np.array(actions, dtype=np.int64),
    )


def _rewards(dynamics: Dynamics) -> Real:
    """Return R(s, a) as an array that may be written to, which is a kind of its own to compiled code."""
    mapped: Real | None = dynamics.model.stacked.get("R")
    return np.array(dynamics.rewards) if mapped is None else mapped
