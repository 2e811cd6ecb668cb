"""Which factor decides first: a table over factored states as a reduced, ordered decision diagram.

A node asks for the value of a factor, and each value leads on. No two nodes lead on alike, and none does so for all of
its values: for an order of the factors there is one such diagram (R. E. Bryant, *Graph-based algorithms for Boolean
function manipulation*, IEEE Transactions on Computers C-35, 1986; here of several values). The order is greedy, from
the last factor up: each time the one that adds the fewest nodes. It costs a sort of the S entries for each factor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    Table = npt.NDArray[np.int64]

_WORK = 2_000_000
"""Entries up to which each factor is tried as the next one; of more that which changes the fewest entries is."""


class Diagram(NamedTuple):
    """A diagram of a table.

    Args:
        order: The axes of the table, that which decides first before the others.
        levels: For each of these the nodes that ask for it, N x its size: where each value leads to.
        firsts: The number of the first node of each; numbers below all of them are the entries of the table.
        root: The number of the node that is asked first.

    Example::

        Diagram.of(np.array([[0, 0], [0, 1]]), 2).path([1, 0])  # [3, 0]
    """

    order: tuple[int, ...]
    levels: tuple[Table, ...]
    firsts: tuple[int, ...]
    root: int

    @classmethod
    def of(cls, table: Table, entries: int) -> Self:
        """Return the diagram of a table of entries from 0 on, below a number."""
        changed = [np.count_nonzero(table != table.take([0], axis)) for axis in range(table.ndim)]
        left = sorted(range(table.ndim), key=lambda axis: -changed[axis])
        order: list[int] = []
        levels: list[Table] = []
        firsts, count = list[int](), entries
        while left:
            tried = []
            for axis in left if table.size * len(left) <= _WORK else left[-1:]:
                last = np.moveaxis(table, axis, -1)
                numbers, rows = _joined(last.reshape(-1, last.shape[-1]), count)
                tried.append((len(rows), axis, rows, np.expand_dims(numbers.reshape(last.shape[:-1]), axis)))
            added, axis, rows, table = min(tried, key=lambda each: each[:2])
            left.remove(axis)
            order, levels, firsts = [axis, *order], [rows, *levels], [count, *firsts]
            count += added
        return cls(tuple(order), tuple(levels), tuple(firsts), int(table.item()))

    def place(self, node: int) -> int:
        """Return the place in the order of the factor that a node asks for; the number of factors for an entry."""
        levels = enumerate(zip(self.firsts, self.levels, strict=True))
        return next((at for at, (first, rows) in levels if 0 <= node - first < len(rows)), len(self.order))

    def path(self, values: Sequence[int]) -> list[int]:
        """Return the nodes that values of all axes lead through, from the first to the entry."""
        found = [self.root]
        while (at := self.place(found[-1])) < len(self.order):
            found.append(int(self.levels[at][found[-1] - self.firsts[at], values[self.order[at]]]))
        return found


def _joined(rows: Table, first: int) -> tuple[Table, Table]:
    """Return the number of each row, equal ones as one node from a first number on; and the rows of these nodes.

    A row that leads on to one node alone is that node.
    """
    numbers = rows[:, 0].copy()
    different = np.flatnonzero((rows != rows[:, :1]).any(axis=1))
    if not len(different):
        return numbers, rows[:0]
    kept = np.ascontiguousarray(rows[different])
    keys = kept.view(np.dtype((np.void, kept.itemsize * kept.shape[1]))).ravel()
    _, where, places = np.unique(keys, return_index=True, return_inverse=True)
    numbers[different] = first + places.ravel()
    return numbers, kept[where]
