"""The least or greatest values that choices lead to, with an error.

Where every choice of policies ends, the values are the one solution of v = opt over choices of c + P v. Sweeps in
topological order, block by block, find good choices (P. Dai, Mausam, D. Weld and J. Goldsmith, *Topological value
iteration algorithms*, JAIR 42, 2011); policy iteration ends them, each policy by one sparse solve.

For a chain the error is proved: |v - x| <= max |c + P x - x| * w for each x, where w >= 1 + P w bounds its steps. For
w an approximation t of t = 1 + P t with a residual of at most h < 1 does, divided by 1 - h. For the best of several
choices the largest gain of another is added; that bounds the error where the best take no more steps than those found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import block_array, eye_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.sparse.linalg import bicgstab, splu

from mdm.compilation import can_compile
from mdm.models.matrices import csr
from mdm.verification.choices import LARGE, components, graph_of, loops

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

    Indices = npt.NDArray[np.integer]
    Order = tuple[Indices, Indices]

_DENSE = 400
_CLOSE = 1e-14
"""The relative change of a value that counts as none."""
_GOOD = 1e-9
"""The error, of values up to 1, with which a solution of a large system is taken at once."""
_SWEEPS = 3_000
_BACKUPS = 300
_IMPROVED = 1_000
"""The most improvements of a policy."""


class Optimum(NamedTuple):
    """The best values of states.

    Args:
        values: Of each state: a probability, or a number of steps, infinite where there may be no end.
        chosen: A choice for each state that attains it.
        error: How far the finite values may be from the truth; infinite where that could not be bounded.
    """

    values: Vector
    chosen: Indices
    error: float


def optimum(
    moves: Matrix, state: Indices, constant: Vector, *, greatest: bool, chosen: Indices | None = None
) -> Optimum:
    """Return the least or greatest values, and the choices.

    ``moves`` has the probabilities of going on, C x S, ``state`` the state of each choice, in order, ``constant`` how
    much it earns. ``chosen`` are choices that end for certain, to begin with; they are needed where not all do.
    """
    size = moves.shape[1]
    if not size:
        return Optimum(np.empty(0), np.empty(0, dtype=np.int64), 0.0)
    if not greatest:
        least = optimum(moves, state, -constant, greatest=True, chosen=chosen)
        return least._replace(values=-least.values)
    firsts = np.searchsorted(state, np.arange(size + 1))
    found = firsts[:-1].copy() if chosen is None else chosen.copy()
    values, order, way = np.zeros(size), None, 0
    if moves.nnz > LARGE and can_compile():
        order = _ordered(moves, state)
        values = _swept(moves, firsts, constant, order, found)
    elif len(state) > size:
        for _ in range(_BACKUPS):
            worth = constant + moves @ values
            values = np.maximum.reduceat(worth, firsts[:-1])
        found = first_best(worth, state, values)
    for _ in range(_IMPROVED):
        values, steps, error, way = _valued(csr(moves[found]), constant[found], values, order, way)
        if chosen is not None and not np.isfinite(error):
            found, chosen, values, way = chosen, None, np.zeros(size), 0
            continue
        worth = constant + moves @ values
        best = np.maximum.reduceat(worth, firsts[:-1])
        better = best > worth[found] + 10 * _CLOSE * np.maximum(1.0, np.abs(best))
        error += float((best - worth[found]).max()) * steps
        if not better.any() or (size > _DENSE and error <= _GOOD):
            break
        found = np.where(better, first_best(worth, state, best), found)
    return Optimum(values, found, error)


def first_best(worth: Vector, state: Indices, best: Vector) -> Indices:
    """Return the first choice of each state that is worth as much as its best one."""
    at_best = np.flatnonzero(worth == best[state])[::-1]
    first = np.zeros(len(best), dtype=np.int64)
    first[state[at_best]] = at_best
    return first


def _ordered(moves: Matrix, state: Indices) -> Order:
    """Return the states, those that follow first and in a block those near its exits, and where blocks begin."""
    size, graph = moves.shape[1], graph_of(moves, state)
    labels = components(graph)
    leaves = np.bincount(state, weights=np.asarray(moves.sum(axis=1)).ravel() < 1 - 1e-9, minlength=size)
    back = block_array([[graph.T, None], [csr(leaves[None, :]), csr((1, 1))]], format="csr")
    near = np.full(size + 1, size)
    reached = breadth_first_order(back, size, return_predecessors=False)
    near[reached] = np.arange(len(reached))
    order = np.lexsort((near[:size], labels))
    return order, np.flatnonzero(np.diff(labels[order], prepend=-1, append=-2))


def _swept(
    moves: Matrix, firsts: Indices, constant: Vector, order: Order, chosen: Indices, tolerance: float = _CLOSE
) -> Vector:
    """Write good choices, and return values near theirs, by sweeps over rows that lie in the order of the states."""
    places, blocks = order
    rank = np.argsort(places)
    lengths = np.diff(firsts)[places]
    begins = np.append(0, np.cumsum(lengths))
    lines = np.repeat(firsts[places] - begins[:-1], lengths) + np.arange(begins[-1])
    rows, values = moves[lines], np.zeros(len(places))
    found = begins[:-1] + chosen[places] - firsts[places]
    entries = rows.indptr.astype(np.int64), rank[rows.indices], rows.data
    loops(moves).settle(*entries, constant[lines], begins, blocks, values, found, tolerance, _SWEEPS)
    chosen[places] = lines[found]
    return np.asarray(values[rank])


def _valued(
    chain: Matrix, constant: Vector, guess: Vector, order: Order | None, first: int
) -> tuple[Vector, float, float, int]:
    """Return the values of a chain, a bound of its expected steps, one of the values' error, and the way they came.

    Of a small chain by elimination, else by the first way that is good: the guess and sweeps, iteration, elimination.
    """
    size, both = len(constant), np.column_stack([constant, np.ones(len(constant))])
    rounding = float(np.finfo(float).eps) * (2 + int(np.diff(chain.indptr).max()))
    system = csr(eye_array(size) - chain)
    best = np.zeros(size), np.inf, np.inf, 2
    for way in range(first, 3):
        if size <= _DENSE:
            solved = np.linalg.solve(system.toarray(), both)
        elif way == 0:
            if order is None:
                continue
            each = np.arange(size + 1)
            times = _swept(chain, each, both[:, 1], order, each[:-1].copy(), 1e-6)
            solved = np.column_stack([guess, times])
        elif way == 1:
            exact = bicgstab(system, constant, guess, rtol=_CLOSE, maxiter=500)[0]
            solved = np.column_stack([exact, bicgstab(system, both[:, 1], rtol=1e-6, maxiter=500)[0]])
        else:
            factors = splu(system.tocsc())
            solved = factors.solve(both)
            solved += factors.solve(both + chain @ solved - solved)
        rest, (values, times) = both + chain @ solved - solved, solved.T
        scale, short = max(1.0, float(np.abs(values).max())), float(rest[:, 1].max())
        steps = float(times.max()) / (1 - max(short, 0.0)) if short < 1 and (times >= 0).all() else np.inf
        error = (float(np.abs(rest[:, 0]).max()) + rounding * scale) * steps
        if error < best[2]:
            best = values, steps, error, way
        if best[2] <= _GOOD * scale or size <= _DENSE:
            break
    return best
