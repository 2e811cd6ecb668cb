"""Zstandard and LZ4, each from the module that there is: Python's own, its backport, or those that mcap brings."""

from __future__ import annotations

import importlib
from functools import partial
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["COMPRESSIONS", "decompressor"]

_MODULES = {"zstd": ("compression.zstd", "backports.zstd", "zstandard"), "lz4": ("lz4.frame",)}
COMPRESSIONS = frozenset(_MODULES)
"""The names that MCAP has for them."""


def decompressor(compression: str) -> Callable[[bytes, int], bytes]:
    """Return a function that decompresses a frame to a size.

    What it returns is at most a byte longer, whatever the frame claims to hold, and it raises `ValueError` for what is
    no whole frame.

    Args:
        compression: Its name, as MCAP has it.

    Raises:
        Error: If there is no module for it.
    """
    for name in _MODULES[compression]:
        try:
            module: Any = importlib.import_module(name)
        except ImportError:
            continue
        return partial({"zstandard": _stream, "lz4.frame": _frame}.get(name, _whole), module)
    raise Error(
        f"this record is compressed by {compression}, which needs a module for it: "
        f"pip install 'markov-decision-making[record]'"
    )


def _whole(module: Any, data: bytes, size: int) -> bytes:
    try:
        return bytes(module.ZstdDecompressor().decompress(data, size + 1))
    except (module.ZstdError, EOFError, MemoryError) as error:
        raise ValueError(str(error)) from None


def _stream(module: Any, data: bytes, size: int) -> bytes:
    try:
        with module.ZstdDecompressor().stream_reader(data) as reader:
            return bytes(reader.read(size + 1))
    except (module.ZstdError, MemoryError) as error:
        raise ValueError(str(error)) from None


def _frame(module: Any, data: bytes, size: int) -> bytes:
    try:
        return bytes(module.LZ4FrameDecompressor().decompress(data, size + 1))
    except (RuntimeError, EOFError, MemoryError) as error:
        raise ValueError(str(error)) from None
