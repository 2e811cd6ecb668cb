"""CSR matrices: from arrays, from other layouts and from their parts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from mdm.models.matrices import csr, csr_identity, is_compressed

ARRAY = np.array([[0, 2, 0], [1, 0, 3]])


@pytest.mark.parametrize("layout", ["csr", "csc", "coo", "lil", "dok", "bsr"])
def test_every_layout_is_told_from_arrays_and_becomes_csr(layout):
    matrix = sparse.coo_array(ARRAY).asformat(layout)
    assert is_compressed(matrix)
    made = csr(matrix)
    assert (made.format, made.dtype) == ("csr", np.float64)
    np.testing.assert_array_equal(made.toarray(), ARRAY)


@pytest.mark.parametrize("other", [ARRAY, ARRAY.tolist(), None, 3.0])
def test_what_is_no_sparse_matrix(other):
    assert not is_compressed(other)


def test_parts_are_taken_as_they_are_where_they_need_not_be_copied():
    data, indices, starts = np.array([2.0, 1, 3]), np.array([1, 0, 2]), np.array([0, 1, 3])
    shared, own = (csr((data, indices, starts), (2, 3), copy=copy) for copy in (False, True))
    np.testing.assert_array_equal(shared.toarray(), ARRAY)
    assert np.shares_memory(shared.data, data)
    assert not np.shares_memory(own.data, data)


def test_identities():
    assert csr_identity(3).format == "csr"
    np.testing.assert_array_equal(csr_identity(3).toarray(), np.eye(3))
