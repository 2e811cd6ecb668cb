"""A memory of what recurs, within bounds."""

from __future__ import annotations

from typing import TypeVar

__all__ = ["Memory"]

K = TypeVar("K")
V = TypeVar("V")

MOST = 4096
"""Entries of a memory."""


class Memory(dict[K, V]):
    """What was found by key: a dictionary that begins anew when it is full."""

    __slots__ = ()

    def keep(self, key: K, value: V) -> V:
        """Remember a value, and return it."""
        if len(self) >= MOST:
            self.clear()
        self[key] = value
        return value
