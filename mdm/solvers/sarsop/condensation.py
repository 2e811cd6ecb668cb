"""Condensation: a small plan that earns what a large set of alpha vectors promises, with values computed anew.

A vector is only worth what it says while the vectors that it was made of are there. So the vectors that are chosen at
the beliefs of a good plan become nodes of a finite-state controller (E. A. Hansen, *Solving POMDPs by searching in
policy space*, UAI 1998): each has its action, and after each observation the node whose vector is the best for what is
then believed, over all visits to the node, weighted by how likely and how soon they are. The controller's own values,
those of a linear system, replace the vectors. Each of them is at most the value of its action followed by others of
them, and so the policy that chooses by them earns no less than the greatest at the initial belief.

Cost of a round: the entries of P(s', o | s, a) of a block for each node of it, times the vectors of the next block to
choose among.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.models.compressed import csr

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.sarsop.layout import Layout

    Indices = npt.NDArray[np.intp]

__all__ = ["Condensed", "Controller", "Vectors", "condensed"]

_ROUNDS = 60
_PUSHES = 6
_CHUNK = 2_000_000
"""Numbers that are held at once for some nodes and what may follow them."""
_CLOSE = 1e-10
"""The error of the linear system's solution, as a share of the rewards."""
_ITERATIONS, _SWEEPS = 300, 10
_ROUNDING = 1e-13


class Vectors(NamedTuple):
    """Alpha vectors over blocks of equal width.

    Attributes:
        values: N x Y.
        actions: N.
        blocks: N.
    """

    values: Vector
    actions: Indices
    blocks: Indices

    def only(self, which: npt.NDArray[np.integer]) -> Vectors:
        """Return some of them."""
        return Vectors(self.values[which], self.actions[which], self.blocks[which])


class Condensed(NamedTuple):
    """A plan.

    Attributes:
        vectors: Its nodes.
        lower: Its value at the initial belief.
        followers: The nodes that may follow each node.
    """

    vectors: Vectors
    lower: float
    followers: list[Indices]


class _Steps(NamedTuple):
    """What may follow an action in a block: P(s', o | s, a), with a column for each pair of o and s' that is possible.

    Columns are ordered by observation.
    """

    matrix: Matrix
    transposed: Matrix
    observations: Indices
    places: Indices
    blocks: Indices


class Controller:
    """Vectors as the nodes of a controller.

    Args:
        layout: The model.
        vectors: The nodes, with the values that they are said to have.
        defaults: The node of each block for observations that none else was chosen for.
    """

    def __init__(self, layout: Layout, vectors: Vectors, defaults: Indices) -> None:
        self._layout = layout
        self._vectors = vectors
        self._defaults = defaults
        self._width = vectors.values.shape[1]
        self._steps: dict[tuple[int, int], _Steps] = {}
        symbols = int(layout.observations.columns.max()) + 1
        self._after = np.full((len(vectors.actions), symbols), -1)

    @cached_property
    def _of_block(self) -> list[Indices]:
        return [np.flatnonzero(self._vectors.blocks == block) for block in range(len(self._defaults))]

    def _groups(self, nodes: Indices) -> Iterator[tuple[Indices, _Steps, int, int]]:
        """Yield nodes of one action and block, not too many at once, with their steps, action and block."""
        pairs = self._vectors.actions[nodes] * len(self._defaults) + self._vectors.blocks[nodes]
        order = np.argsort(pairs, kind="stable")
        for part in np.split(nodes[order], np.flatnonzero(np.diff(pairs[order])) + 1):
            action, block = int(self._vectors.actions[part[0]]), int(self._vectors.blocks[part[0]])
            steps = self._steps_of(action, block)
            size = max(1, _CHUNK // len(steps.places))
            for begin in range(0, len(part), size):
                yield part[begin : begin + size], steps, action, block

    def _steps_of(self, action: int, block: int) -> _Steps:
        if (action, block) not in self._steps:
            self._steps[action, block] = _steps(self._layout, action, block)
        return self._steps[action, block]

    def _followers(self, nodes: Indices, steps: _Steps) -> Indices:
        """Return the node after each column of the steps."""
        after = self._after[nodes][:, steps.observations]
        return np.where(after >= 0, after, self._defaults[steps.blocks])

    def visits(self, start: Vector, before: Vector | None, goes_on: Callable[[], bool]) -> Vector:
        """Return the discounted number of visits to each state with each node, N x Y, as far as some steps tell."""
        visits = start if before is None else before
        for _ in range(_PUSHES):
            if not goes_on():
                break
            ahead: Vector = start.ravel().copy()
            for group, steps, _, _ in self._groups(np.flatnonzero(visits.any(axis=1))):
                weights = self._layout.discount * (steps.transposed @ visits[group].T).T
                places = self._followers(group, steps) * self._width + steps.places
                ahead += np.bincount(places.ravel(), weights.ravel(), minlength=len(ahead))
            visits = ahead.reshape(start.shape)
        return visits

    def choose(self, visits: Vector, slack: float, goes_on: Callable[[], bool]) -> bool:
        """Choose the node after each observation: the best for the states that it is reached in.

        Args:
            visits: N x Y.
            slack: What may be lost, for each visit, for a node that has been chosen already.
            goes_on: False ends it; some nodes are then followed as before.

        Returns:
            Whether a choice has changed.
        """
        used = np.asarray(visits.any(axis=1))
        changed = False
        for group, steps, _, _ in self._groups(np.flatnonzero(used)):
            if not goes_on():
                break
            weights = (steps.transposed @ visits[group].T).T
            begins = np.flatnonzero(np.diff(steps.observations, prepend=-1))
            for begin, end in zip(begins, [*begins[1:], len(steps.places)], strict=True):
                some = np.flatnonzero(weights[:, begin:end].any(axis=1))
                places, block = steps.places[begin:end], int(steps.blocks[begin])
                best = self._best(weights[some, begin:end], block, places, used, slack)
                used[best] = True
                at = group[some], steps.observations[begin]
                changed = changed or bool((self._after[at] != best).any())
                self._after[at] = best
        return changed

    def _best(self, seen: Vector, block: int, places: Indices, used: npt.NDArray[np.bool_], slack: float) -> Indices:
        """Return the best node of a block for each row of weights of some of its places."""
        nodes = self._of_block[block]
        scores = seen @ self._vectors.values[np.ix_(nodes, places)].T
        rows = np.arange(len(seen))
        best = scores.argmax(axis=1)
        if not used[nodes].any():
            return np.asarray(nodes[best])
        known = np.flatnonzero(used[nodes])
        other = known[scores[:, known].argmax(axis=1)]
        near = scores[rows, other] >= scores[rows, best] - slack * seen.sum(axis=1)
        return np.asarray(nodes[np.where(near, other, best)])

    def followers(self) -> list[Indices]:
        """Return the nodes that may follow each node."""
        result = [np.empty(0, dtype=np.intp)] * len(self._after)
        for group, steps, _, _ in self._groups(np.arange(len(self._after))):
            for node, after in zip(group.tolist(), self._followers(group, steps), strict=True):
                result[node] = np.unique(after)
        return result

    def reached(self, roots: Indices) -> Controller:
        """Return the controller of some nodes and all that may follow them, with those of blocks by default."""
        kept = np.zeros(len(self._after), dtype=np.bool_)
        kept[roots] = kept[self._defaults] = True
        front = np.flatnonzero(kept)
        while len(front):
            after = np.unique(self._after[front])
            after = after[after >= 0]
            front = after[~kept[after]]
            kept[front] = True
        place = np.cumsum(kept) - 1
        result = Controller(self._layout, self._vectors.only(np.flatnonzero(kept)), place[self._defaults])
        after = self._after[kept]
        result._after = np.where(after >= 0, place[after], -1)
        result._steps = self._steps
        return result

    def evaluated(self, goes_on: Callable[[], bool] = lambda: True) -> Vectors:
        """Return the vectors with lower bounds of the nodes' own values, near to them where the system is solved.

        Where it may not go on, the bounds are those that begin it, with what is lost for ever.
        """
        from scipy.sparse.linalg import LinearOperator, bicgstab  # noqa: PLC0415 - slow to import

        begin = self._vectors.values
        nodes = np.arange(len(begin))
        discount = self._layout.discount
        rewards = np.stack([self._rewards(node) for node in nodes.tolist()]).ravel()

        def ahead(given: Vector) -> Vector:
            values = given.reshape(begin.shape)
            result = np.empty_like(values)
            for group, steps, _, _ in self._groups(nodes):
                result[group] = discount * (steps.matrix @ values[self._followers(group, steps), steps.places].T).T
            return result.ravel()

        system = LinearOperator((begin.size, begin.size), matvec=lambda x: x - ahead(x), dtype=np.float64)
        close = _CLOSE * (1 - discount)

        def check(_: Vector) -> None:
            if not goes_on():
                raise TimeoutError

        found = begin.ravel()
        with np.errstate(all="ignore"), suppress(TimeoutError):  # it may break down
            found, _ = bicgstab(system, rewards, x0=found, rtol=close, atol=0.0, maxiter=_ITERATIONS, callback=check)
        if not np.isfinite(found).all():
            found = begin.ravel()
        least = 0.0
        for _ in range(_SWEEPS):
            backed = rewards + ahead(found)
            least = float((backed - found).min())
            found = backed
            if not goes_on():
                break
        # What a backup lowers by no more than so much is a bound when it is lowered by that for ever.
        loss = min(0.0, discount * least / (1 - discount)) - _ROUNDING * float(np.abs(found).max())
        return self._vectors._replace(values=(found + loss).reshape(begin.shape))

    def _rewards(self, node: int) -> Vector:
        first = self._layout.first_state[self._vectors.blocks[node]]
        return self._layout.rewards[self._vectors.actions[node], first : first + self._width]


def _steps(layout: Layout, action: int, block: int) -> _Steps:
    first, end = layout.first_state[block : block + 2]
    transitions, observations = layout.transitions, layout.observations
    rows = np.arange(first, end) + transitions.first[action]
    sizes = np.diff(transitions.starts.astype(np.int64))[rows]
    entries = _stretches(transitions.starts[rows].astype(np.int64), sizes)
    states = np.repeat(np.arange(end - first), sizes)
    after = transitions.columns[entries].astype(np.int64)
    told = after + observations.first[action]
    counts = np.diff(observations.starts.astype(np.int64))[told]
    signs = _stretches(observations.starts[told].astype(np.int64), counts)
    size = layout.rewards.shape[1]
    chances = np.repeat(transitions.values[entries], counts) * observations.values[signs]
    pairs = observations.columns[signs].astype(np.int64) * size + np.repeat(layout.state[after], counts)
    columns, places = np.unique(pairs, return_inverse=True)
    if not len(columns):  # nothing is ever detected: a column of zeros
        columns = np.array([first])
    starts = np.concatenate(([0], np.cumsum(np.bincount(np.repeat(states, counts), minlength=int(end - first)))))
    matrix = csr((chances, places, starts), (int(end - first), len(columns)))
    reached = columns % size
    blocks = layout.block[reached].astype(np.intp)
    return _Steps(matrix, csr(matrix.T), columns // size, reached - layout.first_state[blocks], blocks)


def _stretches(starts: Indices, sizes: Indices) -> Indices:
    ends = np.cumsum(sizes)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - sizes, sizes) + np.repeat(starts, sizes)


def condensed(
    layout: Layout,
    vectors: Vectors,
    defaults: Indices,
    start: Vector,
    roots: Indices,
    *,
    slack: float,
    goes_on: Callable[[], bool] = lambda: True,
    evaluates_on: Callable[[], bool] = lambda: True,
) -> Condensed:
    """Return the vectors of a small plan.

    Args:
        layout: The model.
        vectors: Those to choose among.
        defaults: A vector for each block.
        start: The initial belief, X x Y: a row for each block.
        roots: The best vector in each block of the initial belief.
        slack: What may be lost at a belief for a vector less.
        goes_on: False ends the search for a plan.
        evaluates_on: False ends the evaluation of the one that was found.
    """
    controller = Controller(layout, vectors, defaults)
    begin = np.zeros_like(vectors.values)
    begin[roots] = start[vectors.blocks[roots]]
    visits: Vector | None = None
    for _ in range(_ROUNDS):
        visits = controller.visits(begin, visits, goes_on)
        if not controller.choose(visits, slack, goes_on) or not goes_on():
            break
    reached = controller.reached(roots)
    found = reached.evaluated(evaluates_on)
    lower = 0.0
    for block in np.flatnonzero(start.any(axis=1)):
        lower += float((found.values[found.blocks == block] @ start[block]).max())
    return Condensed(found, lower, reached.followers())
