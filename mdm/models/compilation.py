"""Compilation of kernels by numba (the extra ``mdm[fast]``); without numba they run as plain Python.

numba is slow to import, so a module with kernels is imported only when one of them is chosen. Compiled code is cached
on disk, beside the module or in the user's cache. ``MDM_COMPILE=0`` turns compilation off.
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
    """Whether kernels are compiled: numba is installed, and ``MDM_COMPILE`` is not 0."""
    return os.environ.get("MDM_COMPILE", "1") != "0" and find_spec("numba") is not None


def compiled(function: _Function) -> _Function:
    """Compile a function of numbers and arrays at its first call; without numba, return it unchanged.

    Each type of an argument is compiled by itself, and to numba a number in a caller's code is a type of its own. So
    kernels hand indices to each other as ``int(np.int64(...))``, of one width.
    """
    if not can_compile():
        return function
    import numba  # noqa: PLC0415 - see above

    return cast("_Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))
