"""Whether the package is compiled: its wheels have a decision's path in machine code, beside the sources."""

from __future__ import annotations

from importlib.machinery import PathFinder
from pathlib import Path

__all__ = ["is_compiled"]


def is_compiled() -> bool:
    """Whether what decisions pass runs as machine code, and not as plain Python; all of it does, or nothing."""
    # Looked for and not imported, for `mdm --version` needs nothing of it.
    found = PathFinder.find_spec("dispatcher", [str(Path(__file__).with_name("runtime"))])
    return found is not None and found.origin is not None and not found.origin.endswith(".py")
