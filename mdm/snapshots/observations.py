"""States and observations for the eye: their names, and how often each came."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mdm.models import Space

__all__ = ["HISTORY", "at_state", "most_frequent", "observed", "on_observing"]

HISTORY = 8
"""Observations that are told with their times."""
_LISTED = 8


def observed(space: Space | None, observation: int | tuple[int | None, ...] | None) -> str | None:
    """Return the name of an observation, or of its components; None where there is none, or it has no name."""
    if space is None or observation is None:
        return None
    if isinstance(observation, int):
        return space.names[observation]
    return _factors(space, observation)


def _factors(space: Space, values: Iterable[int | None]) -> str:
    """Return the names of factors with those of their values."""
    pairs = zip(space.factors, values, strict=True)
    return ", ".join(f"{factor.name} {'?' if value is None else factor.names[value]}" for factor, value in pairs)


def at_state(space: Space | None, state: int) -> str:
    """Return that something was decided in a state, by its factors where it has several."""
    if space is None or len(space.factors) < 2:
        return f"in state {state if space is None else space.names[state]}"
    return f"in state {_factors(space, space.unravel(state))}"


def on_observing(name: str | None) -> str:
    """Return that something was decided on an observation; empty where there was none."""
    return f"on observing {name}" if name else ""


def most_frequent(tally: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    """Return the most frequent observations by name with how often each came, the most frequent first."""
    return tuple(sorted(tally.items(), key=lambda pair: (-pair[1], pair[0]))[:_LISTED])
