"""Typed tables of the TOML file: options, see `mdm.options`, and the keys that a file alone has; and their problems."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from mdm.actors.options import BindingSettings, SafetySettings
from mdm.errors import ConfigError, Error, FormatError
from mdm.logic import similar
from mdm.options import Options, Seconds, misfit
from mdm.runtime.actor import TakenName

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

T = TypeVar("T")


class PredicateTable(Options, frozen=True):
    """A predicate set by code, also by numbers, or one derived by ``formula``, ``monitor``, or ``set`` and ``reset``.

    Attributes:
        sensor: False for a predicate that no code sets: it has a formula, or is a latch or a monitor.
        when: When it holds, of numbers that code sets: ``< 0.2 until > 0.3``; without ``until`` one comparison.
        formula: Of other predicates and events, in propositional logic; short form: the formula alone.
        held_for: Seconds that the formula has to hold before the predicate is true.
        monitor: A formula in time, such as ``G(not Stairs) and F(Dock)``: false once that is false for ever, else true.
        max_age: Seconds after which a value that was not told again is unknown.
        set: A predicate or event that makes it true, and it stays so.
        reset: A predicate or event that makes it false again.
        initial: Its value until it is told; by default it is unknown.
    """

    sensor: bool = True
    when: str | None = None
    formula: str | None = None
    held_for: Seconds | None = None
    monitor: str | None = None
    max_age: Seconds | None = None
    set: str | None = None
    reset: str | None = None
    initial: bool | None = None


class EventTable(Options, frozen=True):
    """An event raised by code, or one that occurs when ``formula`` becomes true.

    Attributes:
        formula: Of predicates; short form: the formula alone.
    """

    formula: str | None = None


class StateTable(Options, frozen=True):
    """A state factor; short form: its predicates as a list or mapping."""

    predicates: list[str] | dict[str, str]
    on_violation: Literal["first", "hold", "error"] | None = None
    owner: str | None = None


class ObservationTable(Options, frozen=True):
    """An observation factor; short form: its events as a list or mapping."""

    events: list[str] | dict[str, str]
    idle: str | None = None
    hold: bool = False
    owner: str | None = None


class ActionTable(BindingSettings, frozen=True):
    """The binding of an action to a function (``call``), another ensemble, or a ``way`` or ``place`` of the map.

    Attributes:
        call: The function, ``module:name``, or ``module:object.name`` for a method; short form: the function alone.
        ensemble: Another ensemble of the file, which the action starts and its end stops.
        way: The label of a way, gone from the place where the robot is.
        place: The place to go to.
        navigate: Whether the function drives to places as well: it takes an argument ``navigate``.
        group: Of functions of the same group the next begins before the running one is cancelled.
    """

    call: str | None = None
    ensemble: str | None = None
    way: str | None = None
    place: str | None = None
    navigate: bool | None = None
    group: str | None = None


class RestartTable(Options, frozen=True):
    """Supervision by restart.

    Attributes:
        restart: How often, at most, within the time.
    """

    restart: Annotated[int, Meta(ge=0)]
    within: Seconds | None = None
    backoff: Annotated[float, Meta(ge=0, le=1e9, extra={"unit": "seconds"})] | None = None


class SearchTable(Options, frozen=True):
    """A tree search with the ensemble's policy as fallback and, with ``plans``, its vectors as lower bounds."""

    seconds: Seconds | None = None
    expansions: Annotated[int, Meta(gt=0)] | None = None
    particles: Annotated[int, Meta(gt=0)] | None = None
    plans: bool = False


class ShieldTable(Options, frozen=True):
    """A shield around the ensemble's policy, see `mdm.shield`.

    Attributes:
        avoid: A formula over states and actions, out of which it keeps.
        keep: Kept as probable as that allows, such as ``reach goal``.
        probability: The budget of a whole run for reaching the first; by default 0, which allows nothing.
        resolve: Whether the model is solved again with the allowed actions.
        margin: Transitions that the model lacks and the world may have: state, action and next state, by name.
    """

    avoid: str
    keep: str | None = None
    probability: Annotated[float, Meta(ge=0, lt=1)] | None = None
    resolve: bool | None = None
    margin: list[list[str]] | None = None


class EnsembleTable(SafetySettings, frozen=True, kw_only=True):
    """An ensemble; nested tables are converted separately, so that their problems are reported with their keys.

    Attributes:
        policy: A file, a list with the index of an action for each state, or ``module:name`` for one of your own.
        actions: The binding of each action, by name or by index.
        model: A file; needed by policies over beliefs; gives names and rewards.
        discount: Replaces the model's, above 0 and at most 1.
        durations: A file that says how long actions take in the model that the policy is for, of `save_durations`.
        policy_kind: The kind of a matrix in the policy's file; by default told by content and model.
        rewards: A file with R(s, a), where there is no model.
        initial_belief: A probability for each state, or the name of the state that is certain.
        tracker: ``module:name``, which makes an information state of your own.
        agents: In a team's file, the agents that have this ensemble; by default all.
        placement: In a team's file, where its layers are.
        search: A tree search that decides, with the policy as its fallback.
        shield: A shield around the policy or search.
        drift: The odds at which a row of the model that decisions contradict is a fault `drift`, such as 1000: of so
            many robots whose model is right, one ever reports anything. By default nothing is watched.
        states: The factors of the state.
        observations: The factors of the observation.
    """

    policy: str | list[int]
    actions: dict[str, Any]
    model: str | None = None
    discount: float | None = None
    durations: str | None = None
    policy_kind: Literal["table", "stochastic", "q"] | None = None
    rewards: str | None = None
    initial_belief: list[float] | str | None = None
    tracker: str | None = None
    drive: str | float | None = None
    false_negative: str | int | None = None
    agent: int | str | None = None
    agents: list[str] | None = None
    placement: Any = None
    local: bool = False
    safe_action: str | dict[str, Any] | None = None
    supervision: Any = "escalate"
    search: Any = None
    shield: Any = None
    drift: Annotated[float, Meta(gt=1)] | None = None
    states: dict[str, Any] = msgspec.field(default_factory=dict)
    observations: dict[str, Any] = msgspec.field(default_factory=dict)


class Problems:
    """The problems of a file.

    Args:
        path: The file, named in every problem; None where there is none.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._found: list[ConfigError] = []

    def __len__(self) -> int:
        return len(self._found)

    def add(self, message: str, key: str | None) -> None:
        """Add a problem with its key."""
        self._found.append(ConfigError(message, file=self._path, key=key))

    def raise_all(self) -> None:
        """Raise one error with all problems, if there are any."""
        if self._found:
            error = ConfigError("\n".join(str(problem) for problem in self._found))
            error.problems = tuple(self._found)
            raise error

    @contextmanager
    def collecting(self, key: str, *, first: bool = False) -> Iterator[None]:
        """Note an error of ours that is raised within, as a problem of a key, and go on behind.

        Args:
            key: The key, where the error has none of its own.
            first: Whether only the first problem of a key is noted: the error would follow from it.
        """
        try:
            yield
        except ConfigError as error:
            inner = error.key or ""
            key = inner if inner.startswith(("ensembles.", "team.")) else key
            if not (first and any(problem.key == key for problem in self._found)):
                self.add(error.message, key)
        except FormatError as error:
            place = f" (column {error.column})" if error.file is None and error.column is not None else ""
            self.add(f"{error if error.file else error.message}{place}", key)
        except TakenName as error:
            text = f"an ensemble cannot be called {error.name!r}, as an actor beside it is: give it another name"
            self.add(text, f"ensembles.{error.name}")
        except Error as error:
            self.add(str(error), key)

    def attempt(self, key: str, make: Callable[..., T], /, *arguments: Any, **options: Any) -> T | None:
        """Return the result of a function; None where it raises an error of ours, which is noted with its key."""
        made: list[T] = []
        with self.collecting(key):
            made.append(make(*arguments, **options))
        return made[0] if made else None

    def tables(self, document: dict[str, Any], key: str) -> list[tuple[str, Any]]:
        """Return the tables below a key by their names; a problem where there is something else."""
        tables = document.get(key, {})
        if not isinstance(tables, dict):
            self.add(f"{key} must be a table with a key per name", key)
            return []
        return list(tables.items())

    def convert(self, value: Any, kind: Any, key: str, *, partly: bool = False) -> Any:
        """Return a table as a struct; if it has problems None, or with ``partly`` a struct of its valid keys."""
        before = len(self)
        dropped: set[str] = set()
        while True:
            try:
                struct = msgspec.convert(value, kind)
            except msgspec.ValidationError as error:
                field = self._add_invalid(error, value, kind, key, dropped)
                if field is None or not isinstance(value, dict) or field not in value:
                    return None
                dropped.add(field)
                value = {name: inner for name, inner in value.items() if name != field}
            else:
                return struct if partly or len(self) == before else None

    def _add_invalid(
        self, error: msgspec.ValidationError, value: Any, kind: Any, key: str, dropped: set[str]
    ) -> str | None:
        """Add msgspec's error in our words; return the field concerned."""
        text = str(error)
        if "unknown field" in text:
            field, fields = text.split("`")[1], kind.__struct_fields__
            hint = similar(field, fields) or f"; the keys are {', '.join(fields)}"
            self.add(f"there is no key {field!r} here{hint}", f"{key}.{field}")
            return field
        if "missing required field" in text:
            field = text.split("`")[1]
            if field not in dropped:
                self.add(f"the required key {field!r} is missing", key)
            return None
        words, place = misfit(error, value, kind)
        self.add(words, f"{key}{place}")
        return place.removeprefix(".").partition("[")[0] or None
