"""Draws from many distributions at once: one for each of thousands of episodes, without a loop over them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.compressed import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.models.matrices import Matrix, Vector

__all__ = ["Draws"]


class Draws:
    """The rows of some matrices as distributions to draw from.

    A draw is a bisection of the row's cumulative probabilities, for all rows in step: as many rounds as the longest row
    has bits in its length. It finds an entry of a matrix; the entries of all matrices are numbered through.

    Args:
        matrices: Of one width, dense or CSR, their rows summing to 1; one that stands in several places is kept once.
    """

    def __init__(self, matrices: Sequence[Matrix]) -> None:
        places: dict[int, int] = {}
        for matrix in matrices:
            places.setdefault(id(matrix), len(places))
        kept = {places[id(matrix)]: matrix for matrix in matrices}
        rows = [matrix if is_compressed(matrix) else csr(matrix) for _, matrix in sorted(kept.items())]
        first_rows = np.cumsum([0, *(matrix.shape[0] for matrix in rows)])
        first_entries = np.cumsum([0, *(matrix.nnz for matrix in rows)])
        at = [places[id(matrix)] for matrix in matrices]
        self._first_row = first_rows[at]
        self.first_entry: npt.NDArray[np.intp] = first_entries[at]
        """For each matrix the number of its first entry."""
        starts = [matrix.indptr[:-1] + first for matrix, first in zip(rows, first_entries, strict=False)]
        self._starts = np.concatenate([*starts, first_entries[-1:]]).astype(np.intp)
        self._levels = np.concatenate([_levels(matrix) for matrix in rows])
        self.columns: npt.NDArray[np.intp] = np.concatenate([matrix.indices for matrix in rows]).astype(np.intp)
        """The column of each entry."""
        self._rounds = int(np.diff(self._starts).max() - 1).bit_length()

    def __call__(
        self, which: npt.NDArray[np.intp], rows: npt.NDArray[np.intp], numbers: Vector
    ) -> npt.NDArray[np.intp]:
        """Draw an entry from a row of a matrix for each number.

        Args:
            which: The matrices.
            rows: A row of each.
            numbers: From [0, 1).
        """
        at = self._first_row[which] + rows
        low, high = self._starts[at], self._starts[at + 1] - 1
        for _ in range(self._rounds):
            middle = (low + high) >> 1
            beyond = self._levels[middle] <= numbers
            low = np.where(beyond, middle + 1, low)
            high = np.where(beyond, high, middle)
        return low


def _levels(matrix: Matrix) -> Vector:
    """Return the cumulative probabilities of each row; the last is beyond any draw, and so rounding is, too."""
    total = np.cumsum(matrix.data)
    before = np.concatenate(([0.0], total))[matrix.indptr[:-1]]
    levels: Vector = total - np.repeat(before, np.diff(matrix.indptr))
    levels[matrix.indptr[1:] - 1] = 2.0
    return levels
