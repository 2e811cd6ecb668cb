"""The fewest values that would have had to be others for another action: factors of a state, or observations of a plan.

Another action is looked for among all changes of one value, then of two, and so on. Of a known state its
factors change: a look-up of the policy for each, up to a bound. A plan has no belief, and follows edges by
observations: one or two of the last observations change, and each change costs a walk, up to another bound.
"""

from __future__ import annotations

from itertools import combinations, product
from math import prod
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mdm.beliefs import Drawn
from mdm.errors import ModelError
from mdm.explanation.case import Rerun, state_of
from mdm.models.space import Space

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mdm.explanation.case import Case, Update

_MOST_STATES = 100_000
"""States that are looked at."""
_MOST_WALKS = 20_000
"""Walks that are looked at."""
_MOST_CHANGED = 2
"""Observations that change at once."""
_TOLD = 5

K = TypeVar("K")


class FactorChange(msgspec.Struct, frozen=True):
    """A factor of a state, its value, and another one."""

    factor: str
    before: str
    after: str


class StateChange(msgspec.Struct, frozen=True, tag="state"):
    """A change of the fewest factors of a state that would have decided otherwise.

    Attributes:
        factors: The factors that change.
        action: The name of the action that would have been chosen.
    """

    factors: tuple[FactorChange, ...]
    action: str


class Observed(msgspec.Struct, frozen=True):
    """An observation before a decision of that number, of an agent or factor where it has several, and another one."""

    epoch: int
    of: str
    before: str
    after: str


class ObservationChange(msgspec.Struct, frozen=True, tag="observation"):
    """A change of the fewest of the last observations by which a plan would have acted otherwise.

    Attributes:
        observations: The observations that change.
        action: The name of the action that would have been chosen.
    """

    observations: tuple[Observed, ...]
    action: str


def _changes(others: Mapping[K, Sequence[int]], count: int) -> Iterator[dict[K, int]]:
    """Yield the changes of so many values, each to one of its others."""
    for chosen in combinations(others, count):
        for symbols in product(*(others[each] for each in chosen)):
            yield dict(zip(chosen, symbols, strict=True))


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
        raise ModelError("the policy searches, and a search for every other state would take too long")
    space = case.states or Space.single("state", case.policy.num_states, prefix="")  # type: ignore[attr-defined]
    state = state_of(case.at)
    if state is None:
        raise ModelError("the decision was made on more than a state: no other state is looked for")
    here = space.unravel(state)
    others = {place: _but(len(space.factors[place]), value) for place, value in enumerate(here)}
    seen = 0
    for count in range(1, len(here) + 1):
        seen += sum(prod(len(others[place]) for place in places) for places in combinations(others, count))
        if seen > _MOST_STATES:
            raise ModelError(f"no change of fewer than {count} factors decides otherwise; more are too many to try")
        found = []
        for change in _changes(others, count):
            there = space.ravel([change.get(place, value) for place, value in enumerate(here)])
            action = _decided(case, _moved(case.at, there))
            if action is not None:
                found.append((change, action))
        if found:
            return [
                StateChange(
                    tuple(FactorChange(*_named(space, place, here[place], after)) for place, after in change.items()),
                    action,
                )
                for change, action in found[:_TOLD]
            ], len(found)
    return [], 0


def _but(size: int, value: int) -> list[int]:
    return [each for each in range(size) if each != value]


def _named(space: Space, place: int, before: int, after: int) -> tuple[str, str, str]:
    """Return the name of a factor, and of its values before and after a change."""
    factor = space.factors[place]
    return factor.name, factor.names[before], factor.names[after]


def _decided(case: Case, at: Any) -> str | None:
    """Return the name of the action in another state; None where it is the same, or there is none."""
    try:
        action = int(case.policy.action(at))
    except ModelError:
        return None
    return None if action == case.action else case.action_name(action)


def _moved(at: Any, state: int) -> Any:
    """Return the same information in another state: with the same stage, or the same draw."""
    if isinstance(at, Drawn):
        return Drawn(_moved(at.by, state), at.number)
    return at._replace(state=state) if hasattr(at, "state") else state


def observation_changes(case: Case) -> tuple[list[ObservationChange], int]:
    """Return changes of the fewest of the last observations by which a plan would have acted otherwise.

    Returns:
        Five of them at most, those of the latest observations first, and how many there are.

    Raises:
        ModelError: If the walk to the node is not known, or changes are too many; a sentence says so.
    """
    rerun, space = Rerun(case), case.observations
    if space is None:
        return [], 0
    seen = {
        (number, place): symbol
        for number in reversed(range(len(case.updates)))
        for place, symbol in enumerate(_components(space, case.updates[number]))
        if symbol is not None
    }
    others = {(number, place): _but(len(space.factors[place]), symbol) for (number, place), symbol in seen.items()}

    def told(change: tuple[tuple[int, int], int]) -> Observed:
        (number, place), after = change
        of, *names = _named(space, place, seen[number, place], after)
        return Observed(case.updates[number].epoch, of if len(space.factors) > 1 else "", *names)

    walks = 0
    for count in range(1, _MOST_CHANGED + 1):
        found = []
        for change in _changes(others, count):
            walks += 1
            if walks > _MOST_WALKS:
                raise ModelError("the last observations have too many changes to try them all")
            action = int(case.policy.action(rerun.at(_applied(space, case.updates, change))))
            if action != case.action:
                found.append((change, action))
        if found:
            return [
                ObservationChange(tuple(map(told, change.items())), case.action_name(action))
                for change, action in found[:_TOLD]
            ], len(found)
    return [], 0


def _components(space: Space, update: Update) -> tuple[int | None, ...]:
    given = update.observation
    if given is None or isinstance(given, frozenset):
        return ()
    return space.unravel(given) if isinstance(given, int) else given


def _applied(space: Space, updates: Sequence[Update], change: Mapping[tuple[int, int], int]) -> list[Update]:
    changed = list(updates)
    for (number, place), symbol in change.items():
        components = list(_components(space, changed[number]))
        components[place] = symbol
        known = [each for each in components if each is not None]
        joint = space.ravel(known) if len(known) == len(components) else tuple(components)
        changed[number] = changed[number]._replace(observation=joint)
    return changed
