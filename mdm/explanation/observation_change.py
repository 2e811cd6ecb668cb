"""The fewest observations that would have had to be others for a plan to act otherwise.

A plan has no belief: it follows the edges of what is observed. Cost: a walk for each way to change one or two of the
last observations, up to a bound.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import TYPE_CHECKING

import msgspec

from mdm.errors import ModelError
from mdm.explanation.case import Rerun

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mdm.explanation.case import Case, Update
    from mdm.models.space import Space

__all__ = ["ObservationChange", "Observed", "observation_changes"]

_MOST = 20_000
"""Walks that are looked at."""
_MOST_CHANGED = 2
_TOLD = 5


class Observed(msgspec.Struct, frozen=True):
    """An observation before a decision of that number, of an agent or factor where it has several, and another one."""

    epoch: int
    of: str
    before: str
    after: str


class ObservationChange(msgspec.Struct, frozen=True, tag="observation"):
    """A change of the fewest of the last observations by which a plan would have acted otherwise.

    Attributes:
        observations: What changes.
        action: The name of the action that would have been chosen.
    """

    observations: tuple[Observed, ...]
    action: str


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
    places = [
        (number, component)
        for number in reversed(range(len(case.updates)))
        for component, symbol in enumerate(_components(space, case.updates[number]))
        if symbol is not None
    ]
    walks = 0
    for count in range(1, _MOST_CHANGED + 1):
        found = []
        for changed in _changes(space, case, places, count):
            walks += 1
            if walks > _MOST:
                raise ModelError("changes of the last observations are too many to look at")
            updates = _applied(space, case, changed)
            action = int(case.policy.action(rerun.at(updates)))
            if action != case.action:
                found.append((changed, action))
        if found:
            told = [
                ObservationChange(tuple(_told(space, case, each) for each in changed), case.action_name(action))
                for changed, action in found[:_TOLD]
            ]
            return told, len(found)
    return [], 0


_Change = tuple[int, int, int]
"""The number of an update, a component of its observation, and another symbol of it."""


def _components(space: Space, update: Update) -> tuple[int | None, ...]:
    given = update.observation
    if given is None or isinstance(given, frozenset):
        return ()
    return space.unravel(given) if isinstance(given, int) else given


def _changes(space: Space, case: Case, places: list[tuple[int, int]], count: int) -> Iterator[tuple[_Change, ...]]:
    for chosen in combinations(places, count):
        others = []
        for number, component in chosen:
            symbol = _components(space, case.updates[number])[component]
            others.append([each for each in range(len(space.factors[component])) if each != symbol])
        for symbols in product(*others):
            yield tuple((*place, symbol) for place, symbol in zip(chosen, symbols, strict=True))


def _applied(space: Space, case: Case, changed: tuple[_Change, ...]) -> list[Update]:
    updates = list(case.updates)
    for number, component, symbol in changed:
        components = list(_components(space, updates[number]))
        components[component] = symbol
        known = [each for each in components if each is not None]
        joint = space.ravel(known) if len(known) == len(components) else tuple(components)
        updates[number] = updates[number]._replace(observation=joint)
    return updates


def _told(space: Space, case: Case, change: _Change) -> Observed:
    number, component, symbol = change
    update, factor = case.updates[number], space.factors[component]
    before = _components(space, update)[component]
    assert before is not None
    of = factor.name if len(space.factors) > 1 else ""
    return Observed(update.epoch, of, factor.names[before], factor.names[symbol])
