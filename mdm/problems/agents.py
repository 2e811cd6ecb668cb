"""Spaces of teams whose agents are alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.models import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["agents"]


def agents(names: Sequence[str], count: int = 2) -> Space:
    """Return a joint space in which every agent has the same symbols; the first factor is ``agent0``."""
    return Space(Factor(f"agent{number}", names) for number in range(count))
