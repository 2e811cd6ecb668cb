"""Construction of ensembles from the tables of a TOML file."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar, cast

import msgspec

from mdm.actors import Binding, Ensemble, ObservationFactor, StateFactor
from mdm.actors.ensemble import MOST_LEVELS
from mdm.actors.options import BindingSettings, DriveSettings, SafetySettings, drive_of
from mdm.beliefs.choice import check_memory
from mdm.compilation import sparing
from mdm.config.functions import Lasting, Unseen, is_reference, nothing, unseen_policy
from mdm.config.tables import (
    ActionTable,
    EnsembleTable,
    ObservationTable,
    RestartTable,
    SearchTable,
    ShieldTable,
    StateTable,
)
from mdm.controller import seeded
from mdm.errors import ConfigError
from mdm.formats import load_model, load_policy, load_rewards
from mdm.loading import policy_of, spared
from mdm.logic import similar
from mdm.models.durations import discounts_in_time
from mdm.policies import DeterministicPolicy
from mdm.runtime import Restart, Supervision

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from mdm.actors.drift import DriftMonitor
    from mdm.config.readers import Readers
    from mdm.maps import Navigation
    from mdm.models import MDP, POMDP, Durations
    from mdm.policies import Policy
    from mdm.solvers.online import TreeSearch
    from mdm.team import Placement

T = TypeVar("T")

_ONE_SAFE_ACTION = (
    "a safe action is not given by agent: give the name of an action, which each agent's table of actions "
    'binds to a function of its own; or a function "module:name", which each agent calls in its own process'
)
_OF_SAFE_ACTION = ("call", "way", "place", "grace", "may_succeed")
"""The keys of an action that mean something where it is the safe action alone."""


class Seat(NamedTuple):
    """An agent's part in an ensemble.

    Attributes:
        agent: The model's agent whose component is carried out.
        placement: Where the layers are of an ensemble that the team decides together; None where it is the agent's own.
        acts: Whether the agent carries out a component.
        who: Its name in the team.
    """

    agent: int | str
    placement: Placement | None = None
    acts: bool = True
    who: str = ""


class Ensembles:
    """Builds the ensembles of a file, those below before those above.

    Args:
        readers: Those of the file's extensions.
        navigation: The navigation that drives the ways of the file's map.
        located: Whether it is known which places there are; else their names are not checked.
        models: Those that were loaded before, by their files; newly loaded ones are added.

    Attributes:
        joint: The placements of the team's ensembles, by their names: of those that agents decide together.
        monitors: The drift monitors that the file asks for.
        durations: How long actions take in the models of ensembles that say so, by their names.
    """

    def __init__(
        self,
        readers: Readers,
        navigation: Navigation | None = None,
        *,
        located: bool = True,
        models: dict[Path, MDP] | None = None,
    ) -> None:
        self._models = {} if models is None else models
        self._navigation = navigation
        self._located = located
        self._folder, self._predicates, self._functions, self._problems, self._share, _ = readers.reading
        self._readers = readers
        self._tables: dict[str, EnsembleTable | None] = {}
        self._ensembles: dict[str, Ensemble | None] = {}
        self._invalid: set[str] = set()
        self._parents: dict[str, str] = {}
        self._unowned = False
        self.joint: dict[str, Placement] = {}
        self.monitors: list[DriftMonitor] = []
        self.durations: dict[str, Durations] = {}
        self._wired: dict[str, tuple[list[StateFactor], list[ObservationFactor]]] = {}

    def build(self, document: dict[str, Any]) -> dict[str, Ensemble]:
        """Return the ensembles that could be built, in file order."""
        self._take_tables(document)
        if self._share is not None:
            for name in self._share.survey(dict(self._problems.tables(document, "ensembles"))):
                self._tables.pop(name, None)
        for name in self._tables:
            self._ensemble(name, ())
        built = {name: self._ensembles.get(name) for name in self._tables}
        return {name: ensemble for name, ensemble in built.items() if ensemble is not None}

    @property
    def complete(self) -> bool:
        """Whether all of them could be built, and every factor is an agent's."""
        return not self._unowned and all(self._ensembles.get(name) is not None for name in self._tables)

    def check(self, built: dict[str, Ensemble], *, led: bool = True) -> None:
        """Note problems that would keep ensembles from starting.

        Args:
            built: The ensembles that could be built.
            led: Whether those of a team are led by its member, which has their teammates' predicates known.
        """
        for name, ensemble in built.items():
            if not led and self._names_others(name):
                self._check_wiring(name)
            elif self._parents.get(name) not in built:  # otherwise the parent's problems include them
                for problem in ensemble.problems() if led else ensemble.misfits():
                    self._problems.add(problem.message, problem.key)
        for name in self._wired.keys() - built.keys():
            self._check_wiring(name)

    def _names_others(self, name: str) -> bool:
        """Whether factors of an ensemble use predicates or events of other agents, by their names."""
        states, observations = self._wired[name]
        used = [name for state in states for name in state.predicates]
        used += [event for seen in observations for event in seen.events if event is not None]
        return any("/" in name for name in used)

    def _check_wiring(self, name: str) -> None:
        """Note undeclared names in the factors of an ensemble that could not be built for other reasons."""
        states, observations = self._wired[name]
        for state in states:
            self._check_names("predicate", f"ensembles.{name}.states", state.name, state.predicates)
        for seen in observations:
            named = [event for place, event in enumerate(seen.events) if event is not None and place != seen.idle]
            self._check_names("event", f"ensembles.{name}.observations", seen.name, named)

    def _check_names(self, kind: str, key: str, factor: str, names: Sequence[str]) -> None:
        declared = self._predicates.declared
        known = [name for name, of in declared.names.items() if of == kind]
        what = "state factor" if kind == "predicate" else "observation factor"
        for name in names:
            if declared.knows(name) != kind and "/" not in name:  # another agent's has been checked
                text = f"{what} {factor!r} uses {name!r}, which is no declared {kind}{similar(name, known)}"
                self._problems.add(text, f"{key}.{factor}")

    def _take_tables(self, document: dict[str, Any]) -> None:
        for name, value in self._problems.tables(document, "ensembles"):
            key, before = f"ensembles.{name}", len(self._problems)
            if name in {"", self._predicates.name}:
                self._problems.add(f"an ensemble cannot be called {name!r}: give it another name", key)
            safe = value.get("safe_action") if isinstance(value, dict) else None
            if (
                isinstance(safe, dict)
                and self._share is not None
                and not safe.keys().isdisjoint(self._share.team.names)
            ):
                self._problems.add(_ONE_SAFE_ACTION, f"{key}.safe_action")
                value = {field: given for field, given in value.items() if field != "safe_action"}  # noqa: PLW2901
            self._tables[name] = self._problems.convert(value, EnsembleTable, key, partly=True)
            if len(self._problems) > before:
                self._invalid.add(name)
        if not document.get("ensembles"):
            self._problems.add("the file has no ensemble: add a table such as [ensembles.robot]", "ensembles")

    def _ensemble(self, name: str, above: tuple[str, ...]) -> Ensemble | None:
        """Build an ensemble after its children; None if it has problems, which are reported once."""
        table, key = self._tables[name], f"ensembles.{name}"
        if name in self._ensembles or table is None:
            return self._ensembles.get(name)
        self._ensembles[name] = None
        attempt = self._problems.attempt
        parts = attempt(key, self._parts, name, table, (*above, name))
        if parts is None:
            return None
        options = {**table.as_arguments(SafetySettings), **parts}
        ensemble = attempt(key, Ensemble, name, predicates=self._predicates, local=table.local, **options)
        if ensemble is None:
            return None
        self._ensembles[name] = ensemble
        if table.drift is not None:
            attempt(f"{key}.drift", self._watch, ensemble, table.drift)
        if table.durations is not None:
            attempt(f"{key}.durations", self._time, ensemble, table.durations)
        return ensemble

    def _watch(self, ensemble: Ensemble, odds: float) -> None:
        """Start to watch an ensemble's model for drift."""
        from mdm.actors.drift import DriftMonitor  # noqa: PLC0415 - other files load nothing that estimates

        if ensemble.name in self.joint:
            raise ConfigError("drift is watched where one agent decides: a team's decisions tell no state")
        self.monitors.append(DriftMonitor(ensemble, odds=odds, name=f"{ensemble.name}-drift"))

    def _time(self, ensemble: Ensemble, path: str) -> None:
        """Take how long actions take in an ensemble's model."""
        from mdm.formats import load_durations  # noqa: PLC0415 - few files name any

        model = ensemble.controller.model
        if model is None:
            raise ConfigError("durations are those of a model: give the model, too")
        durations = self._load(load_durations, path)
        discounts_in_time(model, durations)
        self.durations[ensemble.name] = durations

    def _parts(self, name: str, table: EnsembleTable, above: tuple[str, ...]) -> dict[str, Any] | None:
        """Return the parts of an ensemble; None if one has problems, which are noted."""
        key, attempt = f"ensembles.{name}", self._problems.attempt
        given = table.actions if self._share is None else self._share.actions(table.actions, f"{key}.actions")
        actions = None if given is None else self._actions(name, given, above)
        indices = table.model is None
        states = self._factors(StateFactor, StateTable, table.states, f"{key}.states", indices=indices)
        observations = self._factors(
            *(ObservationFactor, ObservationTable, table.observations, f"{key}.observations"), indices=indices
        )
        drive = attempt(f"{key}.drive", drive_of, table.drive)
        supervision = self._supervision(table.supervision, f"{key}.supervision")
        if name in self._invalid:
            return None
        model = attempt(f"{key}.model", self._model, table)
        if table.model is not None and model is None:
            return None
        memory = self._share.memory if table.memory is None and self._share is not None else table.memory
        with sparing(wanted=memory is not None):
            if is_reference(table.policy):
                policy = self._own_policy(table, model, key, (states or [], observations or []))
            else:
                policy = attempt(f"{key}.policy", self._policy, table, model)
        if policy is not None:
            policy = self._around(table, model, policy, key, memory)
        self._wired[name] = states or [], observations or []
        seat = self._seat(name, table, model)
        if given is None:
            actions = self._idle(seat, model, f"{key}.actions")
        parts: dict[str, Any] = {
            "policy": policy,
            "actions": actions,
            "states": states,
            "observations": observations,
            "drive": drive,
            "supervision": supervision,
        }
        rewards = attempt(f"{key}.rewards", self._load, load_rewards, table.rewards)
        if table.tracker is not None:
            parts["tracker"] = self._made(table.tracker, model, f"{key}.tracker", "a tracker")
        safe = attempt(f"{key}.safe_action", self._safe_action, name, table.safe_action, seat, f"{key}.safe_action")
        if any(part is None for part in parts.values()):
            return None
        if table.tracker is not None and self._functions.looks:
            parts["tracker"] = None
        self._check_owners(seat, (*parts["states"], *parts["observations"]), key)
        if seat.placement is not None:
            self.joint[name] = seat.placement
        own = {"rewards": rewards, "safe_action": safe, "agent": seat.agent, "memory": memory}
        return {**parts, "model": model, **own}

    # -- A team's --------------------------------------------------------------------------------------------------

    def _seat(self, name: str, table: EnsembleTable, model: MDP | POMDP | None) -> Seat:
        key = f"ensembles.{name}"
        if self._share is not None:
            agents = () if model is None else [factor.name for factor in model.action_space.factors]
            return self._share.seat(name, table, agents, self._problems)
        for field in ("agents", "placement"):
            if getattr(table, field) is not None:
                raise ConfigError(f"{field!r} is for a team's file, which has a table [team]", key=f"{key}.{field}")
        return Seat(0 if table.agent is None else table.agent)

    def _idle(self, seat: Seat, model: MDP | POMDP | None, key: str) -> dict[Any, Binding]:
        """Return the actions of an agent that carries none out, where the others have theirs.

        Raises:
            ConfigError: If it should carry some out.
        """
        if seat.acts or model is None:
            raise ConfigError(f"there are no actions for agent {seat.who!r}", key=key)
        return {name: Binding(nothing) for name in model.action_space.factors[0].names}

    def _check_owners(self, seat: Seat, factors: Sequence[StateFactor | ObservationFactor], key: str) -> None:
        """Note owners that are no agents of the team; refuse them where no team decides together."""
        for factor in factors:
            if factor.owner is None:
                continue
            kind = "states" if isinstance(factor, StateFactor) else "observations"
            place = f"{key}.{kind}.{factor.name}"
            if seat.placement is None or self._share is None:
                raise ConfigError("an owner is for factors of what a team decides together", key=place)
            before = len(self._problems)
            with self._problems.collecting(place):
                self._share.team.check_agent(factor.owner, key=f"{place}.owner")
            self._unowned |= len(self._problems) > before

    # -- Parts -----------------------------------------------------------------------------------------------------

    def _load(self, load: Callable[[Path], Any], path: str | None) -> Any:
        """Return the content of a file by its path; None where no path is given."""
        return None if path is None else load(self._resolve(path))

    def _resolve(self, path: str) -> Path:
        if not path or "\0" in path:
            raise ConfigError(f"the path of a file was expected, not {path!r}")
        return self._folder / path

    def _model(self, table: EnsembleTable) -> MDP | POMDP | None:
        if table.model is None:
            return None
        path = self._resolve(table.model)
        model = self._models.get(path)
        if model is None:
            model = self._models[path] = load_model(path)
        return model if table.discount is None else model.with_discount(table.discount)

    def _policy(self, table: EnsembleTable, model: MDP | POMDP | None) -> Policy:
        if isinstance(table.policy, list):
            count = len(table.actions) if model is None else len(model.action_space)
            return DeterministicPolicy(table.policy, count)
        return load_policy(self._resolve(table.policy), model, kind=table.policy_kind, seed=table.seed)

    def _own_policy(
        self,
        table: EnsembleTable,
        model: MDP | POMDP | None,
        key: str,
        factors: tuple[Sequence[StateFactor], Sequence[ObservationFactor]],
    ) -> Policy | None:
        """Return a policy that the user's code makes; where no module is run, one of the same sizes."""
        reference = str(table.policy)
        if table.policy_kind is not None:
            raise ConfigError("policy_kind is for a matrix in a file", key=f"{key}.policy_kind")
        made = self._made(reference, model, f"{key}.policy", "a policy")
        if made is None:
            return None
        attempt, place = self._problems.attempt, f"{key}.policy"
        if made is True and self._functions.looks:
            return attempt(place, unseen_policy, reference, model, len(table.actions), *factors)
        policy = attempt(place, policy_of, made, model)
        return policy if policy is None or table.seed is None else attempt(place, seeded, policy, table.seed)

    def _made(self, reference: str, model: MDP | POMDP | None, key: str, what: str) -> Any:
        """Return an object of the user's code; True where no module is run, None where there are problems."""
        before = len(self._problems)
        made = self._functions.make(reference, key, model)
        if made is None and len(self._problems) == before:
            if self._functions.looks:
                return True
            self._problems.add(f"{reference!r} returned None in place of {what}", key)
        return made

    def _safe_action(self, name: str, given: str | dict[str, Any] | None, seat: Seat, key: str) -> Any:
        if given is None or (isinstance(given, str) and ":" not in given):
            return given
        if not seat.acts:
            return nothing
        if isinstance(given, dict) and self._readers.of("actions", given, ActionTable.__struct_fields__) is None:
            for field in given:
                if field not in _OF_SAFE_ACTION:
                    keys = ", ".join(_OF_SAFE_ACTION)
                    raise ConfigError(f"a safe action has no key {field!r}; its keys are {keys}")
        return self._binding(name, given, key, ()) or nothing

    def _around(
        self, table: EnsembleTable, model: MDP | POMDP | None, policy: Any, key: str, memory: float | None
    ) -> Any:
        """Return the policy, or a search that falls back on it, behind a shield where there is one."""
        convert, attempt = self._problems.convert, self._problems.attempt
        if table.search is not None:
            of = f"{key}.search"
            search: SearchTable | None = convert(table.search, SearchTable, of)
            policy = None if search is None else attempt(of, self._searching, table, search, model, policy, memory)
        if table.shield is not None and policy is not None:
            policy = attempt(f"{key}.shield", self._shielded, table, model, policy, f"{key}.shield")
        return policy

    def _shielded(self, table: EnsembleTable, model: MDP | POMDP | None, policy: Any, key: str) -> Any:
        if self._problems.convert(table.shield, ShieldTable, key) is None:
            return None
        if table.local or model is None:
            why = "needs a model" if model is None else "is of the joint policy, and not of one agent's part of it"
            raise ConfigError(f"a shield {why}")
        if is_reference(table.policy) and self._functions.looks:
            return policy  # of code, which is not run
        from mdm.verification import shield  # noqa: PLC0415 - a robot without a shield verifies nothing

        if table.false_negative is not None:
            model = model.with_false_negatives(table.false_negative)
        try:
            return shield(policy, model, **table.shield)
        except ConfigError as error:
            raise ConfigError(error.message, key=".".join(filter(None, (key, error.key)))) from None

    def _searching(
        self, table: EnsembleTable, search: SearchTable, model: MDP | POMDP | None, policy: Any, memory: float | None
    ) -> TreeSearch:
        from mdm.solvers.online import TreeSearch  # noqa: PLC0415 - a robot that does not search loads no solver

        if model is None:
            raise ConfigError("a search needs a model")
        if table.false_negative is not None:
            model = model.with_false_negatives(table.false_negative)
        check_memory(model, memory, beliefs=True, matrices="a search")
        return TreeSearch(
            model if memory is None else spared(model),
            seed=table.seed,
            fallback=policy,
            plans=policy if search.plans else None,
            **{name: limit for name, limit in table.search.items() if name != "plans"},
        )

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
                if given is not None and self._share is not None:
                    given = fields[names] = self._share.wires(given, self._predicates.declared.names)
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
        if table is None:
            return None
        return Restart(limit=table.restart, **{name: value for name, value in given.items() if name != "restart"})

    def _actions(self, name: str, actions: Mapping[str, Any], above: tuple[str, ...]) -> dict[Any, Binding] | None:
        bindings: dict[Any, Binding] = {}
        for action, given in actions.items():
            key = f"ensembles.{name}.actions.{action}"
            binding = self._problems.attempt(key, self._binding, name, given, key, above)
            if binding is not None:
                bindings[int(action) if action.isdecimal() else action] = binding
        return bindings if len(bindings) == len(actions) else None

    def _binding(self, name: str, given: Any, key: str, above: tuple[str, ...]) -> Binding | None:
        """Return the binding of an action of an ensemble; None where it has problems that are noted."""
        written = {"call": given} if isinstance(given, str) else given
        reader = self._readers.of("actions", written, ActionTable.__struct_fields__)
        if reader is not None:
            return reader.action(written, key)
        entry: ActionTable | None = self._problems.convert(written, ActionTable, key)
        if entry is None:
            return None
        if entry.way is not None or entry.place is not None:
            return self._drive_to(entry, written)
        target = self._target(entry, key, name, above)
        if not isinstance(target, Binding):
            return None if target is None else self._bound(entry, target)
        if target.ensemble is not None:
            raise ConfigError(f"{entry.call!r} is bound to an ensemble: name one of this file, by 'ensemble'")
        if others := [field for field in written if field != "call"]:
            raise ConfigError(f"{entry.call!r} is a Binding, which has its own options: leave {', '.join(others)} out")
        return target

    def _bound(self, entry: ActionTable, target: Any) -> Binding:
        """Return the action of a function or an ensemble."""
        options = entry.as_arguments(BindingSettings)
        if not entry.navigate:
            return Binding(target, **options)
        if entry.call is None:
            raise ConfigError("'navigate' is for a function ('call'), which takes an argument of that name")
        if self._located and self._navigation is None:
            raise ConfigError("'navigate' needs a navigator: give a table [places] with one")
        if self._navigation is not None and type(target) not in {Lasting, Unseen} and target is not nothing:
            return self._navigation.task(target, **options)
        binding = Binding(target, **options)  # in place of one that is not called
        binding.retries = entry.then != "wait"
        return binding

    def _drive_to(self, entry: ActionTable, keys: Mapping[str, Any]) -> Binding:
        """Return the action that takes a way of the map, or goes to a place."""
        what = "way" if entry.place is None else "place"
        own = DriveSettings.__struct_fields__
        for key in keys:
            if key not in {what, *own}:
                raise ConfigError(f"{key!r} means nothing beside a {what}; its keys are {what}, {', '.join(own)}")
        options = entry.as_arguments(DriveSettings)
        if not self._located:
            return Binding(nothing, **options)
        if self._navigation is None:
            raise ConfigError(f"a {what} needs a navigator to drive there: give a table [places] with one")
        if entry.place is not None:
            return self._navigation.go_to(entry.place, **options)
        return self._navigation.way(str(entry.way), **options)

    def _target(self, entry: ActionTable, key: str, name: str, above: tuple[str, ...]) -> Any:
        if (entry.call is None) == (entry.ensemble is None):
            raise ConfigError("an action needs either a function ('call'), an 'ensemble', or a 'way' or 'place'")
        if entry.call is not None:
            table = self._tables[name]
            model = partial(self._model, table) if table is not None else lambda: None
            return self._functions.find_action(entry.call, key, model) or nothing  # what else is wrong is told, too
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


def _is_mapping(table: dict[str, Any]) -> bool:
    """Whether a factor's table is a mapping from symbols to names, without options."""
    return bool(table) and all(isinstance(value, str) for value in table.values())
