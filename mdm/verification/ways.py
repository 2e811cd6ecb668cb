"""How X is reached: the most probable way into it, and the decision that contributes most."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from mdm.models.matrices import csr
from mdm.policies import FiniteStateController, StochasticPolicy
from mdm.verification.chains import Chain, chain_of_policy
from mdm.verification.optimum import optimum
from mdm.verification.reaching import reach

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.specification import Specification
    from mdm.verification.choices import Choices

_TRIED = 8
"""Decisions whose alternatives are computed exactly."""
_SIZE = 50_000
"""States of a chain up to which they are."""
_LEAST = 1e-9


class Way(msgspec.Struct, frozen=True):
    """A way of a run, by names.

    Attributes:
        states: The states, the last one where X holds.
        actions: The action in each but the last; one more where X is about the last one's action.
        probability: The probability of just these states, from the start on.
    """

    states: tuple[str, ...]
    actions: tuple[str, ...]
    probability: float


class Decision(msgspec.Struct, frozen=True):
    """A decision of a policy, and its best alternative.

    Attributes:
        where: The state's name, or the node's number of a finite-state controller.
        action: The policy's action there.
        instead: The action that would lower the probability of reaching X most.
        probability: That probability, if the policy did that there, and nothing else otherwise.
    """

    where: str
    action: str
    instead: str
    probability: float


def likeliest_way(model: MDP, chain: Chain, choices: Choices, most: int | None = None) -> Way | None:
    """Return the most probable way of a chain, given before X or Y as well, from its start into X; else None.

    With ``most`` there is none if that way takes more steps.
    """
    size = choices.size
    entries = choices.moves.tocoo()
    ends, begins = np.flatnonzero(choices.hit), np.flatnonzero(chain.start)
    rows = np.concatenate([entries.row, ends, np.full(len(begins), size + 1)])
    columns = np.concatenate([entries.col, np.full(len(ends), size), begins])
    chances = np.concatenate([entries.data, choices.hit[ends], chain.start[begins]])
    lengths = np.maximum(-np.log(chances), 0) + 1e-12  # a certain step counts, so that the shortest is taken
    graph = coo_array((lengths, (rows, columns)), shape=(size + 2, size + 2)).tocsr()
    far, before = dijkstra(graph, indices=size + 1, return_predecessors=True)
    if not np.isfinite(far[size]):
        return None
    places = [int(before[size])]
    while (earlier := int(before[places[-1]])) != size + 1:
        places.append(earlier)
    if most is not None and len(places) > most + 1:
        return None
    places.reverse()
    names, actions = model.state_space.names, model.action_space.names
    taken = []
    for one, two in itertools.pairwise(places):
        likely = [
            weight * model.transition(action, int(chain.state[one]), int(chain.state[two])) if weight else 0.0
            for action, weight in enumerate(chain.weights[one, :-1].tolist())
        ]
        taken.append(actions[int(np.argmax(likely))] if any(likely) else "")
    probability = float(np.exp(-far[size] + 1e-12 * (len(places) + 1)))
    return Way(tuple(names[int(chain.state[each])] for each in places), tuple(taken), probability)


def worst_decision(model: MDP, policy: Any, asked: Specification, chain: Chain, values: Vector) -> Decision | None:
    """Return the decision whose best alternative lowers the probability of reaching X most; None if none does.

    Candidates are those with the largest product of expected visits and of the gain by one step of another action;
    of these it is computed exactly where the policy would lead with another action there for ever.
    """
    size, count, whole = len(model.state_space), len(model.action_space), float(chain.start @ values)
    nodes = isinstance(policy, FiniteStateController)
    if whole < _LEAST or len(values) > _SIZE or (not nodes and len(values) != size):
        return None
    number = policy.num_nodes if nodes else size
    groups = np.arange(len(values)) // size if nodes else np.arange(size)
    visits, inside = np.zeros(len(values)), np.flatnonzero(values)  # X is possible there, so that a run leaves them
    moves = csr(chain.before(asked).moves[inside][:, inside].T)
    visits[inside] = optimum(moves, np.arange(len(inside)), chain.start[inside], greatest=True).values
    gains = np.empty((number, count))
    for action in range(count):
        after = np.asarray(model.transition_matrix(action) @ values.reshape(-1, size).T).T.ravel()
        at = chain.state, np.full(len(values), action)
        worth = np.where(asked.target[at], 1.0, np.where(asked.miss[at], 0.0, after))
        other = chain.weights[:, action] < 1
        barred = np.zeros_like(other) if model.available is None else ~model.available[at]
        gain, possible, never = (
            np.bincount(groups, weights=visits * each)[:number] for each in (other * (values - worth), other, barred)
        )
        gains[:, action] = np.where((possible > 0) & (never == 0), gain, -np.inf)
    best = Decision("", "", "", whole - _LEAST)
    names = model.action_space.names
    for place in np.argsort(gains, axis=None, kind="stable")[::-1][:_TRIED].tolist():
        group, action = divmod(place, count)
        if gains[group, action] < -_LEAST:
            break
        if nodes:
            actions = [*policy.actions[:group], action, *policy.actions[group + 1 :]]
            kept = {"values": policy.values, "start": policy.start}
            changed: Any = FiniteStateController(actions, policy.successors, policy.num_actions, **kept)
        else:
            weights = chain.weights[:, :-1].T.copy()
            weights[:, group] = np.arange(count) == action
            changed = StochasticPolicy(weights)
        chain_there = chain_of_policy(model, changed)
        assert chain_there is not None
        found = float(chain_there.start @ reach(chain_there.before(asked), greatest=True).values)
        if found < best.probability:
            does = names[int(chain.weights[np.argmax(groups == group), :-1].argmax())]
            best = Decision(f"node {group}" if nodes else model.state_space.names[group], does, names[action], found)
    return best if best.action else None
