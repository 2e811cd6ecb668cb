"""Matrices of probabilities: one per action, dense or CSR, checked, normalised and read-only.

scipy is slow to import, so it is imported with the first CSR matrix.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError, ModelWarning
from mdm.models.validation import is_collecting, report

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mdm.models.space import Space

Vector: TypeAlias = npt.NDArray[np.float64]
Matrix: TypeAlias = Any
"""An ndarray or a scipy.sparse.csr_array; scipy ships no types."""

TOLERANCE = 1e-4
"""The largest error in a row's sum that is normalised."""
ROUNDING = 1e-9
_LARGE = 1_000_000
_TOLD = 100
"""The number of problems per matrix that are reported one by one."""
_DENSE = 0.25


class RowError(ModelError):
    """A row is not a probability distribution.

    Attributes:
        what: The kind of matrix: ``T`` or ``O``.
        action: The action's index.
        row: The row's index.
    """

    def __init__(self, message: str, row: int, what: str = "", action: int = 0) -> None:
        super().__init__(message)
        self.row = row
        self.what = what
        self.action = action


class _Of(NamedTuple):
    """Which matrix it is.

    Attributes:
        what: ``T`` or ``O``.
        action: The action's index.
        name: The action's name.
    """

    what: str
    action: int
    name: str

    def __str__(self) -> str:
        return f"{self.what} of action {self.name!r}"

    def wrong(self, row: int, problem: str, *, is_sum: bool = False) -> None:
        """Report a problem of a row, or raise it."""
        error = RowError(f"{self}: {problem}", row, self.what, self.action)
        if not report(str(error), is_sum=is_sum, at=error):
            raise error


class Checked(tuple[Matrix, ...]):
    """Matrices that were validated before: one per action, of one kind, read-only."""

    __slots__ = ()


def stochastic_matrices(
    given: Any,
    *,
    what: str,
    actions: Space,
    rows: Space,
    columns: int,
    sparse_: bool | None,
) -> tuple[Matrix, ...]:
    """Return a validated rows x columns matrix per action.

    Row sums that are off by at most 1e-4 are normalised, with one warning that counts them.

    Args:
        given: The matrices, dense or sparse, or an array of three dimensions. A matrix shared by several actions is
            validated once.
        what: The kind of matrix, for messages: ``T`` or ``O``.
        actions: The names of the matrices.
        rows: The names of the rows.
        columns: The required number of columns.
        sparse_: Force CSR or dense; None chooses by size and density.

    Raises:
        ModelError: If a shape is wrong, a number is not a probability, or a row does not sum to 1.
    """
    if isinstance(given, Checked):
        return given
    matrices = list(given)  # keeps them alive while their ids are keys
    if len(matrices) != len(actions):
        raise ModelError(f"{what} is given for {len(matrices)} actions, but the model has {len(actions)}")
    as_sparse = _choose_sparse(matrices, len(rows), columns) if sparse_ is None else sparse_
    done: dict[int, Matrix] = {}
    normalised = 0
    for action, matrix in enumerate(matrices):
        if id(matrix) not in done:
            of = _Of(what, action, actions.names[action])
            done[id(matrix)], off = _checked(matrix, of, rows, columns, as_sparse)
            normalised += off
    if normalised:
        text = f"{normalised} rows of {what} did not quite sum to 1 and were normalised"
        warnings.warn(text, ModelWarning, stacklevel=4)
    return tuple(done[id(matrix)] for matrix in matrices)


def _choose_sparse(matrices: Sequence[Any], rows: int, columns: int) -> bool:
    """Return whether the matrices are large and sparse enough for CSR."""
    if len(matrices) * rows * columns <= _LARGE:
        return False
    entries = sum(matrix.nnz if is_compressed(matrix) else int(np.count_nonzero(matrix)) for matrix in matrices)
    return is_large_and_sparse(len(matrices), rows, columns, entries)


def is_large_and_sparse(matrices: int, rows: int, columns: int, entries: float) -> bool:
    """Whether so many matrices with so many entries in all are large and sparse enough for CSR."""
    size = matrices * rows * columns
    return size > _LARGE and entries < _DENSE * size


def _checked(matrix: Any, what: _Of, rows: Space, columns: int, as_sparse: bool) -> tuple[Matrix, int]:
    if is_compressed(matrix):
        result: Any = csr(matrix) if as_sparse else matrix.toarray()
    else:
        dense = numbers(matrix, str(what))
        result = csr(dense) if as_sparse and dense.ndim == 2 else dense
    if result.shape != (len(rows), columns):
        shape = "x".join(map(str, result.shape))
        raise ModelError(f"{what} is {shape}; it needs {len(rows)} rows and {columns} columns")
    if as_sparse:
        result.sum_duplicates()
        result.eliminate_zeros()
    _check_numbers(result, what, rows)
    sums = np.asarray(result.sum(axis=1)).ravel()
    errors = np.abs(sums - 1)
    if errors.max() > TOLERANCE:
        result, sums = _check_sums(result, sums, what, rows)
    off = errors > ROUNDING
    if off.any():
        if as_sparse:
            result.data /= np.repeat(sums, np.diff(result.indptr))
        else:
            result /= sums[:, None]
    return read_only(result), int((errors[off] <= TOLERANCE).sum())


def _check_numbers(matrix: Matrix, what: _Of, rows: Space) -> None:
    """Refuse numbers that are not probabilities; while problems are collected, set them to 0."""
    data = matrix.data if is_compressed(matrix) else matrix
    wrong = ~((data >= 0) & np.isfinite(data))
    if not wrong.any():
        return
    places = np.nonzero(wrong)
    compressed = is_compressed(matrix)
    found = np.searchsorted(matrix.indptr, places[0], side="right") - 1 if compressed else places[0]
    for row, value in zip(found[:_TOLD].tolist(), data[places].tolist(), strict=False):
        what.wrong(row, f"{value:g} in the row of {rows.names[row]!r} is not a probability")
    data[wrong] = 0


def _check_sums(matrix: Matrix, sums: Vector, what: _Of, rows: Space) -> tuple[Matrix, Vector]:
    """Refuse rows that do not sum to 1; while problems are collected, return rows that can be normalised."""
    errors = np.abs(sums - 1)
    wrong = np.flatnonzero(errors > TOLERANCE)
    worst = [int(errors.argmax()), *wrong[:_TOLD].tolist()]  # the error is about the worst
    for row in worst[:1] if not is_collecting() else worst[1:]:
        problem = f"the row of {rows.names[row]!r} sums to {sums[row]:.6g}, not to 1"
        what.wrong(row, problem, is_sum=bool(sums[row] > 0))
    if len(wrong) > _TOLD:
        report(f"{what}: {len(wrong) - _TOLD} more rows do not sum to 1", is_sum=True)
    empty = np.flatnonzero(sums == 0)
    if len(empty):  # an empty row stays in its state, or sees the first symbol
        columns = empty % matrix.shape[1]
        if is_compressed(matrix):
            starts = np.concatenate(([0], np.cumsum(sums == 0)))
            matrix = csr(matrix + csr((np.ones(len(empty)), columns, starts), matrix.shape))
        else:
            matrix[empty, columns] = 1
    return matrix, np.where(sums == 0, 1.0, sums)


def numbers(given: npt.ArrayLike, what: str) -> Vector:
    """Return a copy of numbers as an array of floats.

    Raises:
        ModelError: If they do not form one, as when rows differ in length.
    """
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{what} is not an array of numbers with rows of one length") from None


def distribution(given: npt.ArrayLike, *, what: str, size: int) -> Vector:
    """Return a read-only copy of a probability distribution, exactly normalised.

    Raises:
        ModelError: If the size is wrong, a number is not a probability, or the sum is not 1 within 1e-4.
    """
    vector = numbers(given, what)
    if vector.shape != (size,):
        raise ModelError(f"{what} has shape {vector.shape}; it needs {size} numbers")
    for at in np.flatnonzero(~((vector >= 0) & np.isfinite(vector))).tolist():
        problem = f"{what}: {vector[at]:g} at {at} is not a probability"
        if not report(problem):
            raise ModelError(problem)
        vector[at] = 0
    total = float(vector.sum())
    if abs(total - 1) > TOLERANCE:
        problem = f"{what} sums to {total:.6g}, not to 1"
        if not report(problem, is_sum=total > 0):
            raise ModelError(problem)
        if total == 0:
            vector[:], total = 1, float(size)
    if abs(total - 1) > ROUNDING:
        vector /= total
    vector.flags.writeable = False
    return vector


class MatrixSize(NamedTuple):
    """The bytes of a model's matrices.

    Attributes:
        transitions: Those of T.
        observations: Those of O; 0 of an MDP.
        rewards: Those of R(s, a).
        kinds: How many different matrices there are of T; actions of equal effect share one.
        entries: How many entries such a matrix has that are not zero.
        seen: How many a matrix of O has; of events, of an action.
    """

    transitions: int
    observations: int
    rewards: int
    kinds: int
    entries: int
    seen: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.transitions + self.observations + self.rewards


def num_entries(matrix: Matrix) -> int:
    """Return how many entries of a matrix are not zero."""
    return int(matrix.nnz if is_compressed(matrix) else np.count_nonzero(matrix))


def held_bytes(matrices: Iterable[Matrix]) -> int:
    """Return how many bytes matrices hold; one that several actions share counts once."""
    once = {id(matrix): matrix for matrix in matrices}.values()
    return sum(
        matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes if is_compressed(matrix) else matrix.nbytes
        for matrix in once
    )


def read_only(matrix: Any) -> Any:
    """Return the same array, made read-only."""
    for array in (matrix.data, matrix.indices, matrix.indptr) if is_compressed(matrix) else (matrix,):
        array.flags.writeable = False
    return matrix


def is_compressed(matrix: object) -> bool:
    """Whether an object is a sparse matrix of scipy, in any layout."""
    return not isinstance(matrix, np.ndarray) and hasattr(matrix, "tocsr")


def csr(matrix: Any, shape: tuple[int, int] | None = None, *, copy: bool = True) -> Any:
    """Return a CSR matrix of floats from a dense or sparse matrix, or from ``(data, indices, row starts)``."""
    from scipy.sparse import csr_array  # noqa: PLC0415 - see above

    return csr_array(matrix, shape=shape, dtype=np.float64, copy=copy)


def csr_identity(size: int) -> Any:
    """Return an identity matrix."""
    from scipy.sparse import eye_array  # noqa: PLC0415 - see above

    return eye_array(size, format="csr")
