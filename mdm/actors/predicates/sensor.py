"""Handles that sensors' code holds: to set a predicate, to raise an event."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import Error

if TYPE_CHECKING:
    from mdm.actors.predicates.predicate_manager import PredicateManager

__all__ = ["EventSource", "Sensor", "truth"]

Readings = tuple[tuple[str, "bool | None"]]
"""The name of a predicate and its value, as the only ones of an update."""


def truth(name: str, value: object) -> bool | None:
    """Return the value of a predicate.

    Raises:
        Error: If it is no truth value: True, False, one of numpy's, or None for unknown.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    raise Error(f"predicate {name!r} is True, False or None (unknown), not {value!r}")


class Sensor:
    """Sets one predicate, from anywhere: a callback, a task, another thread.

    Args:
        name: The predicate.
        manager: Its predicate manager.
    """

    __slots__ = ("_false", "_manager", "_true", "name")

    def __init__(self, name: str, manager: PredicateManager) -> None:
        self.name = name
        self._manager = manager
        self._true: Readings = ((name, True),)
        self._false: Readings = ((name, False),)

    def set(self, value: bool | np.bool_ | None) -> None:
        """Say whether the predicate holds; None says that it is unknown.

        In the event loop all that follows has happened when this returns, up to the first line of an action's callback.
        In another thread this wakes the event loop, where it follows, and returns at once.

        Raises:
            Error: If the value is no truth value.
        """
        if value is True:
            readings = self._true
        elif value is False:
            readings = self._false
        else:
            readings = ((self.name, truth(self.name, value)),)
        self._manager.take(readings)

    @property
    def value(self) -> bool | None:
        """The predicate's present value."""
        return self._manager.value(self.name)


class EventSource:
    """Raises one event, from anywhere.

    Args:
        name: The event.
        manager: Its predicate manager.
    """

    __slots__ = ("_manager", "name")

    def __init__(self, name: str, manager: PredicateManager) -> None:
        self.name = name
        self._manager = manager

    def fire(self) -> None:
        """Say that the event has just occurred."""
        self._manager.occur(self.name)
