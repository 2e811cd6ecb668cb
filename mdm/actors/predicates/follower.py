"""Followers: another agent's predicates, kept up to date in this one's predicate manager."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.messages import PredicateMap, PredicateUpdate, SensorUpdate

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mdm.actors.predicates.predicate_manager import PredicateManager
    from mdm.runtime import Channel, Subscription

__all__ = ["Follower"]


class Follower:
    """Keeps another agent's predicates up to date in a predicate manager.

    Args:
        manager: Where they are known as ``agent/Name``.
        agent: Whose they are.
        full: The other's map, read at first, and again when a counter shows that an update was lost.
    """

    def __init__(self, manager: PredicateManager, agent: str, full: Channel[PredicateMap]) -> None:
        self._manager = manager
        self._agent = agent
        self._full = full
        self._subscription: Subscription[PredicateMap] | None = None
        self._counter = -1

    def synchronise(self) -> None:
        """Read the other's whole map, once."""
        if self._subscription is None:
            self._subscription = self._manager.subscribe(self._full, self._map)

    def _map(self, message: PredicateMap) -> None:
        if self._subscription is not None:
            self._subscription.cancel()
            self._subscription = None
        self._counter = message.counter
        self._take(message.time, message.values.items())

    def update(self, update: PredicateUpdate) -> None:
        """Take what changed at the other agent."""
        if update.counter != self._counter + 1:
            self.synchronise()
        self._counter = update.counter
        changes = [(name, True) for name in update.rising]
        changes += [(name, False) for name in update.falling]
        self._take(update.time, [*changes, *((name, None) for name in update.unknown)])

    def _take(self, time: int, values: Iterable[tuple[str, bool | None]]) -> None:
        known = self._manager.known
        changes = tuple((f"{self._agent}/{name}", value) for name, value in values if f"{self._agent}/{name}" in known)
        if changes:
            self._manager.sensed.publish(SensorUpdate(time, changes))
