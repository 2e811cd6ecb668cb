"""The least or greatest values that choices lead to, with an error that is proved for the values of those found.

Where every choice of policies ends, the values are the one solution of v = opt over choices of c + P v. Sweeps in
topological order, block by block, find good choices (P. Dai, Mausam, D. Weld and J. Goldsmith, *Topological value
iteration algorithms*, JAIR 42, 2011); policy iteration ends them, each policy by one sparse solve.

For a chain, |v - x| <= max |c + P x - x| * w for each x, where w >= 1 + P w bounds its steps. For w an approximation
t of t = 1 + P t with a residual of at most h < 1 does, divided by 1 - h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import block_array, eye_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.sparse.linalg import LinearOperator, bicgstab, splu

from mdm.compilation import can_compile
from mdm.models.matrices import csr
from mdm.verification.choices import LARGE, components, graph_of, loops

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

    Indices = npt.NDArray[np.integer]
    Order = tuple[Indices, Indices]

_DENSE = 400
_CLOSE = 1e-14
"""The relative change of a value that counts as none."""
_GOOD = 1e-9
"""The error, of values up to 1, with which a solution is taken at once."""
_ROUGH = 1e-6
"""That of the expected steps, which only bound an error."""
_SWEEPS = 3_000
_BACKUPS = 300
_IMPROVED = 1_000
"""The most improvements of a policy."""


class Optimum(NamedTuple):
    """The best values of states.

    Args:
        values: A number for each state.
        chosen: The choice of each state.
        error: How far the values may be from those of the choices, and from the best, times the expected steps to the
            end: infinite where that could not be bounded.
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
    size, sign = moves.shape[1], 1.0 if greatest else -1.0
    if not size:
        return Optimum(np.empty(0), np.empty(0, dtype=np.int64), 0.0)
    firsts = np.searchsorted(state, np.arange(size + 1))
    order = _ordered(moves, state)
    single = len(state) == size
    found = firsts[:-1].copy() if chosen is None else chosen.copy()
    guess = None
    if not single and _sweeps(moves):
        guess = _swept(moves, state, constant, order, sign, found)
    elif not single:
        values = np.zeros(size)
        for _ in range(_BACKUPS):
            worth = sign * (constant + moves @ values)
            values = sign * np.maximum.reduceat(worth, firsts[:-1])
        found = first_best(worth, state, sign * values)
    values, steps, error = _valued(csr(moves[found]), constant[found], order, guess)
    if chosen is not None and not np.isfinite(error):
        found = chosen.copy()
        values, steps, error = _valued(csr(moves[found]), constant[found], order)
    for _ in range(_IMPROVED if not single else 0):
        worth = sign * (constant + moves @ values)
        best = np.maximum.reduceat(worth, firsts[:-1])
        better = best > worth[found] + 10 * _CLOSE * np.maximum(1.0, np.abs(best))
        gap = float((best - worth[found]).max())
        if not better.any():
            break
        found = np.where(better, first_best(worth, state, best), found)
        values, steps, error = _valued(csr(moves[found]), constant[found], order)
    return Optimum(values, found, error if single else error + max(gap, 0.0) * steps)


def first_best(worth: Vector, state: Indices, best: Vector) -> Indices:
    """Return the first choice of each state that is worth as much as its best one."""
    at_best = np.flatnonzero(worth == best[state])[::-1]
    first = np.zeros(len(best), dtype=np.int64)
    first[state[at_best]] = at_best
    return first


def _sweeps(moves: Matrix) -> bool:
    """Whether sweeps are worth it: they are slow unless compiled."""
    return moves.nnz > LARGE and can_compile()


def _ordered(moves: Matrix, state: Indices) -> Order:
    """Return the states, those that follow first and in a block those near its exits, and where blocks begin."""
    size = moves.shape[1]
    graph = graph_of(moves, state)
    labels = components(graph)
    leaves = np.bincount(state, weights=np.asarray(moves.sum(axis=1)).ravel() < 1 - 1e-9, minlength=size)
    back = block_array([[graph.T, None], [csr(leaves[None, :]), csr((1, 1))]], format="csr")
    near = np.full(size + 1, size)
    reached = breadth_first_order(back, size, return_predecessors=False)
    near[reached] = np.arange(len(reached))
    order = np.lexsort((near[:size], labels))
    return order, np.flatnonzero(np.diff(labels[order], prepend=-1, append=-2))


def _swept(
    moves: Matrix,
    state: Indices,
    constant: Vector,
    order: Order,
    sign: float,
    chosen: Indices,
    tolerance: float = _CLOSE,
) -> Vector:
    """Write good choices, and return values near theirs, by sweeps."""
    places, blocks = order
    rank = np.empty(len(places), dtype=np.int64)
    rank[places] = np.arange(len(places))
    lines = np.argsort(rank[state], kind="stable")
    rows = moves[lines]
    firsts = np.searchsorted(rank[state][lines], np.arange(len(places) + 1))
    back = np.empty(len(lines), dtype=np.int64)
    back[lines] = np.arange(len(lines))
    values, found = np.zeros(len(places)), back[chosen[places]]
    entries = rows.indptr.astype(np.int64), rank[rows.indices], rows.data
    settle = loops(moves).settle
    settle(entries, firsts, blocks, constant[lines], sign, values, found, tolerance, _SWEEPS)
    chosen[places] = lines[found]
    return np.asarray(values[rank])


def _valued(chain: Matrix, constant: Vector, order: Order, guess: Vector | None = None) -> tuple[Vector, float, float]:
    """Return the values of a chain, a bound of its expected steps, and one of the values' error."""
    size = len(constant)
    best: tuple[Vector, float, float] | None = None
    for values, times in _attempts(chain, constant, order, guess):
        rest = float(np.abs(constant + chain @ values - values).max())
        short = float(np.maximum(1 + chain @ times - times, 0).max())
        steps = float(times.max()) / (1 - short) if short < 1 and (times >= 0).all() else np.inf
        rounding = np.finfo(float).eps * (2 + int(np.diff(chain.indptr).max())) * max(1.0, float(np.abs(values).max()))
        error = float((rest + rounding) * steps)
        if not np.isfinite(values).all() or np.isnan(error):
            continue
        if best is None or error < best[2]:
            best = values, steps, error
        if best[2] <= _GOOD * max(1.0, float(np.abs(best[0]).max())):
            break
    return (np.zeros(size), np.inf, np.inf) if best is None else best


def _attempts(chain: Matrix, constant: Vector, order: Order, guess: Vector | None) -> Iterator[tuple[Vector, Vector]]:
    """Yield values of a chain and its expected steps, the sooner the cheaper they are."""
    size = len(constant)
    if size <= _DENSE:
        both = np.linalg.solve(np.eye(size) - chain.toarray(), np.column_stack([constant, np.ones(size)]))
        yield both[:, 0], both[:, 1]
        return
    if _sweeps(chain):
        alone = np.arange(size)
        values = _swept(chain, alone, constant, order, 1.0, alone.copy()) if guess is None else guess
        yield values, _swept(chain, alone, np.ones(size), order, 1.0, alone.copy(), _ROUGH)

    system = LinearOperator((size, size), matvec=lambda x: x - chain @ x, dtype=np.float64)
    yield bicgstab(system, constant, rtol=_CLOSE, maxiter=500)[0], bicgstab(system, np.ones(size), rtol=1e-6)[0]
    factors = splu((eye_array(size) - chain).tocsc())
    values = factors.solve(constant)
    yield values + factors.solve(constant + chain @ values - values), factors.solve(np.ones(size))
