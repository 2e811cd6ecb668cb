"""Diagnosis of a model: unreachable and absorbing states, actions without effect, impossible observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.events import DenseEvents, TransitionEvents

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP
    from mdm.models.space import Space

    Mask = npt.NDArray[np.bool_]

_NAMED = 5


def diagnose(model: MDP) -> list[str]:
    """Return the oddities of a model, a sentence each.

    They are states that are unreachable from the start; absorbing states; actions that never change the state;
    observations that never occur; factor values and agents' observations that occur in no possible state or
    observation.
    """
    states = model.state_space
    reached = reachable_states(model)
    found = []
    if not reached.all():
        found.append(f"{_some(states.names, ~reached, 'state')} cannot be reached from the start")
        found += _unused(states, reached, "value", "state factor")
    absorbing = np.asarray(np.all([_stays(matrix) for matrix in _distinct(model)], axis=0))
    if absorbing.any():
        found.append(f"{_some(states.names, absorbing, 'state')} are never left (absorbing)")
    actions = range(len(model.action_space))
    idle = np.array([_stays(model.transition_matrix(action)).all() for action in actions])
    if idle.any() and not absorbing.all():
        found.append(f"{_some(model.action_space.names, idle, 'action')} never change the state")
    if (pomdp := model.pomdp) is not None:
        seen = _observable(pomdp, reached)
        if not seen.all():
            found.append(f"{_some(pomdp.observation_space.names, ~seen, 'observation')} can never occur")
            found += _unused(pomdp.observation_space, seen, "observation", "agent")
    return found


def reachable_states(model: MDP) -> Mask:
    """Return which states are reachable from the start, by any actions."""
    reached = model.initial_belief > 0
    matrices = _distinct(model)
    fresh = reached.copy()
    while fresh.any():
        weights = fresh.astype(np.float64)
        after = sum((np.asarray(weights @ matrix) for matrix in matrices), np.zeros(len(reached))) > 0
        fresh = after & ~reached
        reached |= after
    return reached


def _distinct(model: MDP) -> list[Any]:
    every = (model.transition_matrix(action) for action in range(len(model.action_space)))
    return list({id(matrix): matrix for matrix in every}.values())


def _stays(matrix: Any) -> Mask:
    diagonal: Mask = np.asarray(matrix.diagonal()) >= 1
    return diagonal


def _observable(model: POMDP, reached: Mask) -> Mask:
    """Return which observations are possible in the reachable states."""
    seen = np.zeros(len(model.observation_space), dtype=bool)
    events = model.events
    for action in range(len(model.action_space)):
        transition = model.transition_matrix(action)
        if isinstance(events, DenseEvents):
            seen |= events.events[action][:, (transition > 0) & reached[:, None]].any(axis=1)
        elif isinstance(events, TransitionEvents):
            rows = np.repeat(np.arange(len(reached)), np.diff(transition.indptr))
            seen |= np.asarray(events.events[action].tocsr()[reached[rows]].sum(axis=0)).ravel() > 0
        else:
            after = np.asarray(reached.astype(np.float64) @ transition) > 0
            matrix = model.observation_matrix(action)
            seen |= np.asarray(after.astype(np.float64) @ matrix).ravel() > 0
    return seen


def _unused(space: Space, possible: Mask, what: str, of: str) -> list[str]:
    """Return the symbols of factors that occur in no possible joint symbol."""
    if len(space.factors) == 1:
        return []
    grid = possible.reshape(space.shape)
    found = []
    for axis, factor in enumerate(space.factors):
        others = tuple(other for other in range(grid.ndim) if other != axis)
        never = np.asarray(~grid.any(axis=others))
        if never.any():
            found.append(f"{_some(factor.names, never, what)} of {of} {factor.name!r} never occur")
    return found


def _some(names: Sequence[str], chosen: Mask, what: str) -> str:
    places = np.flatnonzero(chosen)
    listed = ", ".join(repr(names[int(place)]) for place in places[:_NAMED])
    more = ", …" if len(places) > _NAMED else ""
    return f"{len(places)} of {len(chosen)} {what}s ({listed}{more})"
