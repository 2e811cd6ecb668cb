"""CSR matrices. scipy is slow to import, so it is imported with the first of them."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["csr", "csr_identity", "is_compressed"]


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
