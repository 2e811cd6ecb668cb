"""The choices of a decision process before something is reached, and the certainties of their graph.

A policy makes it a Markov chain, which is one choice a state; see C. Baier and J.-P. Katoen, *Principles of model
checking*, 2008, sections 10.1 and 10.6. A search of the graph costs O(entries of T), that of certainty and that of end
components as much each time that they lose states, which is few times in practice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import coo_array, vstack
from scipy.sparse.csgraph import connected_components

from mdm.compilation import kernels, plain
from mdm.models.matrices import csr

if TYPE_CHECKING:
    from types import ModuleType

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.specification import Mask

    Indices = npt.NDArray[np.integer]


LARGE = 20_000
"""Entries from which on loops are compiled: it takes seconds, once on a machine."""


class Choices(NamedTuple):
    """The choices of all states, C in all, those of a state beside each other.

    Args:
        moves: The probabilities of going on to each state, C x S; the rest of a row is ``hit`` and ``miss``.
        hit: The probability that X is reached with the choice, C.
        miss: That Y is, and X is not.
        state: The state of each choice.
        action: Its action.
    """

    moves: Matrix
    hit: Vector
    miss: Vector
    state: Indices
    action: Indices

    @classmethod
    def of_model(cls, model: MDP, target: Mask, before: Mask | None) -> Choices:
        """Return those of a model whose state is seen, with all of its available actions."""
        size, count = len(model.state_space), len(model.action_space)
        given = np.ones((size, count), dtype=bool) if model.available is None else model.available
        state, action = np.nonzero(given)
        hit = target[:, :-1]
        miss = np.zeros_like(hit) if before is None else before[:, :-1] & ~hit
        rows = vstack([csr(model.transition_matrix(each)) for each in range(count)], format="csr")
        hits, misses = hit[state, action].astype(float), miss[state, action].astype(float)
        return cls(_ended(rows[action * size + state], hits + misses), hits, misses, state, action)

    @classmethod
    def of_chain(cls, moves: Matrix, target: Vector, before: Vector) -> Choices:
        """Return those of a chain, in whose states X and Y have probabilities."""
        none = np.zeros(len(target), dtype=np.intp)
        return cls(_ended(moves, target + before), target, before, np.arange(len(target)), none)

    @property
    def size(self) -> int:
        """The number of states."""
        return int(self.moves.shape[1])

    @property
    def firsts(self) -> Indices:
        """For each state its first choice, and the number of choices."""
        return np.searchsorted(self.state, np.arange(self.size + 1))

    def subset(self, which: Mask | Indices) -> Choices:
        """Return some of the choices."""
        return Choices(self.moves[which], self.hit[which], self.miss[which], self.state[which], self.action[which])

    def lead_to(self, states: Mask) -> Mask:
        """Return which choices may lead to one of some states."""
        return np.asarray(self.moves @ states.astype(float)) > 0


class Graph:
    """Searches of the graph of choices, with the reverse of its edges."""

    def __init__(self, choices: Choices) -> None:
        self._choices = choices
        self._reverse = csr(choices.moves).tocsc()
        self._attract = loops(choices.moves).attract

    def attracted(
        self, states: Mask, choices: Mask, *, opened: Mask | None = None, every: bool = False
    ) -> tuple[Mask, Indices]:
        """Return the states that reach some states or choices with a probability above 0, and the choice of each.

        Only open choices may be made, by default all; with ``every`` they are reached by all choices.
        """
        its = self._choices
        opened = np.ones(len(its.state), dtype=bool) if opened is None else opened.copy()
        left = np.bincount(its.state[opened], minlength=its.size) if every else np.ones(its.size, dtype=np.int64)
        # The choices are the ways into a state more, which is inside.
        ways = np.concatenate([self._reverse.indices, np.flatnonzero(choices)]).astype(np.int64)
        before = np.append(self._reverse.indptr, len(ways)).astype(np.int64)
        inside, by = np.append(states, True), np.full(its.size, -1, dtype=np.int64)
        self._attract(before, ways, its.state, opened, inside, left.astype(np.int64), by)
        return inside[:-1], by

    def impossible(self) -> Mask:
        """Return from which states X is never reached by any choices."""
        return ~self.attracted(np.zeros(self._choices.size, dtype=bool), self._choices.hit > 0)[0]

    def avoiding(self) -> tuple[Mask, Mask]:
        """Return from which states X can be avoided for certain, and the choices that do it."""
        its = self._choices
        avoids = ~self.attracted(np.zeros(its.size, dtype=bool), its.hit > 0, every=True)[0]
        return avoids, (its.hit == 0) & ~its.lead_to(~avoids) & avoids[its.state]

    def unavoidable(self) -> tuple[Mask, Indices]:
        """Return from which states X is certain by all choices, and for the others a choice away from that."""
        away, by = self.attracted(self.avoiding()[0], self._choices.miss > 0)
        return ~away, by

    def certain(self) -> tuple[Mask, Mask, Indices]:
        """Return from which states X can be reached for certain, the choices that keep that so, and one of each."""
        its, none = self._choices, np.zeros(self._choices.size, dtype=bool)
        found = ~none
        while True:
            outside, _ = self.attracted(~found, its.miss > 0, every=True)
            opened = (its.miss == 0) & ~its.lead_to(outside) & ~outside[its.state]
            found, by = self.attracted(none, its.hit > 0, opened=opened)
            if (found != outside).all():
                return found, opened, by


def _ended(moves: Matrix, ends: Vector) -> Matrix:
    """Return the rows of moves, less the probability that each ends before."""
    rows = csr(moves)
    rows.data *= np.repeat(np.maximum(1 - ends, 0), np.diff(rows.indptr))
    rows.eliminate_zeros()
    return rows


def loops(moves: Matrix) -> ModuleType:
    """Return the kernels for some choices: compiled where these are many and it is possible, else plain."""
    return (kernels if moves.nnz > LARGE else plain)("mdm.verification.kernels")


def components(moves: Matrix) -> Indices:
    """Return the strongly connected component of each state, so numbered that no edge leads to a higher one."""
    _, labels = connected_components(moves, connection="strong")
    found: Indices = labels.astype(np.int64)
    rows = np.repeat(np.arange(moves.shape[0]), np.diff(moves.indptr))
    if (found[moves.indices] > found[rows]).any():
        found = found.max(initial=0) - found
    return found


def graph_of(moves: Matrix, state: Indices) -> Matrix:
    """Return the graph over states of some choices, S x S; its numbers are of no use."""
    rows = np.repeat(state, np.diff(moves.indptr))
    return coo_array((np.ones(len(rows)), (rows, moves.indices)), shape=(moves.shape[1],) * 2).tocsr()


def end_components(choices: Choices, opened: Mask) -> tuple[Indices, Mask]:
    """Return the maximal end components: for each state the number of its own, or -1, and the choices that stay there.

    An end component is a set of states in which some choices stay for ever, and by which each can be reached from each.
    Open choices alone count.
    """
    graph, opened = Graph(choices), opened & (choices.hit == 0) & (choices.miss == 0)
    entries, leaves = np.repeat(np.arange(len(choices.state)), np.diff(choices.moves.indptr)), ~opened
    while True:
        opened &= ~leaves
        without = np.bincount(choices.state[opened], minlength=choices.size) == 0
        opened &= ~choices.lead_to(graph.attracted(without, leaves & False, opened=opened, every=True)[0])
        labels = components(graph_of(choices.moves[opened], choices.state[opened]))
        leaves = np.zeros(len(choices.state), dtype=bool)
        leaves[entries[labels[choices.moves.indices] != labels[choices.state[entries]]]] = True
        leaves &= opened
        if not leaves.any():
            break
    numbers, inside = np.full(choices.size, -1), np.unique(choices.state[opened])
    numbers[inside] = np.unique(labels[inside], return_inverse=True)[1]
    return numbers, opened
