"""Plans: what changes of a network touch, found once for those that recur."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Change", "Plan"]


class Change(msgspec.Struct):
    """The changes of an update, by name: predicates that became true, false or unknown; events that occurred.

    ``armed`` are the holds whose formula became true, which starts their time; ``disarmed`` those whose formula ceased
    to be true. A change that recurs is the same object; with ``noted`` its reader may keep what it finds out about it.
    """

    rising: tuple[str, ...] = ()
    falling: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    armed: tuple[str, ...] = ()
    disarmed: tuple[str, ...] = ()
    noted: Any = None


class Plan:
    """What a set of changes touches.

    Args:
        codes: Four times the place of each node that changes, and its value.
        order: All that is downstream of them, in order.
        dirty: What depends on them immediately.
        formulas: What is downstream with its functions, if these are few and plain formulas: then to evaluate all is
            quicker than to find out which must be.
        raised: The places of events among them.

    Attributes:
        changes: What has come of it, by the formulas' values in base 4: 3 where one stays.
        outcome: These values when it came last, or -1.
        change: What came of it then.
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
