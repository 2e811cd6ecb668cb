"""Long-run shares of steps in which X holds, from each state.

By any choices a run ends up in an end component for ever. In each the best share g is that of one policy, by
policy iteration on g + h = r + P h (M. Puterman, *Markov decision processes*, 1994, chapter 9). For the bias h of a
policy, g is at most the greatest of r + P h - h over all choices, which bounds the error. Which component is best to
end up in is a question of reaching.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_array, eye_array, vstack
from scipy.sparse.linalg import splu

from mdm.models.matrices import csr
from mdm.verification.choices import Choices, Graph, components, end_components
from mdm.verification.optimum import first_best
from mdm.verification.reaching import Reached, reach

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

    Indices = npt.NDArray[np.integer]

_IMPROVED = 1_000
_CLOSE = 1e-11


def share(choices: Choices, counts: Vector, *, greatest: bool) -> Reached:
    """Return the least or greatest long-run share of steps in which X holds, from each state.

    None of the choices reaches anything; ``counts`` has the probability that X holds where each is made.
    """
    if not greatest:
        found = share(choices, 1 - counts, greatest=True)
        return found._replace(values=1 - found.values)
    component, stays = end_components(choices, np.ones(len(choices.state), dtype=bool))
    worth = np.zeros(choices.size)
    chosen = choices.firsts[:-1].copy()
    error = 0.0
    groups = np.argsort(component, kind="stable")
    for states in np.split(groups, np.flatnonzero(np.diff(component[groups])) + 1):
        if component[states[0]] < 0:
            continue
        first, last = np.searchsorted(choices.state, [states, states + 1])
        rows = np.concatenate([np.arange(*ends) for ends in zip(first, last, strict=True)])
        rows = rows[stays[rows]]
        gain, picked, wrong = _within(choices, rows, states, counts)
        worth[states], chosen[states] = gain, picked
        error = max(error, wrong)
    return _ending(choices, component, worth, chosen, error)


def _ending(choices: Choices, component: Indices, worth: Vector, chosen: Indices, error: float) -> Reached:
    """Return the best expectation of the worth of the component in which a run stays.

    A choice more of each state that may stay ends there, and counts its worth.
    """
    ends = np.flatnonzero(component >= 0)
    state = np.concatenate([choices.state, ends])
    order = np.argsort(state, kind="stable")
    moves = csr(vstack([choices.moves, csr((len(ends), choices.size))], format="csr"))[order]
    hit = np.concatenate([choices.hit, worth[ends]])[order]
    last = np.concatenate([np.zeros(len(choices.state)), np.ones(len(ends))])[order]
    original = np.concatenate([np.arange(len(choices.state)), chosen[ends]])[order]
    found = reach(Choices(moves, hit, last - hit, state[order], original), greatest=True)
    stays = np.zeros(int(component.max()) + 2, dtype=bool)  # the last is for states of no component
    stays[component[last[found.chosen] > 0]] = True
    stays[-1] = False
    picked = np.where(stays[component], chosen, original[found.chosen])
    return Reached(found.values, picked, max(error, found.error))


def _within(choices: Choices, rows: Indices, states: Indices, counts: Vector) -> tuple[float, Indices, float]:
    """Return the greatest share within an end component, a choice for each of its states, and the error.

    ``rows`` are the choices that stay in it.
    """
    number = np.empty(choices.size, dtype=np.int64)
    number[states] = np.arange(len(states))
    part = choices.subset(rows)
    own = Choices(csr(part.moves[:, states]), part.hit, part.miss, number[part.state], part.action)
    order = np.argsort(own.state, kind="stable")
    own, rows, reward = own.subset(order), rows[order], counts[rows[order]]
    firsts = own.firsts
    found = firsts[:-1].copy()
    best: tuple[float, Indices, float] = (-1.0, found, np.inf)
    for _ in range(_IMPROVED):
        found, gain, bias = _gained(own, found, reward)
        worth = reward + own.moves @ bias - bias[own.state]
        top = np.maximum.reduceat(worth, firsts[:-1])
        error = float(max(top.max() - gain, 0.0))
        if gain > best[0] + _CLOSE or error < best[2]:
            best = gain, found, error
        better = top > worth[found] + _CLOSE
        if not better.any():
            break
        found = np.where(better, first_best(worth, own.state, top), found)
    return best[0], rows[best[1]], best[2]


def _gained(own: Choices, found: Indices, reward: Vector) -> tuple[Indices, float, Vector]:
    """Return choices by which all states end up in the best recurrent class, its share, and the bias."""
    chain = csr(own.moves[found])
    labels = components(chain)
    rows = np.repeat(np.arange(own.size), np.diff(chain.indptr))
    closed = np.ones(int(labels.max()) + 1, dtype=bool)
    closed[labels[rows][labels[rows] != labels[chain.indices]]] = False
    best, its = -1.0, np.empty(0, dtype=np.int64)
    for label in np.flatnonzero(closed):
        states = np.flatnonzero(labels == label)
        gain = _solved(csr(chain[states][:, states]), reward[found[states]])[0]
        if gain > best:
            best, its = gain, states
    if closed.sum() > 1:
        inside = np.zeros(own.size, dtype=bool)
        inside[its] = True
        _, by = Graph(own).attracted(inside, np.zeros(len(own.state), dtype=bool))
        found = np.where(by >= 0, by, found)
        chain = csr(own.moves[found])
    gain, bias = _solved(chain, reward[found], int(its[0]))
    return found, gain, bias


def _solved(chain: Matrix, reward: Vector, fixed: int = 0) -> tuple[float, Vector]:
    """Return the share g and the bias h of a chain of one recurrent class, with h = 0 at a state of that class."""
    size = chain.shape[0]
    at_fixed = csr((np.ones(1), np.array([fixed]), np.array([0, 1])), (1, size))
    system = block_array([[eye_array(size) - chain, csr(np.ones((size, 1)))], [at_fixed, None]], format="csc")
    solved = splu(system).solve(np.append(reward, 0.0))
    return float(solved[-1]), solved[:-1]
