"""Declarations of predicates and events, and checks of their consistency."""

from __future__ import annotations

import difflib
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

from mdm.errors import Error, FormatError
from mdm.logic.formula import CODES, FALSE, UNKNOWN, Formula
from mdm.logic.parser import parse

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["Declaration", "Declarations", "similar"]


class Declaration:
    """One predicate or event, as declared."""

    __slots__ = ("formulas", "initial", "kind", "name")

    def __init__(self, name: str, kind: str, formulas: tuple[Formula, ...] = (), initial: int = UNKNOWN) -> None:
        self.name = name
        self.kind = kind
        self.formulas = formulas
        self.initial = initial

    @property
    def is_event(self) -> bool:
        """Whether it is an event, raised from outside or by a formula."""
        return self.kind in {"event", "rise"}


class Declarations:
    """Predicates and events by name, each declared once."""

    def __init__(self) -> None:
        self._nodes: dict[str, Declaration] = {}
        self.remote: tuple[str, ...] = ()

    def _declare(self, node: Declaration) -> None:
        if node.name in self._nodes:
            raise Error(f"{node.name!r} is declared twice")
        self._nodes[node.name] = node

    def add_input(self, name: str, value: bool | None = None) -> None:
        """Declare a predicate that is set from outside."""
        self._declare(Declaration(name, "input", initial=CODES[value]))

    def add_event(self, name: str) -> None:
        """Declare an event that is raised from outside, and true only during the update that raises it."""
        self._declare(Declaration(name, "event", initial=FALSE))

    def define(self, name: str, formula: Formula | str) -> None:
        """Declare a predicate by a formula over predicates."""
        self._declare(Declaration(name, "define", (_tree(name, formula),)))

    def latch(self, name: str, *, set: Formula | str, reset: Formula | str, initial: bool = False) -> None:  # noqa: A002
        """Declare a predicate that is true from ``set`` until ``reset``, which has precedence; unknown changes nothing.

        Both formulas may name events.
        """
        self._declare(Declaration(name, "latch", (_tree(name, set), _tree(name, reset)), CODES[initial]))

    def hold(self, name: str, formula: Formula | str) -> None:
        """Declare a predicate equal to its formula, except that it becomes true only when its time has elapsed."""
        self._declare(Declaration(name, "hold", (_tree(name, formula),)))

    def rise(self, name: str, formula: Formula | str) -> None:
        """Declare an event that occurs when a formula changes from false or unknown to true.

        The formula may name events; it is then evaluated at each of them.
        """
        self._declare(Declaration(name, "rise", (_tree(name, formula),), FALSE))

    def _add_remote(self) -> None:
        used = {name for node in self._nodes.values() for formula in node.formulas for name in formula.names}
        self.remote = tuple(sorted(name for name in used - self._nodes.keys() if "/" in name))
        for name in self.remote:
            self.add_input(name)

    def _check(self) -> None:
        for node in self._nodes.values():
            for formula in node.formulas:
                for name in sorted(formula.names):
                    other = self._nodes.get(name)
                    if other is None:
                        hint = similar(name, self._nodes)
                        raise Error(f"{node.name!r} uses {name!r}, which is not declared{hint}")
                    if other.is_event and node.kind in {"define", "hold"}:
                        raise Error(
                            f"{node.name!r} uses the event {name!r}, which has no lasting value: store it in a latch"
                        )

    def _order(self) -> list[str]:
        sorter: TopologicalSorter[str] = TopologicalSorter()
        for node in self._nodes.values():
            sorter.add(node.name, *sorted({name for formula in node.formulas for name in formula.names}))
        try:
            return list(sorter.static_order())
        except CycleError as error:
            cycle: list[str] = error.args[1]
            raise Error(f"predicates depend on each other in a cycle: {' -> '.join(reversed(cycle))}") from None


def _tree(name: str, formula: Formula | str) -> Formula:
    if isinstance(formula, Formula):
        return formula
    try:
        return parse(formula)
    except FormatError as error:
        raise FormatError(f"in the formula of {name!r}: {error.message}", column=error.column) from None


def similar(name: str, known: Iterable[str]) -> str:
    """Return a hint at known names similar to a wrong one, or an empty text."""
    close = difflib.get_close_matches(name, list(known), n=3)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
