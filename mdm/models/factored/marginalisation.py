"""Marginalisation of a state factor on whose present value nothing else depends.

With x the rest of the state and f the factor, T'(y | x, a) is the sum over f' of T(y, f' | x, a), and P'(o | x, a, y)
the sum over f' of P(f' | x, a, y) P(o | x, a, y, f').
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelError
from mdm.models.events import TransitionEvents
from mdm.models.matrices import TOLERANCE, Checked, csr, stochastic_matrices
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP
from mdm.models.space import Space

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix

_SAME = 1e-9


def marginalize(model: MDP, name: str) -> MDP:
    """Return a model without one of its state factors.

    Raises:
        ModelError: If there is no such factor, it is the only one, or transitions or rewards depend on its present
            value.
    """
    factors = model.state_space.factors
    names = [factor.name for factor in factors]
    if name not in names:
        raise ModelError(f"there is no state factor {name!r}; there are {', '.join(names)}")
    if len(factors) == 1:
        raise ModelError(f"{name!r} is the only state factor: it cannot be dropped")
    at = names.index(name)
    states = Space(factor for index, factor in enumerate(factors) if index != at)
    every = np.arange(len(model.state_space)).reshape(model.state_space.shape)
    groups = np.moveaxis(every, at, 0).reshape(len(factors[at]), -1)  # the factor's values x the rest's
    rest = np.empty(len(model.state_space), dtype=np.intp)
    rest[groups] = np.arange(len(states))
    total = csr((np.ones(len(rest)), rest, np.arange(len(rest) + 1)), (len(rest), len(states)))

    rewards = model.rewards[groups[0]]
    rounding = _SAME * max(1.0, np.abs(model.rewards).max())
    if any(np.abs(model.rewards[group] - rewards).max() > rounding for group in groups[1:]):
        raise ModelError(f"the rewards depend on {name!r}: it cannot be dropped")
    actions = range(len(model.action_space))
    summed = [_summed(model.transition_matrix(action), groups, total, name, "transitions") for action in actions]
    # Events follow the order of T's entries in the result.
    transitions = Checked(
        stochastic_matrices(
            summed, what="T", actions=model.action_space, rows=states, columns=len(states), sparse_=True
        )
    )
    common: dict[str, Any] = {
        "discount": model.discount,
        "states": states,
        "actions": model.action_space,
        "initial_belief": np.bincount(rest, model.initial_belief),
        "sparse": True if model.is_sparse else None,
    }
    pomdp = model.pomdp
    if pomdp is None:
        return MDP(list(transitions), rewards, **common)
    joint = [
        [
            _summed(pomdp.joint_matrix(action, observation), groups, total, name, "observations")
            for observation in range(len(pomdp.observation_space))
        ]
        for action in actions
    ]
    common["observation_names"] = pomdp.observation_space
    of_states = [_of_states(transitions[action], joint[action]) for action in actions]
    if all(matrix is not None for matrix in of_states):
        return POMDP(list(transitions), of_states, rewards, **common)
    if not model.is_sparse:
        events = [
            [_quotient(matrix.toarray(), transitions[action].toarray()) for matrix in joint[action]]
            for action in actions
        ]
        return POMDP(list(transitions), events, rewards, event_observations=True, **common)
    by_transition = [_by_transition(transitions[action], joint[action]) for action in actions]
    kept = TransitionEvents(transitions, by_transition, actions=model.action_space, states=states)
    return POMDP(transitions, kept, rewards, **common)


def _summed(matrix: Matrix, groups: npt.NDArray[np.intp], total: Any, name: str, what: str) -> Any:
    """Return a matrix summed over the factor's next values; refuse one that depends on its present value."""
    compressed = csr(matrix)
    result = csr(compressed[groups[0]] @ total)
    for group in groups[1:]:
        difference = (compressed[group] @ total) - result
        if difference.nnz and abs(difference).max() > _SAME:
            raise ModelError(f"the {what} of the other factors depend on {name!r}: it cannot be dropped")
    result.sort_indices()
    return result


def _quotient(joint: Any, transition: Any) -> Any:
    return np.divide(joint, transition, out=np.zeros_like(joint), where=transition > 0)


def _by_transition(transition: Any, joint: list[Any]) -> Any:
    """Return P(o | x, a, y) as a transitions x O matrix."""
    rows = np.repeat(np.arange(transition.shape[0]), np.diff(transition.indptr))
    columns = [np.asarray(matrix[rows, transition.indices]).ravel() / transition.data for matrix in joint]
    return csr(np.stack(columns, axis=1))


def _of_states(transition: Any, joint: list[Any]) -> Any:
    """Return P(o | a, y) as a Y x O matrix; None if it depends on x."""
    events = _by_transition(transition, joint)
    dense = np.zeros((transition.shape[1], events.shape[1]))
    values = events.toarray()
    dense[transition.indices] = values
    differs = np.abs(dense[transition.indices] - values).max(initial=0) > _SAME
    if differs or np.abs(values.sum(axis=1) - 1).max(initial=0) > TOLERANCE:
        return None
    never = np.ones(len(dense), dtype=bool)
    never[transition.indices] = False
    dense[never] = 1 / dense.shape[1]  # never reached: any distribution will do
    return dense
