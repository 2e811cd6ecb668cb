"""How X is reached: the most probable way into it, and the decision that contributes most."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from mdm.policies import FiniteStateController, StochasticPolicy
from mdm.verification.chains import Chain, chain_of_policy
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
_FORWARD = 1_000
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


def likeliest_way(model: MDP, chain: Chain, choices: Choices) -> Way | None:
    """Return the most probable way of a chain, given before X or Y as well, from its start into X; else None."""
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

    Candidates are those that are visited often, and where a step of another action lowers it much; of these it is
    computed exactly where the policy would lead with another action there for ever.
    """
    whole = float(chain.start @ values)
    if whole < _LEAST or len(chain.state) > _SIZE:
        return None
    nodes = isinstance(policy, FiniteStateController)
    if not nodes and len(chain.state) != len(model.state_space):
        return None
    groups: Any = np.arange(len(chain.state)) // len(model.state_space) if nodes else chain.state
    best: tuple[float, int, int] | None = None
    for group, action in _candidates(model, asked, chain, values, groups):
        if (changed := _changed(policy, chain, group, action)) is None:
            continue
        other = chain_of_policy(model, changed)
        assert other is not None
        found = float(other.start @ reach(other.before(asked), greatest=True).values)
        if found < whole - _LEAST and (best is None or found < best[0]):
            best = found, group, action
    if best is None:
        return None
    found, group, action = best
    names = model.action_space.names
    first = int(np.flatnonzero(groups == group)[0])
    does = names[int(chain.weights[first, :-1].argmax())]
    where = f"node {group}" if nodes else model.state_space.names[group]
    return Decision(where, does, names[action], found)


def _candidates(model: MDP, asked: Specification, chain: Chain, values: Vector, groups: Any) -> list[tuple[int, int]]:
    """Return groups of states of the chain that share a decision, and an action each, the most promising first."""
    size, count = len(model.state_space), len(model.action_space)
    visits, at = np.zeros(len(values)), chain.start.copy()
    going = 1 - np.maximum(chain.chances(asked.target), chain.chances(asked.miss))
    for _ in range(_FORWARD):
        visits += at
        at = np.asarray((at * going) @ chain.moves)
        if at.sum() < _LEAST:
            break
    visits = np.minimum(visits, 1)
    blocks = values.reshape(-1, size)
    found: list[tuple[float, int, int]] = []
    for action in range(count):
        after = np.stack([np.asarray(model.transition_matrix(action) @ block) for block in blocks]).ravel()
        worth = np.where(asked.target[chain.state, action], 1.0, after)
        if asked.before is not None:
            worth[asked.before[chain.state, action] & ~asked.target[chain.state, action]] = 0
        stays = np.asarray(model.transition_matrix(action).diagonal())[chain.state]
        alone = np.where(stays < 1, (worth - stays * values) / np.where(stays < 1, 1 - stays, 1), worth)
        alone[(stays == 1) & ~asked.target[chain.state, action]] = 0
        gains = visits * np.where(chain.weights[:, action] < 1, values - alone, 0)
        if model.available is not None:
            gains[~model.available[chain.state, action]] = 0
        sums = np.bincount(groups, weights=gains)
        first = np.argsort(-sums)[:_TRIED].tolist()
        found += [(float(sums[group]), group, action) for group in first if sums[group] > _LEAST]
    return [(group, action) for _, group, action in sorted(found, reverse=True)[:_TRIED]]


def _changed(policy: Any, chain: Chain, group: int, action: int) -> Any:
    """Return a policy with another action at one of its decisions; None for the end of a plan."""
    if isinstance(policy, FiniteStateController):
        if group >= policy.num_nodes:
            return None
        actions = list(policy.actions)
        actions[group] = action
        return FiniteStateController(
            actions, policy.successors, policy.num_actions, values=policy.values, start=policy.start
        )
    weights = chain.weights[:, :-1].T.copy()
    weights[:, group] = 0
    weights[action, group] = 1
    return StochasticPolicy(weights)
