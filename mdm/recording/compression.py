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
        return partial(_decompressed, name, module)
    raise Error(
        f"this record is compressed by {compression}, which needs a module for it: "
        f"pip install 'markov-decision-making[record]'"
    )


def _decompressed(name: str, module: Any, data: bytes, size: int) -> bytes:
    is_lz4 = name == "lz4.frame"
    failures = (RuntimeError if is_lz4 else module.ZstdError, EOFError, MemoryError)
    try:
        frame = module.LZ4FrameDecompressor() if is_lz4 else module.ZstdDecompressor()
        if name == "zstandard":
            with frame.stream_reader(data) as reader:
                return bytes(reader.read(size + 1))
        return bytes(frame.decompress(data, size + 1))
    except failures as error:
        raise ValueError(str(error)) from None
