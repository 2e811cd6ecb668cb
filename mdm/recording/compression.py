"""Zstandard, from the module that there is: Python's own, its backport, or the one that mcap brings."""

from __future__ import annotations

import importlib
from functools import partial
from typing import TYPE_CHECKING, Any

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["decompressor"]

_MODULES = ("compression.zstd", "backports.zstd", "zstandard")


def decompressor() -> Callable[[bytes, int], bytes]:
    """Return a function that decompresses a frame to a size.

    What it returns is at most a byte longer, whatever the frame claims to hold, and it raises `ValueError` for what is
    no whole frame.

    Raises:
        Error: If there is no module for it.
    """
    for name in _MODULES:
        try:
            module: Any = importlib.import_module(name)
        except ImportError:
            continue
        return partial(_stream if name == "zstandard" else _whole, module)
    raise Error("this record is compressed, which needs a module for it: pip install 'markov-decision-making[record]'")


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
