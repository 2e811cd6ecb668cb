"""Declarations: the predicates and events of a TOML file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.actors import PredicateManager
from mdm.actors.predicates.declarations import ACTION_END, near_end
from mdm.config.tables import EventTable, PredicateTable
from mdm.errors import ConfigError
from mdm.logic import Formula, parse, similar
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from mdm.config.problems import Problems
    from mdm.config.share import Share

__all__ = ["Declarations"]

_KEYS = {
    "sensor": ("sensor", "when", "max_age", "initial"),
    "formula": ("formula", "held_for"),
    "latch": ("set", "reset", "initial"),
}


class Declarations:
    """Makes the declarations of a file's tables ``predicates`` and ``events``.

    Args:
        problems: Where problems are noted.
        share: In a team's file, whose part it is; ``robot2/IsMoving`` is the file's name at that agent.

    Attributes:
        manager: The predicate manager that knows them.
    """

    def __init__(self, problems: Problems, share: Share | None = None) -> None:
        self.manager = PredicateManager()
        self._problems = problems
        self._share = share
        self._formulas: list[tuple[str, Formula]] = []

    def declare(self, document: dict[str, Any]) -> None:
        """Declare predicates and events, even invalid ones, so that their uses are not reported as well."""
        for name, value in self._problems.tables(document, "predicates"):
            with self._problems.collecting(f"predicates.{name}"):
                self._predicate(name, value)
            if self.manager.declared.knows(name) is None:
                self.manager.sensor(name)
        for name, value in self._problems.tables(document, "events"):
            with self._problems.collecting(f"events.{name}"):
                self._event(name, value)
            if self.manager.declared.knows(name) is None:
                self.manager.event(name)

    def declare_others(self, ensembles: object) -> None:
        """Declare the events of other agents that formulas and the observations of ensembles name."""
        if self._share is None:
            return
        used = [name for _, formula in self._formulas for name in formula.names]
        if isinstance(ensembles, dict):
            tables = [table for table in ensembles.values() if isinstance(table, dict)]
            used += [name for table in tables for name in texts_in(table.get("observations"))]
        for name in dict.fromkeys(used):
            agent, slash, event = name.partition("/")
            foreign = slash and agent in self._share.team.names and agent != self._share.agent
            declared = self.manager.declared.names
            if foreign and declared.get(event) == "event" and name not in declared:
                self.manager.event(name)

    def _predicate(self, name: str, value: Any) -> None:
        key = f"predicates.{name}"
        written = {"formula": value} if isinstance(value, str) else value
        table: PredicateTable | None = self._problems.convert(written, PredicateTable, key)
        if table is None:
            return
        _refuse_mixture(table, written)
        if table.formula is not None:
            self.manager.define(name, self._formula(table.formula, key), held_for=table.held_for)
        elif table.set is not None and table.reset is not None:
            on, off = self._formula(table.set, key), self._formula(table.reset, key)
            self.manager.latch(name, set=on, reset=off, initial=bool(table.initial))
        else:
            self.manager.sensor(name, when=table.when, max_age=table.max_age, initial=table.initial)

    def _event(self, name: str, value: Any) -> None:
        key = f"events.{name}"
        written = {"formula": value} if isinstance(value, str) else value
        table: EventTable | None = self._problems.convert(written, EventTable, key)
        if table is not None:
            self.manager.event(name, None if table.formula is None else self._formula(table.formula, key))

    def _formula(self, text: str, key: str) -> Formula:
        formula = parse(text)
        if self._share is not None:
            formula = self._share.formula(formula)
        self._formulas.append((key, formula))
        return formula

    def check(self) -> None:
        """Note undeclared names in formulas, and formulas that depend on themselves."""
        if not self._undeclared():
            with self._problems.collecting("predicates"):
                self.manager.network().compile()

    def check_ends(self, actions: Collection[str]) -> None:
        """Note ends of actions that no ensemble has."""
        for event in self.manager.declared.used:
            action = event.rpartition(".")[0]
            if ACTION_END.fullmatch(event) and "/" not in event and action not in actions:
                hint = similar(action, actions)
                self._problems.add(f"{event!r} is the end of an unknown action{hint}", "predicates")

    def _undeclared(self) -> bool:
        """Report undeclared names in formulas; return whether there are any."""
        before = len(self._problems)
        for key, formula in self._formulas:
            for name in sorted(formula.names):
                if self._share is not None:
                    with self._problems.collecting(key):
                        self._share.check_name(name, self.manager.declared.names)
                if self.manager.declared.knows(name) is None:
                    hint = similar(name, self.manager.declared.names) or near_end(name)
                    user = key.partition(".")[2]
                    self._problems.add(f"{user!r} uses {name!r}, which is not declared{hint}", key)
        return len(self._problems) > before


def _refuse_mixture(table: PredicateTable, keys: Iterable[str]) -> None:
    """Refuse a mixture of keys of a sensor, a formula and a latch."""
    latch = table.set is not None or table.reset is not None
    kind = "latch" if latch else "sensor" if table.formula is None else "formula"
    if latch and table.formula is not None:
        raise ConfigError("a predicate has either a formula or 'set' and 'reset', not both")
    if latch and (table.set is None or table.reset is None):
        raise ConfigError("a latch needs both 'set' and 'reset'")
    if kind == "sensor" and table.held_for is not None:
        raise ConfigError("held_for needs a formula: it is the time for which that must be true")
    if kind == "sensor" and not table.sensor:
        raise ConfigError("a predicate that is not a sensor needs a 'formula', or 'set' and 'reset'")
    for key in keys:
        if key not in _KEYS[kind]:
            raise ConfigError(f"{key!r} means nothing for a {kind}; its keys are {', '.join(_KEYS[kind])}")
