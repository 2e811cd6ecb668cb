"""Handles that sensors' code holds: to set a predicate, to raise an event."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mdm.actors.predicate_manager import PredicateManager

__all__ = ["EventSource", "Sensor"]

Reading = tuple[tuple[str, "bool | None"], ...]


class Sensor:
    """Sets one predicate, from anywhere: a callback, a task, another thread.

    Args:
        name: The predicate.
        manager: Its predicate manager.
    """

    __slots__ = ("_manager", "_readings", "name")

    def __init__(self, name: str, manager: PredicateManager) -> None:
        self.name = name
        self._manager = manager
        self._readings: dict[bool | None, Reading] = {value: ((name, value),) for value in (True, False, None)}

    def set(self, value: bool | np.bool_ | None) -> None:
        """Say whether the predicate holds; None says that it is unknown.

        Raises:
            TypeError: If the value is no truth value.
        """
        if value is not True and value is not False and value is not None:
            if not isinstance(value, np.bool_):
                raise TypeError(f"predicate {self.name!r} is True, False or None (unknown), not {value!r}")
            value = bool(value)
        self._manager.take(self._readings[value])

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
