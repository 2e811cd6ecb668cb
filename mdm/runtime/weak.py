"""What may be held weakly: a compiled class cannot be, unless it comes of one that is not compiled."""

from __future__ import annotations

__all__ = ["WeaklyHeld"]


class WeaklyHeld:
    """To inherit from, where something keeps weak references. It has no slots, as compiled classes may inherit none."""
