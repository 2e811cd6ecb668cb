"""The smallest change of a known state by which a policy would have decided otherwise: the fewest factors.

States are looked at in the order of how many of their factors differ. Cost: a look-up for each, up to a bound.
"""

from __future__ import annotations

from itertools import combinations, product
from math import prod
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.beliefs import Drawn
from mdm.errors import ModelError
from mdm.explanation.case import state_of
from mdm.models.space import Space

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.explanation.case import Case

__all__ = ["FactorChange", "StateChange", "state_changes"]

_MOST = 100_000
"""States that are looked at."""
_TOLD = 5


class FactorChange(msgspec.Struct, frozen=True):
    """A factor of a state, its value, and another one."""

    factor: str
    before: str
    after: str


class StateChange(msgspec.Struct, frozen=True, tag="state"):
    """A change of the fewest factors of a state that would have decided otherwise.

    Attributes:
        factors: What changes.
        action: The name of the action that would have been chosen.
    """

    factors: tuple[FactorChange, ...]
    action: str


def state_changes(case: Case) -> tuple[list[StateChange], int]:
    """Return changes of the fewest factors of a state that would have decided otherwise.

    Args:
        case: A decision on a known state.

    Returns:
        Five of them at most, in the order of the states, and how many there are. There are none where every state
        leads to the same action.

    Raises:
        ModelError: If the policy searches, or there are too many states; a sentence says so.
    """
    if getattr(case.policy, "deliberates", False):
        raise ModelError("a search for each other state would take too long, so none is told that decides otherwise")
    space = case.states or Space.single("state", case.policy.num_states, prefix="")  # type: ignore[attr-defined]
    state = state_of(case.at)
    if state is None:
        raise ModelError("what it was decided on is no state alone, so that no other one is told")
    here = space.unravel(state)
    seen = 0
    for count in range(1, len(here) + 1):
        seen += sum(prod(len(space.factors[place]) - 1 for place in places) for places in _places(here, count))
        if seen > _MOST:
            raise ModelError(f"no change of fewer than {count} factors decides otherwise; more are too many to try")
        found = [(there, action) for there in _others(space, here, count) if (action := _decided(case, space, there))]
        if found:
            told = [
                StateChange(
                    tuple(
                        FactorChange(factor.name, factor.names[before], factor.names[after])
                        for factor, before, after in zip(space.factors, here, there, strict=True)
                        if before != after
                    ),
                    action,
                )
                for there, action in found[:_TOLD]
            ]
            return told, len(found)
    return [], 0


def _places(here: tuple[int, ...], count: int) -> Iterator[tuple[int, ...]]:
    return combinations(range(len(here)), count)


def _others(space: Space, here: tuple[int, ...], count: int) -> Iterator[tuple[int, ...]]:
    """Yield the states that differ in so many factors."""
    for places in _places(here, count):
        values = [[each for each in range(len(space.factors[place])) if each != here[place]] for place in places]
        for chosen in product(*values):
            there = list(here)
            for place, value in zip(places, chosen, strict=True):
                there[place] = value
            yield tuple(there)


def _decided(case: Case, space: Space, there: tuple[int, ...]) -> str | None:
    """Return the name of the action in another state; None where it is the same, or there is none."""
    try:
        action = int(case.policy.action(_moved(case.at, space.ravel(there))))
    except ModelError:
        return None
    return None if action == case.action else case.action_name(action)


def _moved(at: Any, state: int) -> Any:
    """Return the same information in another state: with the same stage, or the same draw."""
    if isinstance(at, Drawn):
        return Drawn(_moved(at.by, state), at.number)
    return at._replace(state=state) if hasattr(at, "state") else state
