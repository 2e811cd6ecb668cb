"""Compilation of kernels by numba, where the extra ``mdm[fast]`` is installed; they run uncompiled otherwise.

numba takes longer to import than all the rest, so modules with kernels are imported where a kernel is chosen, never
with the package. What was compiled is kept on disk, beside the module or in the user's cache. Set ``MDM_COMPILE=0``
to do without.
"""

from __future__ import annotations

import os
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["can_compile", "compiled"]

_Function = TypeVar("_Function", bound="Callable[..., Any]")


@cache
def can_compile() -> bool:
    """Whether kernels are compiled: numba is there, and ``MDM_COMPILE`` is not 0."""
    return os.environ.get("MDM_COMPILE", "1") != "0" and find_spec("numba") is not None


def compiled(function: _Function) -> _Function:
    """Compile a function of numbers and arrays at its first call; return it as it is where there is no numba."""
    if not can_compile():
        return function
    import numba  # noqa: PLC0415 - see above

    return cast("_Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))
