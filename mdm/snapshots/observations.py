"""Observations for the eye: their names, the last ones, and how often each came."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.models import Space

__all__ = ["HISTORY", "most_frequent", "observed"]

HISTORY = 8
"""Observations that are told with their times."""
_LISTED = 8


def observed(space: Space | None, observation: int | tuple[int | None, ...] | None) -> str | None:
    """Return the name of an observation, or of its components; None where there is none, or it has no name."""
    if space is None or observation is None:
        return None
    if isinstance(observation, int):
        return space.names[observation]
    pairs = zip(space.factors, observation, strict=True)
    return ", ".join(f"{factor.name} {'?' if value is None else factor.names[value]}" for factor, value in pairs)


def most_frequent(tally: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Return the most frequent observations by name with how often each came, the most frequent first."""
    return tuple(sorted(tally.items(), key=lambda pair: (-pair[1], pair[0]))[:_LISTED])
