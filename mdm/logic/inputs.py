"""Inputs of a network: which values and events, by name, mean which of its places."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.logic.compiler import CODES
from mdm.logic.declarations import similar
from mdm.logic.memory import Memory

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.logic.declarations import Declaration

__all__ = ["Inputs"]

_FEW = 8


class Inputs:
    """The inputs and events that may be given to a network.

    Args:
        nodes: All predicates and events.
        index: Their places.

    Attributes:
        readings: Places and codes of values that were given before.
        raisings: Places of events that were raised before.
    """

    __slots__ = ("_index", "_nodes", "raisings", "readings")

    def __init__(self, nodes: Mapping[str, Declaration], index: Mapping[str, int]) -> None:
        self._nodes = nodes
        self._index = index
        self.readings: Memory[Sequence[tuple[str, bool | None]], tuple[tuple[int, int], ...]] = Memory()
        self.raisings: Memory[Sequence[str], tuple[int, ...]] = Memory()

    def read(self, inputs: Sequence[tuple[str, bool | None]]) -> tuple[tuple[int, int], ...]:
        """Return the place and the code of each input's value, the last one of several.

        Raises:
            Error: If a name is unknown or not an input, or a value is not a truth value.
        """
        places: dict[int, int] = {}
        for name, value in inputs:
            node = self._nodes.get(name)
            if node is None or node.kind != "input":
                raise self._refusal(name)
            try:
                places[self._index[name]] = CODES[value]
            except (KeyError, TypeError):
                raise Error(f"predicate {name!r} is True, False or None (unknown), not {value!r}") from None
        read = tuple(places.items())
        return self.readings.keep(inputs, read) if isinstance(inputs, tuple) and len(inputs) <= _FEW else read

    def raised(self, events: Sequence[str]) -> tuple[int, ...]:
        """Return the place of each event, once.

        Raises:
            Error: If a name is unknown, or not an event that is raised from outside.
        """
        for name in events:
            node = self._nodes.get(name)
            if node is None or node.kind != "event":
                raise self._refusal(name)
        raised = tuple(dict.fromkeys(self._index[name] for name in events))
        return self.raisings.keep(events, raised) if isinstance(events, tuple) and len(events) <= _FEW else raised

    def _refusal(self, name: str) -> Error:
        if name not in self._index:
            return Error(f"there is no predicate or event {name!r}{similar(name, self._index)}")
        kind = "raised: it is not an event" if self._nodes[name].kind == "input" else "set from outside: it is derived"
        return Error(f"{name!r} cannot be {kind}")
