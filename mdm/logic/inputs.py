"""Inputs of a network: the place of each value and event by name, and the nodes that depend on a change.

The nodes that depend on a change are found once where it recurs, and remembered within bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mdm.errors import Error
from mdm.logic.declarations import similar
from mdm.logic.formula import CODES, TRUE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mdm.logic.declarations import Declaration

__all__ = ["Change", "Given", "Inputs", "Memory", "Plan"]

_FEW = 8
K = TypeVar("K")
V = TypeVar("V")
MOST = 4096
"""Entries of a memory."""


class Given:
    """Values of inputs, or events, that are given together.

    Args:
        places: The place of each and the code of its value.

    Attributes:
        plan: The nodes that depend on them, where all of them change; None where that is not known yet.
    """

    __slots__ = ("places", "plan")

    def __init__(self, places: tuple[tuple[int, int], ...]) -> None:
        self.places = places
        self.plan: Plan | None = None


class Inputs:
    """The inputs and events that may be given to a network.

    Args:
        nodes: All predicates and events.
        index: Their places.

    Attributes:
        readings: Values that were given before.
        raisings: Events that were raised before.
    """

    __slots__ = ("_index", "_nodes", "raisings", "readings")

    def __init__(self, nodes: Mapping[str, Declaration], index: Mapping[str, int]) -> None:
        self._nodes = nodes
        self._index = index
        self.readings: Memory[Sequence[tuple[str, bool | None]], Given] = Memory()
        self.raisings: Memory[Sequence[str], Given] = Memory()

    def read(self, inputs: Sequence[tuple[str, bool | None]]) -> Given:
        """Return the meaning of inputs' values; of several for one input the last counts.

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
        read = Given(tuple(places.items()))
        return self.readings.keep(inputs, read) if isinstance(inputs, tuple) and len(inputs) <= _FEW else read

    def raised(self, events: Sequence[str]) -> Given:
        """Return the meaning of events, each counted once.

        Raises:
            Error: If a name is unknown, or not an event that is raised from outside.
        """
        for name in events:
            node = self._nodes.get(name)
            if node is None or node.kind != "event":
                raise self._refusal(name)
        raised = Given(tuple([(at, TRUE) for at in dict.fromkeys(self._index[name] for name in events)]))
        return self.raisings.keep(events, raised) if isinstance(events, tuple) and len(events) <= _FEW else raised

    def together(self, inputs: Sequence[tuple[str, bool | None]], events: Sequence[str]) -> Given:
        """Return the meaning of values of inputs and of events that are given together.

        Raises:
            Error: As `read` and `raised` do.
        """
        if not events:
            return self.read(inputs)
        if not inputs:
            return self.raised(events)
        return Given((*self.read(inputs).places, *self.raised(events).places))

    def _refusal(self, name: str) -> Error:
        if name not in self._index:
            return Error(f"there is no predicate or event {name!r}{similar(name, self._index)}")
        kind = "raised: it is not an event" if self._nodes[name].kind == "input" else "set from outside: it is derived"
        return Error(f"{name!r} cannot be {kind}")


class Change(msgspec.Struct):
    """The changes of an update, by name: predicates that became true, false or unknown; events that occurred.

    ``armed`` are the holds whose formula became true, which starts their time; ``disarmed`` those whose formula ceased
    to be true. A change that recurs is the same object; with ``noted`` its reader may keep notes about it.
    """

    rising: tuple[str, ...] = ()
    falling: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    armed: tuple[str, ...] = ()
    disarmed: tuple[str, ...] = ()
    noted: Any = None


class Plan:
    """The nodes that depend on a set of changes.

    Args:
        codes: Four times the place of each node that changes, and its value.
        order: All that is downstream of them, in order.
        dirty: The nodes that depend on them immediately.
        formulas: The nodes downstream with their functions, if these are few and plain formulas: then to evaluate all
            is quicker than to find out which must be.
        raised: The places of events among them.

    Attributes:
        changes: Its results, by the formulas' values in base 4: 3 where one stays.
        outcome: These values when it came last, or -1.
        change: Its result then.
    """

    __slots__ = ("change", "changes", "codes", "dirty", "formulas", "order", "outcome", "raised")

    def __init__(
        self,
        codes: tuple[int, ...],
        order: tuple[int, ...],
        dirty: frozenset[int],
        formulas: tuple[tuple[int, Callable[[list[int]], int]], ...] | None,
        raised: tuple[int, ...],
    ) -> None:
        self.codes = codes
        self.order = order
        self.dirty = dirty
        self.formulas = formulas
        self.raised = raised
        self.changes: dict[int, Change] = {}
        self.outcome = -1
        self.change: Change | None = None


class Memory(dict[K, V]):
    """Results by key: a dictionary that begins anew when it is full."""

    __slots__ = ()

    def keep(self, key: K, value: V) -> V:
        """Remember a value, and return it."""
        if len(self) >= MOST:
            self.clear()
        self[key] = value
        return value
