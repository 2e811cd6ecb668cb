"""From the tables of a file to the actors that they describe, with all problems collected on the way."""

from __future__ import annotations

import inspect
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec

from mdm.actors import Binding, Ensemble, FixedRate, ObservationFactor, OnEvent, PredicateManager, StateFactor
from mdm.actors.predicate_manager import ACTION_END
from mdm.config.functions import find_function, nothing
from mdm.config.system import System
from mdm.config.tables import (
    ActionTable,
    EnsembleTable,
    EventTable,
    ObservationTable,
    PredicateTable,
    RestartTable,
    StateTable,
)
from mdm.errors import ConfigError, Error, FormatError
from mdm.formats import load_model, load_policy, load_rewards
from mdm.logic import similar
from mdm.policies import DeterministicPolicy, Policy
from mdm.runtime import Restart, Supervision

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from mdm.models import MDP, POMDP

__all__ = ["load_system"]

T = TypeVar("T")


def load_system(path: str | Path, *, callbacks: bool = True) -> System:
    """Build what a TOML file describes.

    Args:
        path: The file; paths in it are relative to its folder, and modules are looked for there first.
        callbacks: Import and bind the functions; without, actions do nothing and tasks are left out.

    Raises:
        ConfigError: With everything that is wrong, one line each, and each one in its ``problems``.
    """
    return _Builder(Path(path), callbacks=callbacks).system()


class _Collecting:
    """Turns an error inside its block into a problem of a key, and goes on."""

    def __init__(self, problem: Callable[[str, str], None], key: str) -> None:
        self._problem = problem
        self._key = key

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        if isinstance(error, ConfigError):
            inner = error.key or ""
            self._problem(error.message, inner if inner.startswith("ensembles.") else self._key)
        elif isinstance(error, FormatError):
            place = f" (column {error.column})" if error.file is None and error.column is not None else ""
            self._problem(f"{error if error.file else error.message}{place}", self._key)
        elif isinstance(error, Error):
            self._problem(str(error), self._key)
        return isinstance(error, Error)


class _Builder:
    """Builds a system, and collects problems on the way."""

    def __init__(self, path: Path, *, callbacks: bool) -> None:
        self._path = path
        self._callbacks = callbacks
        self._problems: list[ConfigError] = []
        self._predicates = PredicateManager()
        self._tables: dict[str, EnsembleTable] = {}
        self._ensembles: dict[str, Ensemble] = {}
        self._parents: dict[str, str] = {}

    # -- Problems ------------------------------------------------------------------------------------------------

    def _problem(self, message: str, key: str | None) -> None:
        self._problems.append(ConfigError(message, file=self._path, key=key))

    def _collecting(self, key: str) -> _Collecting:
        return _Collecting(self._problem, key)

    def _raise(self) -> None:
        if self._problems:
            error = ConfigError("\n".join(str(problem) for problem in self._problems))
            error.problems = tuple(self._problems)
            raise error

    def _convert(self, value: object, kind: Any, key: str) -> Any:
        """Return a table as a struct; msgspec's message is cut to what and where."""
        try:
            return msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            text, _, place = str(error).partition(" - at `$")
            place = place.rstrip("`").replace("[...]", "")
            unknown = text.split("`")[1] if "unknown field" in text else None
            if unknown is not None:
                fields = getattr(kind, "__struct_fields__", ())
                text = f"there is no key {unknown!r} here{similar(unknown, fields)}"
                text += "" if "did you mean" in text else f"; the keys are {', '.join(fields)}"
                self._problem(text, f"{key}{place}.{unknown}")
            else:
                self._problem(text.replace("Object missing required field", "there is no key"), f"{key}{place}")
            return None

    # -- Building ------------------------------------------------------------------------------------------------

    def system(self) -> System:
        """Return the system, or raise everything that is wrong."""
        document = self._read()
        known = ("predicates", "events", "ensembles", "tasks")
        for key in document.keys() - set(known):
            self._problem(f"there is no key {key!r} here; the keys are {', '.join(known)}", key)
        for name, value in self._tables_of(document, "predicates"):
            with self._collecting(f"predicates.{name}"):
                self._predicate(name, value)
            if self._predicates.knows(name) is None:
                self._predicates.sensor(name)  # stands in for what was wrong, so that its uses are not wrong as well
        for name, value in self._tables_of(document, "events"):
            with self._collecting(f"events.{name}"):
                self._event(name, value)
        for name, value in self._tables_of(document, "ensembles"):
            if isinstance(value, dict):
                table = self._convert(value, EnsembleTable, f"ensembles.{name}")
                if table is not None:
                    self._tables[name] = table
            else:
                self._problem("an ensemble is a table", f"ensembles.{name}")
        if not document.get("ensembles"):
            self._problem("there is no ensemble: a table such as [ensembles.robot] is missing", "ensembles")
        for name in self._tables:
            self._ensemble(name, ())
        tasks = self._tasks(document.get("tasks", []))
        self._check()
        self._raise()
        return System(self._predicates, {name: self._ensembles[name] for name in self._tables}, tasks)

    def _read(self) -> dict[str, Any]:
        try:
            return tomllib.loads(self._path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            self._problem("there is no such file", None)
        except IsADirectoryError:
            self._problem("this is a folder, not a file", None)
        except OSError as error:
            self._problem(f"the file cannot be read: {error.strerror}", None)
        except UnicodeDecodeError:
            self._problem("this is no text in UTF-8, as TOML files are", None)
        except tomllib.TOMLDecodeError as error:
            self._problem(f"this is no TOML: {error}", None)
        self._raise()
        raise AssertionError

    def _tables_of(self, document: dict[str, Any], key: str) -> list[tuple[str, Any]]:
        tables = document.get(key, {})
        if not isinstance(tables, dict):
            self._problem(f"{key} is a table, with a key for each name", key)
            return []
        return list(tables.items())

    def _predicate(self, name: str, value: object) -> None:
        if isinstance(value, str):
            self._predicates.define(name, value)
            return
        table: PredicateTable | None = self._convert(value, PredicateTable, f"predicates.{name}")
        if table is None:
            return
        latch = table.set is not None or table.reset is not None
        if latch and table.formula is not None:
            raise ConfigError("a predicate has a formula, or 'set' and 'reset', not both")
        if (latch or table.formula is not None) and table.max_age is not None:
            raise ConfigError("max_age is for sensors: a derived predicate is as old as what it is derived from")
        if latch:
            if table.set is None or table.reset is None:
                raise ConfigError("a latch needs both 'set' and 'reset'")
            self._predicates.latch(name, set=table.set, reset=table.reset, initial=bool(table.initial))
        elif table.formula is not None:
            self._predicates.define(name, table.formula, held_for=table.held_for)
        elif table.held_for is not None:
            raise ConfigError("held_for asks how long a formula has been true: give the formula")
        else:
            self._predicates.sensor(name, max_age=table.max_age, initial=table.initial)

    def _event(self, name: str, value: object) -> None:
        if isinstance(value, str):
            self._predicates.event(name, value)
            return
        table: EventTable | None = self._convert(value, EventTable, f"events.{name}")
        if table is not None:
            self._predicates.event(name, table.formula)

    def _ensemble(self, name: str, above: tuple[str, ...]) -> Ensemble | None:
        """Build an ensemble after those below it."""
        if name in self._ensembles:
            return self._ensembles[name]
        table, key = self._tables[name], f"ensembles.{name}"
        with self._collecting(key):
            actions = self._actions(name, table, (*above, name))
            model = self._model(table, key)
            if table.model is not None and model is None:
                return None
            policy = self._policy(table, model, key)
            states = self._factors(StateFactor, StateTable, table.states, f"{key}.states")
            observations = self._factors(ObservationFactor, ObservationTable, table.observations, f"{key}.observations")
            rewards = None if table.rewards is None else load_rewards(self._beside(table.rewards))
            safe: Any = table.safe_action
            if safe is not None and ":" in safe:
                safe = self._function(safe, f"{key}.safe_action")
            if policy is None or actions is None or states is None or observations is None:
                return None
            self._ensembles[name] = ensemble = Ensemble(
                name,
                policy=policy,
                actions=actions,
                model=model,
                predicates=self._predicates,
                states=states,
                observations=observations,
                agent=table.agent,
                safe_action=safe,
                supervision=self._supervision(table.supervision),
                drive=OnEvent() if table.drive == "event" else FixedRate(float(table.drive)),
                horizon=table.horizon,
                on_impossible=table.on_impossible,
                on_no_observation=table.on_no_observation,
                rewards=rewards,
                deadline=table.deadline,
                initial_belief=table.initial_belief,
            )
            return ensemble
        return None

    def _beside(self, path: str) -> Path:
        return self._path.parent / path

    def _model(self, table: EnsembleTable, key: str) -> MDP | POMDP | None:
        if table.model is None:
            return None
        with self._collecting(f"{key}.model"):
            model = load_model(self._beside(table.model))
            return model if table.discount is None else model.with_discount(table.discount)
        return None

    def _policy(self, table: EnsembleTable, model: MDP | POMDP | None, key: str) -> Policy | None:
        with self._collecting(f"{key}.policy"):
            if isinstance(table.policy, list):
                count = len(table.actions) if model is None else len(model.action_space)
                return DeterministicPolicy(table.policy, count)
            return load_policy(self._beside(table.policy), model, kind=table.policy_kind, seed=table.seed)
        return None

    def _factors(self, factor: Callable[..., T], kind: Any, tables: dict[str, Any], key: str) -> list[T] | None:
        factors: list[T] = []
        for name, value in tables.items():
            with self._collecting(f"{key}.{name}"):
                if isinstance(value, list):
                    factors.append(factor(name, value))
                else:
                    fields = msgspec.structs.asdict(value)
                    factors.append(factor(name, fields.pop(kind.__struct_fields__[0]), **fields))
        return factors if len(factors) == len(tables) else None

    def _supervision(self, given: Literal["stop", "escalate"] | RestartTable) -> Supervision:
        if isinstance(given, RestartTable):
            return Restart(limit=given.restart, within=given.within, backoff=given.backoff)
        return given

    # -- Actions -------------------------------------------------------------------------------------------------

    def _actions(self, name: str, table: EnsembleTable, above: tuple[str, ...]) -> dict[Any, Binding] | None:
        bindings: dict[Any, Binding] = {}
        for action, given in table.actions.items():
            key = f"ensembles.{name}.actions.{action}"
            entry = ActionTable(call=given) if isinstance(given, str) else given
            with self._collecting(key):
                target = self._target(entry, key, name, above)
                if target is not None:
                    bindings[int(action) if action.isdecimal() else action] = Binding(
                        target,
                        timeout=entry.timeout,
                        grace=entry.grace,
                        on_repeat=entry.on_repeat,
                        resume=entry.resume,
                        concurrent=entry.concurrent,
                    )
        return bindings if len(bindings) == len(table.actions) else None

    def _target(self, entry: ActionTable, key: str, name: str, above: tuple[str, ...]) -> Any:
        if (entry.call is None) == (entry.ensemble is None):
            raise ConfigError("an action is bound to a function ('call') or to an 'ensemble': give one of them")
        if entry.call is not None:
            return self._function(entry.call, key)
        below = str(entry.ensemble)
        if below not in self._tables:
            raise ConfigError(f"there is no ensemble {below!r} in this file{similar(below, self._tables)}")
        if below in above:
            circle = " -> ".join((*above[above.index(below) :], below))
            raise ConfigError(f"ensembles start each other in a circle: {circle}")
        parent = self._parents.setdefault(below, name)
        if parent != name:
            raise ConfigError(
                f"ensemble {below!r} is started by both {parent!r} and {name!r}; it can be below one only"
            )
        return self._ensemble(below, above)

    def _function(self, reference: str, key: str) -> Callable[..., Any] | None:
        with self._collecting(key):
            return find_function(reference, self._path.parent) if self._callbacks else nothing
        return None

    def _tasks(self, references: object) -> list[Callable[[System], Any]]:
        if not isinstance(references, list) or not all(isinstance(reference, str) for reference in references):
            self._problem("tasks is a list of functions, such as ['sensors:read']", "tasks")
            return []
        functions = [self._function(reference, "tasks") for reference in references]
        for reference, function in zip(references, functions, strict=True):
            if function is not None and self._callbacks and not inspect.iscoroutinefunction(function):
                self._problem(f"task {reference!r} is not an async function", "tasks")
        return [function for function in functions if function is not None] if self._callbacks else []

    # -- Checks --------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        with self._collecting("predicates"):
            self._predicates.network().compile()
        for name, ensemble in self._ensembles.items():
            if name not in self._parents:
                for problem in ensemble.problems():
                    self._problem(problem.message, problem.key)
        if len(self._ensembles) == len(self._tables):
            actions = {name for ensemble in self._ensembles.values() for name in ensemble.action.names}
            for event in self._predicates.used:
                action = event.rpartition(".")[0]
                if ACTION_END.fullmatch(event) and "/" not in event and action not in actions:
                    hint = similar(action, actions)
                    self._problem(f"{event!r} is the end of an action that no ensemble has{hint}", "predicates")
