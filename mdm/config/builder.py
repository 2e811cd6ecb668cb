"""Construction of actors from the tables of a TOML file; all problems are collected."""

from __future__ import annotations

import inspect
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import msgspec

from mdm.actors import Binding, Ensemble, ObservationFactor, PredicateManager, SafetyOptions, StateFactor
from mdm.actors.drive import drive_of
from mdm.actors.ensemble import MOST_LEVELS
from mdm.actors.predicate_manager import ACTION_END
from mdm.config.functions import find_function, nothing
from mdm.config.problems import Problems
from mdm.config.system import System
from mdm.config.tables import (
    ActionTable,
    EnsembleTable,
    EventTable,
    ObservationTable,
    PredicateTable,
    RestartTable,
    SearchTable,
    StateTable,
)
from mdm.errors import ConfigError
from mdm.formats import load_model, load_policy, load_rewards
from mdm.logic import Formula, parse, similar
from mdm.policies import DeterministicPolicy
from mdm.runtime import Restart, Supervision
from mdm.runtime.emergency import check_emergency
from mdm.solvers.online import TreeSearch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mdm.actors import Drive
    from mdm.models import MDP, POMDP
    from mdm.policies import Policy

__all__ = ["load_system"]

_KEYS = {
    "sensor": ("sensor", "max_age", "initial"),
    "formula": ("formula", "held_for"),
    "latch": ("set", "reset", "initial"),
}
_OPTIONS = [
    option
    for option in SafetyOptions.__annotations__
    if option in EnsembleTable.__struct_fields__ and option not in {"drive", "rewards", "seed"}
]
"""Options of a control layer that pass from an ensemble's table unchanged."""
T = TypeVar("T")


def load_system(path: str | Path, *, callbacks: bool = True) -> System:
    """Build the system that a TOML file describes.

    Example::

        system = mdm.load_system("patrol.toml")
        mdm.run(system)

    Args:
        path: The file. Paths in it are relative to its folder, which is also searched first for modules.
        callbacks: Import and bind the functions; otherwise actions do nothing and tasks are left out.

    Raises:
        ConfigError: With all problems, one per line and each in its ``problems``.
    """
    return _Builder(Path(path), callbacks=callbacks).system()


class _Builder:
    """Builds a system and collects problems."""

    def __init__(self, path: Path, *, callbacks: bool) -> None:
        self._path = path
        self._callbacks = callbacks
        self._problems = Problems(path)
        self._predicates = PredicateManager()
        self._tables: dict[str, EnsembleTable | None] = {}
        self._ensembles: dict[str, Ensemble | None] = {}
        self._invalid: set[str] = set()
        self._parents: dict[str, str] = {}
        self._formulas: list[tuple[str, Formula]] = []

    # -- Building ------------------------------------------------------------------------------------------------

    def system(self) -> System:
        """Return the system, or raise all problems."""
        document = self._read()
        known = ("predicates", "events", "ensembles", "tasks", "emergency")
        for key in document:
            if key not in known:
                self._problems.add(f"there is no key {key!r} here; the keys are {', '.join(known)}", key)
        self._declare(document)
        self._take_tables(document)
        for name in self._tables:
            self._ensemble(name, ())
        tasks = self._tasks(document.get("tasks", []))
        emergency = self._emergency(document.get("emergency"))
        self._check()
        self._problems.raise_all()
        return System(self._predicates, self._built(), tasks, emergency=emergency)

    def _built(self) -> dict[str, Ensemble]:
        """Return the ensembles that could be built, in file order."""
        built = {name: self._ensembles.get(name) for name in self._tables}
        return {name: ensemble for name, ensemble in built.items() if ensemble is not None}

    def _read(self) -> dict[str, Any]:
        try:
            return tomllib.loads(self._path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            self._problems.add("there is no such file", None)
        except IsADirectoryError:
            self._problems.add("this is a folder, not a file", None)
        except OSError as error:
            self._problems.add(f"the file cannot be read: {error.strerror}", None)
        except UnicodeDecodeError:
            self._problems.add("this is not UTF-8 text, which TOML requires", None)
        except tomllib.TOMLDecodeError as error:
            self._problems.add(f"this is not valid TOML: {error}", None)
        self._problems.raise_all()
        raise AssertionError

    def _tables_of(self, document: dict[str, Any], key: str) -> list[tuple[str, Any]]:
        tables = document.get(key, {})
        if not isinstance(tables, dict):
            self._problems.add(f"{key} must be a table with a key per name", key)
            return []
        return list(tables.items())

    def _declare(self, document: dict[str, Any]) -> None:
        """Declare predicates and events, even invalid ones, so that their uses are not reported as well."""
        for name, value in self._tables_of(document, "predicates"):
            with self._problems.collecting(f"predicates.{name}"):
                self._predicate(name, value)
            if self._predicates.knows(name) is None:
                self._predicates.sensor(name)
        for name, value in self._tables_of(document, "events"):
            with self._problems.collecting(f"events.{name}"):
                self._event(name, value)
            if self._predicates.knows(name) is None:
                self._predicates.event(name)

    def _take_tables(self, document: dict[str, Any]) -> None:
        for name, value in self._tables_of(document, "ensembles"):
            key, before = f"ensembles.{name}", len(self._problems)
            if name in {"", self._predicates.name}:
                self._problems.add(f"an ensemble cannot be called {name!r}: give it another name", key)
            self._tables[name] = self._problems.convert(value, EnsembleTable, key, partly=True)
            if len(self._problems) > before:
                self._invalid.add(name)
        if not document.get("ensembles"):
            self._problems.add("there is no ensemble: a table such as [ensembles.robot] is missing", "ensembles")

    def _predicate(self, name: str, value: Any) -> None:
        key = f"predicates.{name}"
        written = {"formula": value} if isinstance(value, str) else value
        table: PredicateTable | None = self._problems.convert(written, PredicateTable, key)
        if table is None:
            return
        _refuse_mixture(table, written)
        if table.formula is not None:
            self._predicates.define(name, self._formula(table.formula, key), held_for=table.held_for)
        elif table.set is not None and table.reset is not None:
            on, off = self._formula(table.set, key), self._formula(table.reset, key)
            self._predicates.latch(name, set=on, reset=off, initial=bool(table.initial))
        else:
            self._predicates.sensor(name, max_age=table.max_age, initial=table.initial)

    def _event(self, name: str, value: Any) -> None:
        key = f"events.{name}"
        written = {"formula": value} if isinstance(value, str) else value
        table: EventTable | None = self._problems.convert(written, EventTable, key)
        if table is not None:
            self._predicates.event(name, None if table.formula is None else self._formula(table.formula, key))

    def _formula(self, text: str, key: str) -> Formula:
        formula = parse(text)
        self._formulas.append((key, formula))
        return formula

    def _ensemble(self, name: str, above: tuple[str, ...]) -> Ensemble | None:
        """Build an ensemble after its children; None if it has problems, which are reported once."""
        table, key = self._tables[name], f"ensembles.{name}"
        if name in self._ensembles or table is None:
            return self._ensembles.get(name)
        self._ensembles[name] = None
        with self._problems.collecting(key):
            actions = self._actions(name, table, (*above, name))
            indices = table.model is None
            states = self._factors(StateFactor, StateTable, table.states, f"{key}.states", indices=indices)
            observations = self._factors(
                *(ObservationFactor, ObservationTable, table.observations, f"{key}.observations"), indices=indices
            )
            drive = self._drive(table.drive, f"{key}.drive")
            supervision = self._supervision(table.supervision, f"{key}.supervision")
            if name in self._invalid:
                return None
            model = self._model(table, key)
            if table.model is not None and model is None:
                return None
            policy = self._policy(table, model, key)
            if table.search is not None and policy is not None:
                policy = self._search(table, model, policy, f"{key}.search")
            rewards = None
            if table.rewards is not None:
                with self._problems.collecting(f"{key}.rewards"):
                    rewards = load_rewards(self._resolve(table.rewards))
            safe: Any = table.safe_action
            if safe is not None and ":" in safe:
                safe = self._function(safe, f"{key}.safe_action")
            if policy is None or actions is None or states is None or observations is None:
                return None
            if drive is None or supervision is None:
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
                local=table.local,
                safe_action=safe,
                supervision=supervision,
                drive=drive,
                rewards=rewards,
                **{option: getattr(table, option) for option in _OPTIONS},
            )
            return ensemble
        return None

    def _resolve(self, path: str) -> Path:
        if not path or "\0" in path:
            raise ConfigError(f"the path of a file was expected, not {path!r}")
        return self._path.parent / path

    def _drive(self, given: str | float, key: str) -> Drive | None:
        with self._problems.collecting(key):
            return drive_of(given)
        return None

    def _model(self, table: EnsembleTable, key: str) -> MDP | POMDP | None:
        if table.model is None:
            return None
        with self._problems.collecting(f"{key}.model"):
            model = load_model(self._resolve(table.model))
            return model if table.discount is None else model.with_discount(table.discount)
        return None

    def _policy(self, table: EnsembleTable, model: MDP | POMDP | None, key: str) -> Policy | None:
        with self._problems.collecting(f"{key}.policy"):
            if isinstance(table.policy, list):
                count = len(table.actions) if model is None else len(model.action_space)
                return DeterministicPolicy(table.policy, count)
            path = self._resolve(table.policy)
            return load_policy(path, model, kind=table.policy_kind, seed=table.seed)
        return None

    def _search(self, table: EnsembleTable, model: MDP | POMDP | None, policy: Any, key: str) -> TreeSearch | None:
        given: SearchTable | None = self._problems.convert(table.search, SearchTable, key)
        if given is None:
            return None
        with self._problems.collecting(key):
            if model is None:
                raise ConfigError("a search needs a model")
            if table.false_negative is not None:
                model = model.with_false_negatives(table.false_negative)
            return TreeSearch(
                model,
                seconds=given.seconds,
                expansions=given.expansions,
                seed=table.seed,
                fallback=policy,
                plans=policy if given.plans else None,
                particles=given.particles,
            )
        return None

    def _factors(
        self, factor: Callable[..., T], kind: Any, tables: dict[str, Any], key: str, *, indices: bool
    ) -> list[T] | None:
        """Build factors; where no model may call its symbols by digits, symbols in digits are ``indices``."""
        factors: list[T] = []
        names = kind.__struct_fields__[0]
        for name, value in tables.items():
            with self._problems.collecting(f"{key}.{name}"):
                if isinstance(value, dict) and (names in value or not _is_mapping(value)):
                    table = self._problems.convert(value, kind, f"{key}.{name}")
                    fields = {} if table is None else msgspec.structs.asdict(table)
                elif isinstance(value, list | dict):
                    fields = {names: self._problems.convert(value, list[str] | dict[str, str], f"{key}.{name}")}
                else:
                    raise ConfigError(
                        f"a list of {names}, or a table of {names} by symbol, was expected, not {value!r}"
                    )
                given = fields.get(names)
                if indices and isinstance(given, dict) and all(symbol.isdecimal() for symbol in given):
                    fields[names] = {int(symbol): source for symbol, source in given.items()}
                    idle = fields.get("idle")
                    fields |= {"idle": int(idle)} if idle is not None and idle.isdecimal() else {}
                if given is not None:
                    factors.append(factor(name, fields.pop(names), **fields))
        return factors if len(factors) == len(tables) else None

    def _supervision(self, given: object, key: str) -> Supervision | None:
        if not isinstance(given, dict):
            return cast("Supervision | None", self._problems.convert(given, Literal["stop", "escalate"], key))
        table: RestartTable | None = self._problems.convert(given, RestartTable, key)
        return None if table is None else Restart(limit=table.restart, within=table.within, backoff=table.backoff)

    # -- Actions -------------------------------------------------------------------------------------------------

    def _actions(self, name: str, table: EnsembleTable, above: tuple[str, ...]) -> dict[Any, Binding] | None:
        bindings: dict[Any, Binding] = {}
        for action, given in table.actions.items():
            key = f"ensembles.{name}.actions.{action}"
            written = {"call": given} if isinstance(given, str) else given
            entry: ActionTable | None = self._problems.convert(written, ActionTable, key)
            if entry is None:
                continue
            with self._problems.collecting(key):
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
            raise ConfigError("an action needs either a function ('call') or an 'ensemble'")
        if entry.call is not None:
            return self._function(entry.call, key)
        below = str(entry.ensemble)
        if below not in self._tables:
            raise ConfigError(f"there is no ensemble {below!r} in this file{similar(below, self._tables)}")
        if len(above) >= MOST_LEVELS:
            raise ConfigError(f"ensembles are nested more than {MOST_LEVELS} deep")
        if below in above:
            cycle = " -> ".join((*above[above.index(below) :], below))
            raise ConfigError(f"ensembles start each other in a cycle: {cycle}")
        parent = self._parents.setdefault(below, name)
        if parent != name:
            raise ConfigError(
                f"ensemble {below!r} is started by both {parent!r} and {name!r}; it can have only one parent"
            )
        return self._ensemble(below, above)

    def _function(self, reference: str, key: str) -> Callable[..., Any] | None:
        with self._problems.collecting(key):
            return find_function(reference, self._path.parent) if self._callbacks else nothing
        return None

    def _tasks(self, references: object) -> list[Callable[[System], Any]]:
        if not isinstance(references, list) or not all(isinstance(reference, str) for reference in references):
            self._problems.add("tasks must be a list of functions, such as ['sensors:read']", "tasks")
            return []
        functions = [self._function(reference, "tasks") for reference in references]
        for reference, function in zip(references, functions, strict=True):
            if function is None or not self._callbacks:
                continue
            if not inspect.iscoroutinefunction(function):
                self._problems.add(f"task {reference!r} is not an async function", "tasks")
            elif not _takes_one(function):
                self._problems.add(f"task {reference!r} must take one argument, the System", "tasks")
        return [function for function in functions if function is not None] if self._callbacks else []

    def _emergency(self, reference: object) -> Callable[..., Any] | None:
        if reference is None:
            return None
        if not isinstance(reference, str):
            self._problems.add("emergency must be a function, such as 'robot:cut_motors'", "emergency")
            return None
        function = self._function(reference, "emergency")
        if function is None or not self._callbacks:
            return None
        with self._problems.collecting("emergency"):
            check_emergency(function)
        return function

    # -- Checks --------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        if not self._undeclared():
            with self._problems.collecting("predicates"):
                self._predicates.network().compile()
        ensembles = self._built()
        for name, ensemble in ensembles.items():
            if self._parents.get(name) not in ensembles:  # otherwise the parent's problems include them
                for problem in ensemble.problems():
                    self._problems.add(problem.message, problem.key)
        if len(ensembles) == len(self._tables):
            actions = {name for ensemble in ensembles.values() for name in ensemble.action.names}
            for event in self._predicates.used:
                action = event.rpartition(".")[0]
                if ACTION_END.fullmatch(event) and "/" not in event and action not in actions:
                    hint = similar(action, actions)
                    self._problems.add(f"{event!r} is the end of an unknown action{hint}", "predicates")

    def _undeclared(self) -> bool:
        """Report undeclared names in formulas; return whether there are any."""
        before = len(self._problems)
        for key, formula in self._formulas:
            for name in sorted(formula.names):
                if self._predicates.knows(name) is None:
                    hint = similar(name, self._predicates.names)
                    user = key.partition(".")[2]
                    self._problems.add(f"{user!r} uses {name!r}, which is not declared{hint}", key)
        return len(self._problems) > before


def _is_mapping(table: dict[str, Any]) -> bool:
    """Whether a factor's table is a mapping from symbols to names, without options."""
    return bool(table) and all(isinstance(value, str) for value in table.values())


def _takes_one(function: Callable[..., Any]) -> bool:
    try:
        inspect.signature(function).bind(None)
    except TypeError:
        return False
    return True


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
