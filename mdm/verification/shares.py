"""Long-run shares of steps in which X holds, from each state.

By any choices a run ends up in an end component for ever. In each the best share g is that of one policy. Sweeps of
v = opt over choices of r + P v bound it by their least and greatest change, and are enough where runs mix soon; else
policy iteration solves g + h = r + P h (M. Puterman, *Markov decision processes*, 1994, chapters 8 and 9), and for a
bias h of any policy g is at most the greatest of r + P h - h over all choices. Which component is best to end up in is
a question of reaching.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_array, eye_array, vstack
from scipy.sparse.linalg import splu

from mdm.models.matrices import csr
from mdm.verification.choices import Choices, Graph, components, end_components
from mdm.verification.optimum import Optimum, first_best
from mdm.verification.reaching import reach

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

    Indices = npt.NDArray[np.integer]

_SWEEPS = 300
_IMPROVED = 1_000
_CLOSE = 1e-13


def share(choices: Choices, counts: Vector, *, greatest: bool) -> Optimum:
    """Return the least or greatest long-run share of steps in which X holds, from each state.

    None of the choices reaches anything; ``counts`` has the probability that X holds where each is made.
    """
    if not greatest:
        least = share(choices, 1 - counts, greatest=True)
        return least._replace(values=1 - least.values)
    size, none = choices.size, np.zeros(len(choices.state))
    component, stays = end_components(choices, none == 0)
    ends, rows = np.flatnonzero(component >= 0), np.flatnonzero(stays)
    its = choices.subset(rows)
    own = its._replace(moves=csr(its.moves[:, ends]), state=(np.cumsum(component >= 0) - 1)[its.state])
    gain, staying, error = _gains(own, counts[rows], component[ends])
    # A choice more of each state that may stay ends there, and earns the share of its component.
    state = np.concatenate([choices.state, ends])
    order = np.argsort(state, kind="stable")
    worth, last = np.concatenate([none, gain[component[ends]]]), np.concatenate([none, np.ones(len(ends))])
    moves = csr(vstack([choices.moves, csr((len(ends), size))], format="csr"))[order]
    original = np.concatenate([np.arange(len(none)), rows[staying]])[order]
    found = reach(Choices(moves, worth[order], (last - worth)[order], state[order], original), greatest=True)
    stay = np.zeros(len(gain) + 1, dtype=bool)  # the last is for states of no component
    stay[component[last[order][found.chosen] > 0]] = True
    chosen = original[found.chosen]
    chosen[ends] = np.where(stay[component[ends]], rows[staying], chosen[ends])
    return Optimum(found.values, chosen, max(error, found.error))


def _gains(own: Choices, reward: Vector, label: Indices) -> tuple[Vector, Indices, float]:
    """Return the greatest share within each end component, a choice for each state, and the error.

    The choices are those that stay in a component; ``label`` has that of each state.
    """
    firsts, values, count = own.firsts[:-1], np.zeros(own.size), int(label.max()) + 1
    for _ in range(_SWEEPS):
        worth = reward + own.moves @ values
        top = np.maximum.reduceat(worth, firsts)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(low, label, top - values)
        np.maximum.at(high, label, top - values)
        found, error = first_best(worth, own.state, top), float((high - low).max())
        if error <= _CLOSE:
            return low, found, error
        values = (values + top) / 2  # half of the steps stay, so that nothing has a period
    graph = Graph(own)
    for _ in range(_IMPROVED):
        found = _joined(own, graph, found, reward, label)
        low, bias = _solved(csr(own.moves[found]), reward[found], label)
        worth = reward + own.moves @ bias - bias[own.state]
        top = np.maximum.reduceat(worth, firsts)
        error = float(max((top - low[label]).max(), (low[label] - worth[found]).max()))
        better = top > worth[found] + 100 * _CLOSE
        if not better.any():
            break
        found = np.where(better, first_best(worth, own.state, top), found)
    return low, found, error


def _joined(own: Choices, graph: Graph, found: Indices, reward: Vector, label: Indices) -> Indices:
    """Return choices by which a component whose runs end up in several classes ends up in the best of them."""
    chain = csr(own.moves[found])
    classes = components(chain)
    rows = np.repeat(np.arange(own.size), np.diff(chain.indptr))
    closed = np.bincount(classes[rows], weights=classes[rows] != classes[chain.indices]) == 0
    its = np.flatnonzero(closed[classes])
    kinds, kind = np.unique(classes[its], return_inverse=True)
    several = np.bincount(label[its[np.unique(kind, return_index=True)[1]]]) > 1
    if not several.any():
        return found
    gains = _solved(csr(chain[its][:, its]), reward[found[its]], kind)[0]
    order = np.lexsort((gains[kind], label[its]))
    best = kind[order[np.searchsorted(label[its][order], np.arange(len(several)), side="right") - 1]]
    by = graph.attracted(np.isin(classes, kinds[best]), np.zeros(len(own.state), dtype=bool))[1]
    return np.where((by >= 0) & several[label], by, found)


def _solved(chain: Matrix, reward: Vector, kind: Indices) -> tuple[Vector, Vector]:
    """Return the share g of each kind of states and the bias h of each state, for one recurrent class of each kind."""
    size, first = chain.shape[0], np.unique(kind, return_index=True)[1]
    ones = np.ones(max(size, len(first)))
    its = csr((ones[:size], (np.arange(size), kind)), (size, len(first)))
    fixed = csr((ones[: len(first)], (np.arange(len(first)), first)), (len(first), size))
    system = block_array([[eye_array(size) - chain, its], [fixed, None]], format="csc")
    solved = splu(system).solve(np.append(reward, np.zeros(len(first))))
    return solved[size:], solved[:size]
