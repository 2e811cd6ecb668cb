"""An incrementally updated network of predicates and events: their declarations, their inputs, and its updates.

Nodes are in dependency order. An update evaluates each node downstream of a change at most once, so that transient
values are never visible, and stops where a value does not change. The nodes that depend on a change are found once
where it recurs, and remembered within bounds.
"""

from __future__ import annotations

import difflib
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec

from mdm.errors import Error, FormatError
from mdm.logic.formula import CODES, FALSE, TRUE, UNKNOWN, Formula, compile_formula, compile_hold, compile_latch
from mdm.logic.monitor import Monitor
from mdm.logic.parser import parse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence


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

    def monitor(self, name: str, formula: Formula | str) -> None:
        """Declare a predicate that is false where a formula in time is so for ever, else true: see `Monitor`."""
        self._declare(Declaration(name, "monitor", (Monitor(formula).formula,)))

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
                    if other.is_event and node.kind in {"define", "hold", "monitor"}:
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


_FEW = 8
"""Inputs given together, or formulas that depend on them, up to which what recurs is remembered whole."""
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
    """Results by key: a dictionary that is emptied when it is full."""

    __slots__ = ()

    def keep(self, key: K, value: V) -> V:
        """Remember a value, and return it."""
        if len(self) >= MOST:
            self.clear()
        self[key] = value
        return value


_VALUE = (False, None, True)
_LONGEST: Final = 64
_STAYS: Final = 3


class Network(Declarations):
    """Input and derived predicates and events: declare them, `compile`, then `update`.

    Attributes:
        monitors: The monitors by their predicates; each update that changes one of theirs is a valuation.
    """

    # What each decision reads or writes, close together: among many ensembles what is far apart is not in the cache.
    __slots__ = ("_plans", "_raisings", "_readings", "_values", "monitors")

    def __init__(self) -> None:
        super().__init__()
        self._values: list[int] = []
        self._names: list[str | None] = []
        self._index: dict[str, int] = {}
        self._events: dict[str, int] = {}
        self._functions: list[Callable[[list[int]], int] | None] = []
        self._dependents: list[tuple[int, ...]] = []
        self._downstream: dict[int, tuple[int, ...]] = {}
        self._holds: dict[int, tuple[str, int]] = {}
        self._flags: dict[str, int] = {}
        self._rises: dict[int, int] = {}
        self._special: frozenset[int] = frozenset()
        self.monitors: dict[str, Monitor] = {}
        self._ended: dict[int, tuple[int, ...]] = {}
        # What recurs: inputs and events, by what was given; what changes touch, and how many changes this has made.
        self._inputs = Inputs(self._nodes, self._index)
        self._readings, self._raisings = self._inputs.readings, self._inputs.raisings
        self._plans: Memory[tuple[int, ...], Plan] = Memory()
        self._kept = 0

    # -- Compilation ---------------------------------------------------------------------------------------------

    def compile(self) -> Change:
        """Order and evaluate the nodes; return the change from all unknown to the first values.

        Raises:
            Error: If there is a cycle, an undeclared name, or an event where only a predicate is allowed.
        """
        self._add_remote()
        self._check()
        order = self._order()
        formula_index: dict[str, int] = {}
        for name in order:
            node = self._nodes[name]
            if node.kind in {"hold", "rise"}:
                formula_index[name] = self._place(None, UNKNOWN)
            if node.kind == "hold":
                self._flags[name] = self._place(None, FALSE)
            index = self._place(name, node.initial)
            self._index[name] = index
            if node.is_event:
                self._events[name] = index
        for name in order:
            self._compile_node(self._nodes[name], formula_index.get(name, -1))
        self._link()
        self._special = frozenset((*self._holds, *self._rises))
        for event in self._events.values():
            self._ended[event] = tuple(formula for formula in self._rises if formula in self._dependents[event])
        return self._first()

    def _place(self, name: str | None, value: int) -> int:
        self._names.append(name)
        self._values.append(value)
        self._functions.append(None)
        return len(self._names) - 1

    def _compile_node(self, node: Declaration, formula: int) -> None:
        index = self._index[node.name]
        if node.kind == "define":
            self._functions[index] = compile_formula(node.formulas[0], self._index)
        elif node.kind == "latch":
            self._functions[index] = compile_latch(node.formulas[0], node.formulas[1], self._index, index)
        elif node.kind == "monitor":
            self.monitors[node.name] = Monitor(node.formulas[0])
            self._functions[index] = self.monitors[node.name].compiled(self._index)
        elif node.kind in {"hold", "rise"}:
            self._functions[formula] = compile_formula(node.formulas[0], self._index)
            if node.kind == "hold":
                self._functions[index] = compile_hold(formula, self._flags[node.name])
                self._holds[formula] = (node.name, self._flags[node.name])
            else:
                self._rises[formula] = index

    def _link(self) -> None:
        dependents: list[set[int]] = [set() for _ in self._names]
        formulas = {name: formula for formula, (name, _) in self._holds.items()}
        formulas |= {str(self._names[event]): formula for formula, event in self._rises.items()}
        for node in self._nodes.values():
            index = self._index[node.name]
            reader = formulas.get(node.name, index)
            for formula in node.formulas:
                for name in formula.names:
                    dependents[self._index[name]].add(reader)
            if node.kind == "hold":
                dependents[reader].add(index)
                dependents[self._flags[node.name]].add(index)
        self._dependents = [tuple(sorted(found)) for found in dependents]

    def _below(self, index: int) -> tuple[int, ...]:
        """Return all that depends on a node, in order; found when it is first asked for, since chains may be long."""
        order = self._downstream.get(index)
        if order is None:
            found: set[int] = set()
            waiting = [index]
            while waiting:
                at = waiting.pop()
                readers = [*self._dependents[at], *([self._rises[at]] if at in self._rises else [])]
                waiting += [reader for reader in readers if reader not in found]
                found.update(readers)
            order = tuple(reader for reader in sorted(found) if self._functions[reader] is not None)
            self._downstream[index] = order
        return order

    def _plan(self, codes: tuple[int, ...]) -> Plan:
        """Return the codes of changes: four times a node's place, and its value, of each."""
        found = self._plans.get(codes)
        if found is not None:
            return found
        roots = tuple([code >> 2 for code in codes])
        if len(roots) == 1:
            order = self._below(roots[0])
        else:
            order = tuple(sorted({at for root in roots for at in self._below(root)}))
        dirty = frozenset(at for root in roots for at in self._dependents[root])
        plain = len(order) <= _FEW and all(
            self._names[at] is not None and self._nodes[str(self._names[at])].kind == "define" for at in order
        )
        functions = [(at, self._functions[at]) for at in order] if plain else []
        formulas = tuple((at, function) for at, function in functions if function is not None)
        raised = tuple([at for at in roots if at in self._ended])
        plan = Plan(codes, order, dirty, formulas if plain else None, raised)
        return self._plans.keep(codes, plan) if _recurs(plan) else plan

    def _first(self) -> Change:
        order = tuple(index for index, function in enumerate(self._functions) if function is not None)
        raised: list[int] = []
        armed: list[str] = []
        self._propagate(order, set(order), [], raised, armed, [])
        self._end(raised)
        known = {name: self._values[self._index[name]] for name in self.names}
        return Change(
            rising=tuple(name for name, value in known.items() if value == TRUE),
            falling=tuple(name for name, value in known.items() if value == FALSE),
            events=tuple(str(self._names[index]) for index in raised),
            armed=tuple(armed),
        )

    # -- Values --------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all predicates."""
        return tuple(name for name, node in self._nodes.items() if not node.is_event)

    @property
    def events(self) -> tuple[str, ...]:
        """The names of all events."""
        return tuple(name for name, node in self._nodes.items() if node.is_event)

    def value(self, name: str) -> bool | None:
        """Return a predicate's value."""
        try:
            return _VALUE[self._values[self._index[name]]]
        except KeyError:
            raise Error(f"there is no predicate {name!r}") from None

    def values(self) -> dict[str, bool | None]:
        """Return the value of every predicate."""
        return {name: _VALUE[self._values[self._index[name]]] for name in self.names}

    # -- Updates -------------------------------------------------------------------------------------------------

    def update(  # noqa: C901 - hot path, no calls
        self,
        inputs: Sequence[tuple[str, bool | None]],
        events: Sequence[str] = (),
        elapsed: Sequence[str] = (),
    ) -> Change | None:
        """Set inputs, raise events and end the time of holds; return the change, or None if there is none.

        The last of several values for an input counts. Hot path, most of all where inputs and events are tuples: what
        recurs is looked up.

        Raises:
            Error: If a name is unknown or not an input, or a value is not a truth value; nothing is changed then.
        """
        if elapsed:
            return self._update_elapsed(inputs, events, elapsed)
        try:
            if not events:
                given = self._readings[inputs]
            elif not inputs:
                given = self._raisings[events]
            else:
                given = Given((*self._readings[inputs].places, *self._raisings[events].places))
        except (KeyError, TypeError):
            given = self._inputs.together(inputs, events)
        places = given.places
        values = self._values
        changed: list[int] = []
        for at, code in places:
            if values[at] != code:
                values[at] = code
                changed.append(at)
        if not changed:
            return None
        plan = given.plan
        if plan is None or len(changed) != len(places):
            plan = self._plan(tuple([4 * at + values[at] for at in changed]))
            if len(changed) == len(places) and _recurs(plan):
                given.plan = plan
        if plan.formulas is None:
            return self._settle(changed[: len(changed) - len(plan.raised)], plan.raised, plan)
        outcome = 0
        for at, function in plan.formulas:
            value = function(values)
            if value != values[at]:
                values[at] = value
                outcome = 4 * outcome + value
            else:
                outcome = 4 * outcome + _STAYS
        for at in plan.raised:
            values[at] = FALSE
        if outcome != plan.outcome:
            plan.change = plan.changes.get(outcome) or self._recurring(plan, outcome)
            plan.outcome = outcome
        return plan.change

    def _recurring(self, plan: Plan, outcome: int) -> Change:
        """Return the change that comes of a plan with that outcome of its formulas, and remember it."""
        changed = [code >> 2 for code in plan.codes if code >> 2 not in self._ended]
        formulas = plan.formulas or ()
        for power, (at, _) in zip(range(len(formulas) - 1, -1, -1), formulas, strict=True):
            if outcome >> 2 * power & 3 != _STAYS:
                changed.append(at)
        change = self._change(changed, list(plan.raised), [], [])
        assert change is not None
        if self._kept >= MOST:
            self._kept = 0
            for memory in (self._plans, self._readings, self._raisings):
                memory.clear()
        self._kept += 1
        plan.changes[outcome] = change
        return change

    def _update_elapsed(
        self, inputs: Sequence[tuple[str, bool | None]], events: Sequence[str], elapsed: Sequence[str]
    ) -> Change | None:
        """As `update`, where the time of holds ends."""
        places, raised = self._inputs.read(inputs).places, self._inputs.raised(events).places
        changed = [at for at, code in places if self._values[at] != code]
        for at, code in places:
            self._values[at] = code
        flags = dict.fromkeys(self._flags[name] for name in elapsed)
        ended = [flag for flag in flags if self._values[flag] != TRUE]
        for flag in ended:
            self._values[flag] = TRUE
        return self._settle([*changed, *ended], tuple([at for at, _ in raised]))

    def _settle(self, changed: list[int], given: tuple[int, ...], plan: Plan | None = None) -> Change | None:
        """Update everything downstream of changed inputs and raised events; return the change."""
        for at in given:
            self._values[at] = TRUE
        raised = list(given)
        if not changed and not raised:
            return None
        if plan is None:
            plan = self._plan(tuple([4 * at + self._values[at] for at in (*changed, *given)]))
        armed: list[str] = []
        disarmed: list[str] = []
        if plan.dirty:
            self._propagate(plan.order, set(plan.dirty), changed, raised, armed, disarmed)
        if raised:
            self._end(raised)
        return self._change(changed, raised, armed, disarmed)

    def _propagate(
        self,
        order: tuple[int, ...],
        dirty: set[int],
        changed: list[int],
        raised: list[int],
        armed: list[str],
        disarmed: list[str],
    ) -> None:
        values, functions, dependents, special = self._values, self._functions, self._dependents, self._special
        for at in order:
            if at not in dirty:
                continue
            value = functions[at](values)  # type: ignore[misc]
            old = values[at]
            if value == old:
                continue
            values[at] = value
            dirty.update(dependents[at])
            changed.append(at)
            if at not in special:
                continue
            if at in self._holds:
                name, flag = self._holds[at]
                if value == TRUE:
                    armed.append(name)
                elif old == TRUE:
                    disarmed.append(name)
                    values[flag] = FALSE
            elif value == TRUE:
                event = self._rises[at]
                values[event] = TRUE
                raised.append(event)
                dirty.update(dependents[event])

    def _end(self, raised: list[int]) -> None:
        """End the events; update formulas over them without reporting a change."""
        values = self._values
        for at in raised:
            values[at] = FALSE
        for at in raised:
            for formula in self._ended[at]:
                values[formula] = self._functions[formula](values)  # type: ignore[misc]

    def _change(self, changed: list[int], raised: list[int], armed: list[str], disarmed: list[str]) -> Change | None:
        rising: list[str] = []
        falling: list[str] = []
        unknown: list[str] = []
        kinds = (falling, unknown, rising)
        names, values = self._names, self._values
        for at in changed:
            name = names[at]
            if name is not None:
                kinds[values[at]].append(name)
        if not (rising or falling or unknown or raised or armed or disarmed):
            return None
        return Change(
            tuple(rising),
            tuple(falling),
            tuple(unknown),
            tuple([str(names[at]) for at in raised]) if raised else (),
            tuple(armed),
            tuple(disarmed),
        )


def _recurs(plan: Plan) -> bool:
    """Whether a plan is short enough to be kept."""
    return len(plan.order) <= _LONGEST and len(plan.codes) <= _LONGEST
