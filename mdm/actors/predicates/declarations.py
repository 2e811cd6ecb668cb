"""Declarations: the predicates and events of a predicate manager, their formulas, and their network."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING, Literal

from mdm.errors import ConfigError, Error
from mdm.logic import Network, similar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from mdm.logic import Formula, Threshold

Kind = Literal["predicate", "event"]


_ENDS = ("running", "succeeded", "failed", "preempted", "timed_out", "abandoned", "gave_up")


ACTION_END = re.compile(rf".+\.({'|'.join(_ENDS)})")


def near_end(name: str) -> str:
    """Return a hint at the end of an action that a wrong name is near, or an empty text."""
    action, _, end = name.rpartition(".")
    near = difflib.get_close_matches(end, _ENDS, n=1)
    return f"; did you mean {f'{action}.{near[0]}'!r}?" if action and near else ""


class Declarations:
    """The declarations, by name; beside them, names that are known by their form, such as ``Patrol.succeeded``.

    Attributes:
        held_for: Nanoseconds for which a predicate's formula must have been true.
        max_age: Nanoseconds after which a sensor's value becomes unknown.
        thresholds: When a predicate holds that is told by numbers.
        tellers: In words, who sets a predicate or raises an event in the place of code.
        initial: The values that predicates begin with, where these were given.
        monitors: The predicates that monitor a formula in time.
    """

    __slots__ = (
        *("_ages", "_formulas", "_kinds", "_parts", "_sensors", "_used"),
        *("held_for", "initial", "max_age", "monitors", "tellers", "thresholds"),
    )

    def __init__(self) -> None:
        self._parts: dict[str, Callable[[Network], None]] = {}
        self._kinds: dict[str, Kind] = {}
        self._formulas: dict[str, tuple[Formula, ...]] = {}
        self._sensors: set[str] = set()
        self._used: set[str] = set()
        self.held_for: dict[str, int] = {}
        self.max_age: dict[str, int] = {}
        self.thresholds: dict[str, Threshold] = {}
        self.tellers: dict[str, str] = {}
        self.initial: dict[str, bool] = {}
        self.monitors: set[str] = set()
        self._ages: dict[str, tuple[float, str]] = {}

    def add(
        self, name: str, kind: Kind, part: Callable[[Network], None], *formulas: Formula, sensed: bool = False
    ) -> None:
        """Declare a predicate or an event.

        Args:
            name: Its name.
            kind: Which of the two.
            part: Adds it to a network.
            formulas: The formulas that define it; none where code sets or raises it.
            sensed: Whether it is a predicate that code sets.

        Raises:
            ConfigError: If there is one of that name already.
        """
        if name in self._kinds:
            raise ConfigError(f"{name!r} is declared twice; a name stands for one predicate or event", key=name)
        self._kinds[name] = kind
        self._parts[name] = part
        self._formulas[name] = formulas
        if sensed:
            self._sensors.add(name)

    def knows(self, name: str) -> Kind | None:
        """Return the kind of thing that a name stands for: as declared, or by its form.

        Ends of actions, such as ``Patrol.succeeded``, are events, and ``agent/Name`` is another agent's predicate.
        """
        if name in self._kinds:
            return self._kinds[name]
        if ACTION_END.fullmatch(name):
            return "event"
        return "predicate" if "/" in name else None

    def check_input(self, name: str, kind: Kind) -> None:
        """Refuse a name that code cannot set, or raise.

        Ends of actions and other agents' predicates are accepted where they are used.

        Raises:
            Error: If there is no such predicate or event, or it is derived; it names those closest.
        """
        if self.senses(name) if kind == "predicate" else self.raises(name):
            return
        declared = self._kinds.get(name)
        if declared is None and self.knows(name) == kind and name in self.used:
            return
        if declared == kind:
            raise Error(f"{kind} {name!r} is derived from others: give those")
        others = [other for other, its_kind in self._kinds.items() if its_kind == kind]
        hint = f": it is an {declared}" if declared == "event" else f": it is a {declared}" if declared else ""
        hint = (
            hint or similar(name, others) or f"; {'there are ' + ', '.join(others) if others else 'none is declared'}"
        )
        raise Error(f"there is no {kind} {name!r}{hint}")

    def formulas(self, name: str) -> tuple[Formula, ...]:
        """Return the formulas that define a name: of a latch two; none where code sets or raises it."""
        return self._formulas[name]

    def senses(self, name: str) -> bool:
        """Whether a name is a predicate that code sets."""
        return name in self._sensors

    def derived(self, name: str) -> bool:
        """Whether a name is defined by formulas over others."""
        return bool(self._formulas.get(name))

    def raises(self, name: str) -> bool:
        """Whether a name is an event that code raises."""
        return self._kinds.get(name) == "event" and not self._formulas[name]

    def age(self, names: Iterable[str], seconds: float, teller: str) -> None:
        """Declare that an actor sets these predicates, which become unknown after so many seconds.

        Args:
            names: The predicates.
            seconds: The seconds.
            teller: Tells them, in words.
        """
        self._ages.update(dict.fromkeys(names, (seconds, teller)))

    def moves(self, name: str) -> bool:
        """Whether a name is told by an actor that says where the robot is."""
        return name in self._ages or name.rpartition(".")[0] in self._ages

    def use(self, *names: str) -> None:
        """Ask for names that are known by their form, so that the network has them; call this before the start."""
        self._used.update(names)

    @property
    def used(self) -> tuple[str, ...]:
        """Every name that formulas and factors use, sorted."""
        names = {name for formulas in self._formulas.values() for formula in formulas for name in formula.names}
        return tuple(sorted(names | self._used))

    @property
    def names(self) -> dict[str, Kind]:
        """Everything declared so far."""
        return dict(self._kinds)

    def definition(self, name: str) -> str:
        """Return in words how a predicate or event is defined: code, a formula, a latch, an action's end."""
        kind = self._kinds.get(name)
        if kind is None:
            return "an action's end" if ACTION_END.fullmatch(name) else "another agent's predicate"
        formulas = self._formulas[name]
        if len(formulas) == 2:
            return f"set by {formulas[0]}, reset by {formulas[1]}"
        if formulas:
            if name in self.monitors:
                return f"false once {formulas[0]} is false for ever"
            held = f", held for {self.held_for[name] / 1e9:g} s" if name in self.held_for else ""
            return f"{formulas[0]}{held}"
        if name in self._ages:
            seconds, teller = self._ages[name]
            return f"told by {teller}, unknown after {seconds:g} s"
        aged = f", unknown after {self.max_age[name] / 1e9:g} s" if name in self.max_age else ""
        told = f" to a number: {self.thresholds[name]}" if name in self.thresholds else ""
        return f"{'raised' if kind == 'event' else 'set'} by {self.tellers.get(name, 'code')}{told}{aged}"

    def written(self, name: str) -> dict[str, str | float]:
        """Return a declaration as a table of a file has it, times in seconds."""
        formulas = self._formulas[name]
        keys = ("set", "reset") if len(formulas) == 2 else ("monitor" if name in self.monitors else "formula",)
        table: dict[str, str | float] = dict(zip(keys, map(str, formulas), strict=False))
        table |= {"when": str(self.thresholds[name])} if name in self.thresholds else {}
        times = {"held_for": self.held_for, "max_age": self.max_age}
        return table | {key: ages[name] / 1e9 for key, ages in times.items() if name in ages}

    def inputs_of(self, name: str) -> set[str]:
        """Return the names of all sensors and events that a predicate or event depends on, itself included."""
        found: set[str] = set()
        waiting = [name]
        while waiting:
            current = waiting.pop()
            if current not in found:
                found.add(current)
                waiting += [used for formula in self._formulas.get(current, ()) for used in formula.names]
        return found

    @property
    def aged(self) -> frozenset[str]:
        """The predicates that become unknown when they are not refreshed."""
        return frozenset(self.max_age) | self._ages.keys()

    def network(self, told: Mapping[str, bool | None]) -> Network:
        """Return the network of the declarations; other agents' predicates begin as they were told."""
        network = Network()
        for part in self._parts.values():
            part(network)
        for name in self.used:
            if name in self._kinds:
                continue
            if ACTION_END.fullmatch(name):
                network.add_event(name)
            elif hint := near_end(name):
                raise ConfigError(f"{name!r} is used, but not declared{hint}", key=name)
            elif "/" in name:
                network.add_input(name, told.get(name))
        return network
