"""Condensation: a small plan that keeps the promise of a large set of alpha vectors, with values computed again.

A vector is only worth what it says while the vectors that it was made of are there. So the vectors that are chosen at
the beliefs of a good plan become nodes of a finite-state controller (E. A. Hansen, *Solving POMDPs by searching in
policy space*, UAI 1998): each has its action, and after each observation the node whose vector is the best for what is
then believed, over all visits to the node, weighted by how likely and how soon they are. The controller's own values,
those of a linear system, replace the vectors. Each of them is at most the value of its action followed by others of
them, and so the policy that chooses by them earns no less than the greatest at the initial belief. A plan is improved
by its own values: the followers of each node are chosen again among the nodes, while that makes it better.

Cost of a round: for each node the entries of T in its block, and for each observation the states that it is made in
times the vectors to choose among.

The linear system is solved as far as there is time, by the stabilised method of biconjugate gradients (H. A. van der
Vorst, *Bi-CGSTAB*, SIAM Journal on Scientific and Statistical Computing 13, 1992). Its residual goes up and down, so
the values with the least one are kept; where it breaks down, or comes no nearer for a while, it begins again after a
step of value iteration, which always comes nearer. Cost of an iteration: two products, and some passes over ten arrays.
Arrays are multiplied by numpy alone: the threads of its libraries wait for each other where cores are busy.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.models.matrices import csr

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector
    from mdm.solvers.sarsop.graph import Layout, Scratch

    Part = Callable[[float], Callable[[], bool]]
    Indices = npt.NDArray[np.intp]

CHOICE, EVALUATION = 5, 14
"""Arrays as large as a plan's vectors that are held while nodes are chosen among, and while they are evaluated."""
_ROUNDS, _UNDAMPED = 60, 16
"""Rounds at most, and those in which nodes are chosen for the latest visits; after that it is for the mean of them."""
_SETTLED = 1e-2
"""The part of all visits from which on changes after them count."""
_SEARCH = 0.5
"""The part of the time that is left in which nodes are chosen; the rest is for their evaluation."""
_PUSHES = 6
_CHUNK = 2_000_000
"""Numbers that are held at once for some nodes and their followers."""
_CLOSE = 1e-10
"""The least loss of the linear system's solution, as a share of the rewards."""
_LOSS = 0.1
"""The same, as a part of the loss of a choice."""
_SOLUTION = 0.8
"""The part of the time for their evaluation in which the system is solved; the rest is for a backup that certifies."""
_ROUNDING = 1e-13
_FINER = 1e-2
"""The loss when nodes are chosen among again, as a part of the loss before."""
_RARE = 1e-2
"""The loss where a rare observation is followed by anything is at most this part of the loss of a choice."""


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


class _Sign(NamedTuple):
    """An observation that may follow an action in a block.

    Attributes:
        observation: Its index.
        block: The block that it is made in.
        arrivals: Where it is made, among the arrivals of the steps.
        places: Their places in the block.
        chances: Of each arrival, its chance there.
    """

    observation: int
    block: int
    arrivals: Indices | slice
    places: Indices | slice
    chances: Vector


class _Steps(NamedTuple):
    """The effects of an action in a block: T to the arrivals that it reaches, its transpose, and the observations."""

    ahead: Matrix
    back: Matrix
    signs: list[_Sign]


class Kernels(NamedTuple):
    """Compiled steps from node to node, see `mdm.solvers.sarsop.search`, and the room that they need."""

    follow: Callable[..., None]
    arrive: Callable[..., None]
    scratch: Scratch

    @staticmethod
    def nodes_at_once(layout: Layout) -> int:
        """Return how many nodes are followed in about a hundredth of a second."""
        entries = len(layout.transitions.values) + len(layout.observations.values)
        return max(1, _CHUNK * len(layout.rewards) // max(entries, 1))


class Controller:
    """Vectors as the nodes of a controller.

    Args:
        layout: The model.
        vectors: The nodes, with the values that they are said to have.
        defaults: The node of each block for observations that none else was chosen for.
        after: The node after each node and observation, -1 for the default; all of them by default.
        kernels: Compiled counterparts of products of matrices.
    """

    def __init__(
        self,
        layout: Layout,
        vectors: Vectors,
        defaults: Indices,
        after: Indices | None = None,
        kernels: Kernels | None = None,
    ) -> None:
        self._layout = layout
        self._kernels = kernels
        self.vectors = vectors
        self._defaults = defaults
        self._width = vectors.values.shape[1]
        self._steps: dict[tuple[int, int], _Steps] = {}
        symbols = int(layout.observations.columns.max()) + 1
        self._after = np.full((len(vectors.actions), symbols), -1) if after is None else after

    @property
    def _table(self) -> tuple[Indices, ...]:
        return self.vectors.actions, self.vectors.blocks, self._after, self._defaults

    @cached_property
    def _of_block(self) -> list[Indices]:
        return [np.flatnonzero(self.vectors.blocks == block) for block in range(len(self._defaults))]

    def _groups(self, nodes: Indices) -> Iterator[tuple[Indices, _Steps]]:
        """Yield nodes of one action and block, not too many at once, with their steps."""
        pairs = self.vectors.actions[nodes] * len(self._defaults) + self.vectors.blocks[nodes]
        order = np.argsort(pairs, kind="stable")
        for part in np.split(nodes[order], np.flatnonzero(np.diff(pairs[order])) + 1):
            if not len(part):
                continue
            key = int(self.vectors.actions[part[0]]), int(self.vectors.blocks[part[0]])
            if key not in self._steps:
                self._steps[key] = _steps(self._layout, *key)
            steps = self._steps[key]
            size = max(1, _CHUNK // max(steps.ahead.shape[1], len(self._after)))
            for begin in range(0, len(part), size):
                yield part[begin : begin + size], steps

    def _followers(self, nodes: Indices, sign: _Sign) -> Indices:
        """Return the node after an observation, of each of some nodes."""
        after = self._after[nodes, sign.observation]
        return np.asarray(np.where(after >= 0, after, self._defaults[sign.block]))

    def visits(self, start: Vector, before: Vector | None, goes_on: Callable[[], bool]) -> Vector:
        """Return the discounted number of visits to each state with each node, N x Y, as far as some steps tell."""
        visits = start if before is None else before
        begin = np.flatnonzero(start.any(axis=1))
        for _ in range(_PUSHES):
            ahead = np.zeros(start.shape)  # its rows take memory only where there are visits
            ahead[begin] = start[begin]
            if self._kernels is not None:
                nodes, size = np.flatnonzero(visits.any(axis=1)), self._kernels.nodes_at_once(self._layout)
                for part in range(0, len(nodes), size):
                    if not goes_on():
                        return visits
                    some = nodes[part : part + size]
                    self._kernels.arrive(self._layout, *self._table, visits, self._kernels.scratch, some, ahead)
                visits = ahead
                continue
            for group, steps in self._groups(np.flatnonzero(visits.any(axis=1))):
                if not goes_on():
                    return visits
                self._push(visits[group], group, steps, ahead)
            visits = ahead
        return visits

    def _push(self, visits: Vector, group: Indices, steps: _Steps, ahead: Vector) -> None:
        """Add the visits that follow those to some nodes."""
        arrived = _product(steps.back, visits) * self._layout.discount
        for sign in steps.signs:
            followers = self._followers(group, sign)
            order = np.argsort(followers, kind="stable")
            starts = np.flatnonzero(np.diff(followers[order], prepend=-1))
            reached = followers[order[starts]]
            weights = arrived[order][:, sign.arrivals] * sign.chances
            rows = ahead[reached]
            rows[:, sign.places] += np.add.reduceat(weights, starts, axis=0)
            ahead[reached] = rows

    def choose(self, visits: Vector, slack: float, goes_on: Callable[[], bool]) -> float:
        """Choose the node after each observation: the best for the states that it is reached in.

        Args:
            visits: N x Y.
            slack: The loss, for each visit, for a node that is used already, and for the one chosen before.
            goes_on: False ends it; some nodes are then followed as before.

        Returns:
            The visits after which a choice has changed.
        """
        used = np.asarray(visits.any(axis=1))
        least = _RARE * slack / max(float(np.ptp(self.vectors.values)), np.finfo(np.float64).tiny)
        changed = 0.0
        for group, steps in self._groups(np.flatnonzero(used)):
            if not goes_on():
                break
            arrived = _product(steps.back, visits[group])
            for sign in steps.signs:
                if not goes_on():
                    break
                weights = arrived[:, sign.arrivals] * sign.chances
                mass = weights.sum(axis=1)
                some = np.flatnonzero(mass > least)
                if len(some):
                    at = group[some], sign.observation
                    best = self._best(weights[some], sign, self._after[at], used, slack)
                    used[best] = True
                    changed += float(mass[some][self._after[at] != best].sum())
                    self._after[at] = best
        return changed

    def _best(
        self, weights: Vector, sign: _Sign, before: Indices, used: npt.NDArray[np.bool_], slack: float
    ) -> Indices:
        """Return the best nodes after an observation for rows of weights of the places that it is made in."""
        nodes = self._of_block[sign.block]
        values = self.vectors.values
        if len(nodes) < len(values):
            values = values[nodes]
        scores = weights @ values[:, sign.places].T
        lost = slack * weights.sum(axis=1)
        scores -= np.multiply.outer(lost, ~used[nodes])
        known = np.flatnonzero(before >= 0)
        scores[known, np.searchsorted(nodes, before[known])] += lost[known]
        return np.asarray(nodes[scores.argmax(axis=1)])

    def followers(self) -> list[Indices]:
        """Return the nodes that may follow each node."""
        result = [np.empty(0, dtype=np.intp)] * len(self._after)
        for group, steps in self._groups(np.arange(len(self._after))):
            if steps.signs:
                table = np.stack([self._followers(group, sign) for sign in steps.signs], axis=1)
                for node, after in zip(group.tolist(), table, strict=True):
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
        result = Controller(
            self._layout, self.vectors.only(np.flatnonzero(kept)), place[self._defaults], kernels=self._kernels
        )
        after = self._after[kept]
        result._after = np.where(after >= 0, place[after], -1)
        result._steps = self._steps
        return result

    def of(self, vectors: Vectors, *, chosen: bool = False) -> Controller:
        """Return the controller with other values of its nodes, with its choices or none yet."""
        result = Controller(
            self._layout, vectors, self._defaults, self._after.copy() if chosen else None, self._kernels
        )
        result._steps = self._steps
        return result

    def evaluated(self, part: Part = lambda _: lambda: True, loss: float = 0.0) -> Vectors | None:
        """Return the vectors with lower bounds of the nodes' own values, near to them where the system is solved.

        None where there is no time for a backup of all nodes, which certifies them.

        Args:
            part: Returns a function that tells whether there is time left of a share of the present rest.
            loss: How far below the nodes' own values the bounds may be, but for rounding.
        """
        discount = self._layout.discount
        rewards = self._layout.rewards.reshape(-1, len(self._defaults), self._width)
        earned = rewards[self.vectors.actions, self.vectors.blocks]
        close = (1 - discount) * max(loss, _CLOSE * float(np.abs(earned).max()))
        goes_on = part(_SOLUTION)
        found = solved(lambda values: self._ahead(values, goes_on), earned, self.vectors.values, close)
        try:
            backed = earned + self._ahead(found, part(1.0))
        except TimeoutError:
            return None
        # What a backup lowers by no more than so much is a bound when it is lowered by that for ever.
        lost = min(0.0, discount * float((backed - found).min()) / (1 - discount))
        return self.vectors._replace(values=backed + lost - _ROUNDING * float(np.abs(backed).max()))

    def _ahead(self, values: Vector, goes_on: Callable[[], bool]) -> Vector:
        """Return the worth of the nodes' successors, discounted, where each has some values."""
        result = np.empty_like(values)
        if self._kernels is not None:
            count, size = len(values), self._kernels.nodes_at_once(self._layout)
            for begin in range(0, count, size):
                if not goes_on():
                    raise TimeoutError
                self._kernels.follow(
                    self._layout, *self._table, values, self._kernels.scratch, begin, min(begin + size, count), result
                )
            return result
        for group, steps in self._groups(np.arange(len(values))):
            told = np.zeros((len(group), steps.ahead.shape[1]))
            for sign in steps.signs:
                if not goes_on():
                    raise TimeoutError
                told[:, sign.arrivals] += values[self._followers(group, sign)][:, sign.places] * sign.chances
            result[group] = self._layout.discount * _product(steps.ahead, told)
        return result


def _steps(layout: Layout, action: int, block: int) -> _Steps:
    begin, end = (int(place) for place in layout.first_state[block : block + 2])
    transitions, observations = layout.transitions, layout.observations
    row = int(transitions.first[action])
    starts = transitions.starts[row + begin : row + end + 1].astype(np.int64)
    entries = slice(starts[0], starts[-1])
    arrivals, columns = np.unique(transitions.columns[entries].astype(np.int64), return_inverse=True)
    if not len(arrivals):  # nothing is ever detected: a column of zeros
        arrivals = np.array([0])
    ahead = csr((transitions.values[entries], columns, starts - starts[0]), (end - begin, len(arrivals)))
    told = arrivals + observations.first[action]
    counts = np.diff(observations.starts.astype(np.int64))[told]
    ends = np.cumsum(counts)
    shifts = observations.starts[told].astype(np.int64) - (ends - counts)
    entries_of = np.arange(ends[-1]) + np.repeat(shifts, counts)
    symbols = observations.columns[entries_of].astype(np.int64)
    order = np.argsort(symbols, kind="stable")
    at = np.repeat(np.arange(len(arrivals)), counts)[order]
    chances = observations.values[entries_of][order]
    states = layout.state[arrivals]
    blocks = layout.block[states].astype(np.intp)
    places = states - layout.first_state[blocks]
    signs = []
    firsts = np.flatnonzero(np.diff(symbols[order], prepend=-1)).tolist()
    for first, last in pairwise([*firsts, len(at)]):
        of = at[first:last]
        block_of = int(blocks[of[0]])
        width = int(layout.first_state[block_of + 1] - layout.first_state[block_of])
        symbol = int(symbols[order[first]])
        signs.append(_Sign(symbol, block_of, _whole(of, len(arrivals)), _whole(places[of], width), chances[first:last]))
    return _Steps(ahead, csr(ahead.T), signs)


def _whole(indices: Indices, size: int) -> Indices | slice:
    """Return indices; where they are all there are, in order, as a slice, which copies nothing."""
    return slice(None) if np.array_equal(indices, np.arange(size)) else indices


def _product(matrix: Matrix, rows: Vector) -> Vector:
    """Return the product of a matrix with each row."""
    return np.ascontiguousarray((matrix @ rows.T).T)


def condensed(
    layout: Layout,
    vectors: Vectors,
    defaults: Indices,
    start: Vector,
    roots: Indices,
    *,
    slack: float,
    after: Indices | None = None,
    kernels: Kernels | None = None,
    fits: Callable[[int], bool] = lambda _: True,
    part: Part = lambda _: lambda: True,
) -> Condensed | None:
    """Return the vectors of a small plan; None where there is no time or no room to evaluate one.

    The first plan is made of the vectors that are given. Its nodes are chosen among again, by their own values, while
    that makes it better by more than the loss.

    Args:
        layout: The model.
        vectors: Those to choose among.
        defaults: A vector for each block.
        start: The initial belief, X x Y: a row for each block.
        roots: The best vector in each block of the initial belief.
        slack: The loss at a belief for a vector less.
        after: The vector after each vector and observation, to begin with: the first plan is then made of it alone.
        kernels: Compiled counterparts of products of matrices.
        fits: Whether there is room for so many bytes.
        part: Returns a function that tells whether there is time left of a share of the present rest.
    """
    best: Condensed | None = None
    controller = Controller(layout, vectors, defaults, after, kernels)
    while True:
        if best is not None or after is None:
            _settle(controller, start, roots, slack if best is None else _FINER * slack, part(_SEARCH))
        reached = controller.reached(roots)
        room = EVALUATION * reached.vectors.values.nbytes
        found = reached.evaluated(part, _LOSS * slack) if fits(room) else None
        if found is None:
            return best
        lower, roots = _best_nodes(found, start)
        gain = np.inf if best is None else lower - best.lower
        if gain > 0:
            best = Condensed(found, lower, reached.followers())
        if gain <= slack:
            return best
        controller = reached.of(found, chosen=after is not None)


def _settle(controller: Controller, start: Vector, roots: Indices, slack: float, goes_on: Callable[[], bool]) -> None:
    """Choose the followers of each node for the states that it is reached in, until neither changes.

    All nodes choose at once, and so choices and visits may go round in circles. The mean of the visits comes to rest.
    """
    vectors = controller.vectors
    begin = np.zeros(vectors.values.shape)
    begin[roots] = start[vectors.blocks[roots]]
    visits: Vector | None = None
    mean = begin
    for done in range(_ROUNDS):
        visits = controller.visits(begin, visits, goes_on)
        if done <= _UNDAMPED:
            mean = visits if done < _UNDAMPED else visits.copy()
        else:
            some = np.flatnonzero(visits.any(axis=1) | mean.any(axis=1))
            mean[some] += (visits[some] - mean[some]) / (done - _UNDAMPED + 1)
        changed = controller.choose(mean, slack, goes_on)
        if changed <= _SETTLED * float(visits.sum()) or not goes_on():
            return


def _best_nodes(vectors: Vectors, start: Vector) -> tuple[float, Indices]:
    """Return the value of the initial belief, and the best vector in each of its blocks."""
    value, best = 0.0, []
    for block in np.flatnonzero(start.any(axis=1)):
        nodes = np.flatnonzero(vectors.blocks == block)
        values = vectors.values[nodes] @ start[block]
        value += float(values.max())
        best.append(nodes[values.argmax()])
    return value, np.array(best)


# -- Linear systems ----------------------------------------------------------------------------------------------------

_ITERATIONS = 300
_PATIENCE = 40
"""Iterations without a smaller residual before it begins again."""


def solved(ahead: Callable[[Vector], Vector], earned: Vector, begin: Vector, close: float) -> Vector:
    """Return the values with the smallest residual that were found.

    Args:
        ahead: Returns the worth of values one step before: linear, and a contraction. Where it raises a
            `TimeoutError` there is no more time.
        earned: The reward of each step.
        begin: The first values.
        close: A residual whose numbers are no greater is small enough.
    """
    best, least = begin, np.inf
    waited = _PATIENCE
    try:
        with np.errstate(all="ignore"):  # it may break down
            for _ in range(_ITERATIONS):
                if waited >= _PATIENCE:
                    values = earned + ahead(best)
                    residual = earned + ahead(values) - values
                    best, least, waited = values, float(np.abs(residual).max()), 0
                    shadow = direction = residual
                    match = _inner(shadow, residual)
                if least <= close:
                    break
                image = direction - ahead(direction)
                step = match / _inner(shadow, image)
                half = residual - step * image
                turned = half - ahead(half)
                weight = _inner(turned, half) / max(_inner(turned, turned), np.finfo(np.float64).tiny)
                values = values + step * direction + weight * half
                residual = half - weight * turned
                before, match = match, _inner(shadow, residual)
                direction = residual + match / before * (step / weight) * (direction - weight * image)
                worst = float(np.abs(residual).max())
                if worst < least:
                    best, least, waited = values, worst, 0
                else:
                    waited = waited + 1 if worst < np.inf else _PATIENCE
    except TimeoutError:
        pass
    return best


def _inner(one: Vector, other: Vector) -> np.float64:
    return np.float64((one * other).sum())  # to divide by it raises nothing
