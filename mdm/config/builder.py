"""The system, and its construction from a TOML file; all problems are collected."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.actors import PredicateManager
from mdm.actors.predicates.declarations import ACTION_END, near_end
from mdm.config.ensembles import Ensembles
from mdm.config.functions import Functions, Unseen
from mdm.config.readers import Readers, Reading
from mdm.config.tables import EventTable, PredicateTable, Problems
from mdm.errors import ConfigError, Error
from mdm.formats.archive.npz import is_archive
from mdm.formats.files import beginning, holds_policy
from mdm.logic import Formula, Monitor, parse, similar
from mdm.messages import Fault
from mdm.options import Seconds
from mdm.runtime import Actor, ActorFailure
from mdm.runtime.process.watchdog import check_emergency
from mdm.runtime.supervision import describe
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from mdm.actors import Ensemble
    from mdm.config.readers import TableReader
    from mdm.config.team_file import Share, TeamFile
    from mdm.maps import Navigation, Places
    from mdm.models import MDP, Durations
    from mdm.runtime import Extension
    from mdm.team import Member, Team
    from mdm.team.transport.transport import Transport

_KNOWN = ("team", "places", "predicates", "events", "ensembles", "tasks", "emergency", "starved_after")
_HELD: dict[bool | None, str] = {True: "a policy", False: "a model"}


class System(Actor):
    """A predicate manager, ensembles and tasks as one actor, as described by a TOML file.

    Example::

        system = mdm.load_system("patrol/patrol.toml", callbacks=False)
        print(system.tree())

    Args:
        predicates: The predicate manager that all ensembles share.
        ensembles: All ensembles by name. Those without a parent start with the system.
        tasks: Async functions that take the system and run beside the ensembles, such as sensor drivers.
        places: Where the robot is, on a map; its tasks tell it poses.
        member: Of a team, this agent's part: its ensembles start with it.
        emergency: A plain function without arguments that the runtime calls as the last resort, besides its own.
        starved_after: Seconds for which a turn that was cut short may go on while other input comes, where the runtime
            is given none of its own.
        monitors: Actors that start before the ensembles and watch them, such as drift monitors.
        durations: By the names of ensembles, how long actions take in the models that their policies are for.
        extensions: Opened by the runtime before the system starts, and closed behind the safe actions; not in a replay.
        above: By the names of ensembles and of the predicate manager, the path of the actors that these have above
            them, by default none; None for a predicate manager that the ensembles start which use it.
    """

    def __init__(
        self,
        predicates: PredicateManager,
        ensembles: dict[str, Ensemble],
        tasks: list[Callable[[System], Any]],
        name: str = "system",
        *,
        places: Places | None = None,
        member: Member | None = None,
        emergency: Callable[[], object] | None = None,
        starved_after: float | None = None,
        monitors: Iterable[Actor] = (),
        durations: Mapping[str, Durations] | None = None,
        extensions: Iterable[Extension] = (),
        above: Mapping[str, str | None] | None = None,
    ) -> None:
        super().__init__(name)
        above = {} if above is None else above
        self.predicates = predicates
        self.ensembles = ensembles
        self.tasks = tasks
        self.places = places
        self.member = member
        self.emergency = emergency
        self.starved_after = starved_after
        self.durations = {} if durations is None else dict(durations)
        self.extensions = tuple(extensions)
        if (place := above.get(predicates.name, "")) is not None:
            self._actor_at(place).add(predicates)
        if places is not None:
            self.add(places)
        if member is not None:
            self.add(member)
        for monitor in monitors:
            self.add(monitor)
        for ensemble in self.top:
            if member is None or ensemble.name not in member.ensembles:
                self._actor_at(above.get(ensemble.name) or "").add(ensemble)

    def _actor_at(self, path: str) -> Actor:
        """Return the actor at a path below; those that are not there are made."""
        actor: Actor = self
        for name in filter(None, path.split("/")):
            if name not in [child.name for child in actor.children]:
                actor.add(Actor(name))
            actor = next(child for child in actor.children if child.name == name)
        return actor

    @property
    def path(self) -> str:
        """Empty, so that channels have the names of their ensembles: ``patrol/state``."""
        return ""

    @property
    def agent(self) -> str | None:
        """Of a team, which agent this is."""
        return None if self.member is None else self.member.agent

    @property
    def top(self) -> tuple[Ensemble, ...]:
        """The ensembles without a parent, which start with the system."""
        below = {below.name for ensemble in self.ensembles.values() for below in ensemble.subensembles}
        return tuple(ensemble for name, ensemble in self.ensembles.items() if name not in below)

    def on_start(self) -> None:
        """Hand the runtime its settings, and declare teammates' predicates before the predicate manager starts."""
        if self.emergency is not None and not self._is_repeated:
            self.runtime.add_emergency(self.emergency)
        if self.starved_after is not None:
            self.runtime.limit_starving(self.starved_after)
        if self.member is not None:
            self.member.prepare(self.runtime)

    def on_running(self) -> None:
        """Run the tasks; where a run is repeated, its record has their messages."""
        for task in () if self._is_repeated else self.tasks:
            self.spawn(self._run_task(task), name=task.__name__)

    @property
    def _is_repeated(self) -> bool:
        return self.runtime.dispatcher.choices.repeats

    async def _run_task(self, task: Callable[[System], Any]) -> None:
        try:
            await task(self)
        except Exception as error:
            failure = ActorFailure(f"task {task.__name__!r} failed: {describe(error)}")
            failure.escalated = True  # it is told here, with its own place in the code alone
            self._tell(task, str(failure))
            raise failure from error
        text = "the predicates that it set are told nothing more, and are unknown after their max_age"
        self._tell(task, f"task {task.__name__!r} has returned: {text}, if nothing else sets them")

    def _tell(self, task: Callable[[System], Any], detail: str) -> None:
        self.runtime.faults.publish(Fault(self.runtime.now(), f"tasks/{task.__name__}", "task", detail))

    def tree(self) -> str:
        """Return the names of all ensembles, indented below their parents."""
        return "\n".join(ensemble.tree() for ensemble in self.top)


def load_system(
    path: str | Path | Mapping[str, Any],
    *,
    folder: str | Path | None = None,
    agent: str | None = None,
    callbacks: bool = True,
    transport: Transport | None = None,
    decisions: str | Path | None = None,
    models: dict[Path, MDP] | None = None,
    tables: Mapping[str, type[TableReader]] | None = None,
    virtual: bool = False,
) -> System:
    """Build the system that a TOML file describes; of a team's file, that of one agent.

    Example::

        system = mdm.load_system("patrol.toml")
        mdm.run(system)

    Args:
        path: The file; or a document, as `tomllib.loads` returns it. Paths in it are relative to its folder, which is
            also searched first for modules.
        folder: That of a document; by default the working directory.
        agent: Of a team's file, which agent's system.
        callbacks: Import and bind the functions; otherwise actions do nothing and tasks are left out.
        transport: Of a team's file, the carrier of the agent's messages; by default a session of Zenoh at its endpoint.
        decisions: Of a team's file, a file to which each joint step is added as a line of JSON.
        models: Those that were loaded before, by their files, and are not loaded again; newly loaded ones are added.
            For programs that have the systems of several agents.
        tables: The program's own readers of extensions' tables, by their names; other packages register theirs as
            entry points of the group ``"mdm.tables"``.
        virtual: It is to run in virtual time: extensions that need real time are left out, and their actions last.

    Raises:
        ConfigError: With all problems, one per line and each in its ``problems``; those of a document name no file.
        Error: If a folder is given for a file, which has its own.
    """
    if not isinstance(path, Mapping) and folder is not None:
        raise Error(f"leave folder out: the paths in {path} are relative to the folder of that file")
    given = path if isinstance(path, Mapping) else Path(path)
    builder = Builder(given, folder=folder, callbacks=callbacks, models=models, tables=tables, virtual=virtual)
    return builder.system(agent, transport=transport, decisions=decisions)


def look_over(path: str | Path, *, agent: str | None = None, models: dict[Path, MDP] | None = None) -> System:
    """Build the system that a TOML file describes, to look at it: functions are looked for, and not imported.

    Args:
        path: The file.
        agent: Of a team's file, which agent's system.
        models: Those that were loaded before, by their files; newly loaded ones are added.

    Raises:
        ConfigError: With all problems, one per line and each in its ``problems``.
    """
    return Builder(Path(path), callbacks=False, look=True, models=models).system(agent)


def load_team(path: str | Path) -> Team | None:
    """Return the team that a TOML file describes, without its ensembles; None where it describes none.

    Raises:
        ConfigError: If the file cannot be read, or with all problems of its table ``team``.
    """
    described = load_team_file(path)
    return None if described is None else described.team


def agents_of(path: str | Path) -> tuple[str, ...]:
    """Return the names of the agents of the team that a TOML file describes, though the file may have problems.

    Args:
        path: The file.

    Returns:
        The names; none where the file describes no team.

    Raises:
        ConfigError: If the file cannot be read, or its table ``team`` does not say who the agents are.
    """
    described = Builder(Path(path), callbacks=False).team(whole=False)
    return () if described is None else described.team.names


def load_team_file(path: str | Path) -> TeamFile | None:
    """Return the team that a TOML file describes, with where its certificates are; None where it describes none.

    Raises:
        ConfigError: If the file cannot be read, or with all problems of its table ``team``.
    """
    return Builder(Path(path), callbacks=False).team()


class Builder:
    """Builds a system and collects problems; arguments are those of `load_system`.

    Attributes:
        functions: Finds the functions that are named.
        above: The paths of actors above ensembles and the predicate manager, see `System`.
        manager: The name of the predicate manager.
        memory: Whether ensembles that do not say have the memory of their team, as those of a file.
    """

    def __init__(
        self,
        given: Path | Mapping[str, Any],
        *,
        callbacks: bool,
        folder: str | Path | None = None,
        look: bool = False,
        models: dict[Path, MDP] | None = None,
        tables: Mapping[str, Any] | None = None,
        virtual: bool = False,
    ) -> None:
        path = given if isinstance(given, Path) else None
        self._given = given
        self._folder = Path(folder or "") if path is None else path.parent
        self._models = models
        self._tables = {} if tables is None else tables
        self._virtual = virtual
        self._callbacks = callbacks
        self.above: Mapping[str, str | None] = {}
        self.manager = "predicates"
        self.memory = True
        self._problems = Problems(path)
        self.functions = Functions(self._folder, self._problems, callbacks=callbacks, look=look)

    def team(self, *, whole: bool = True) -> TeamFile | None:
        """Return the team; raise its problems, or, where it need not be whole, those that hide its agents."""
        described = self._team(self._read())
        if whole or described is None:
            self._problems.raise_all()
        return described

    def _team(self, document: dict[str, Any]) -> TeamFile | None:
        """Return the team of a file; None where it has none, or problems that hide its agents."""
        if "team" not in document:
            return None
        from mdm.config.team_file import read_team  # noqa: PLC0415 - files without a team load nothing of teams

        return read_team(document["team"], self._folder, self.functions, self._problems)

    def system(self, agent: str | None, **options: Any) -> System:
        """Return the system, or raise all problems."""
        document = self._read()
        described, share = self._share(document, agent)
        if share is not None and not self.memory:
            share.memory = None
        declarations = Declarations(self._problems, share, self.manager)
        reading = Reading(self._folder, declarations.manager, self.functions, self._problems, share, self._virtual)
        readers = Readers(document, _KNOWN, self._tables, reading)
        places, navigation = self._places(document, readers)
        declarations.declare(document, readers)
        declarations.declare_others(document.get("ensembles"))
        located = places is not None or "places" not in document  # else any name may be one of the map's
        builder = Ensembles(readers, navigation, located=located, models=self._models)
        ensembles = builder.build(document)
        given = document.get("tasks", [])
        if share is not None and isinstance(given, dict):
            given = self._problems.attempt("tasks", share.own, given)
        tasks = self._tasks(given)
        emergency = self._emergency(document.get("emergency"))
        starved_after = self._problems.convert(document.get("starved_after"), Seconds | None, "starved_after")
        if located:
            declarations.check()
        before = len(self._problems)
        if located:
            builder.check(ensembles, led=share is None)
        member = None
        if described is not None and share is not None and builder.complete and located:
            with self._problems.collecting("team", first=True):
                if options.get("transport") is None:
                    options |= described.options(share.agent)
                joint = [ensembles[name] for name in builder.joint]
                member = share.team.member(share.agent, *joint, placement=builder.joint, **options)
        if member is not None and len(self._problems) == before:
            builder.check(ensembles)
        if builder.complete:
            declarations.check_ends({name for ensemble in ensembles.values() for name in ensemble.action.names})
        self._problems.raise_all()
        extensions = readers.extensions()
        self._problems.raise_all()
        system = self._problems.attempt(
            *("ensembles", System, declarations.manager, ensembles, tasks),
            places=places,
            member=member,
            emergency=emergency,
            starved_after=starved_after,
            monitors=builder.monitors,
            durations=builder.durations,
            extensions=extensions,
            above=self.above,
        )
        self._problems.raise_all()
        assert system is not None
        return system

    def _places(self, document: dict[str, Any], readers: Readers) -> tuple[Places | None, Navigation | None]:
        """Return the places of the map, and the navigator that drives there; None where there are problems."""
        if "places" not in document:
            return None, None
        if "places" in dict(self._problems.tables(document, "ensembles")):
            self._problems.add(
                "an ensemble cannot be called 'places' beside a map: give it another name", "ensembles.places"
            )
        from mdm.config.places import read_places  # noqa: PLC0415 - files without a map load nothing of maps

        return read_places(document["places"], readers)

    def _share(self, document: dict[str, Any], agent: str | None) -> tuple[TeamFile, Share] | tuple[None, None]:
        """Return the team, and the agent's share of its file."""
        if "team" not in document:
            if agent is not None:
                self._problems.add(f"there is no table [team] in this file, and so no agent {agent!r}", "team")
                self._problems.raise_all()
            return None, None
        described = self._team(document)
        share = None if described is None else self._problems.attempt("team.agents", described.share, agent)
        if described is None or share is None:
            self._problems.raise_all()
        assert described is not None
        assert share is not None
        return described, share

    def _read(self) -> dict[str, Any]:
        if not isinstance(self._given, Path):
            return dict(self._given)
        if self._given.exists() and not self._given.is_file() and not self._given.is_dir():
            self._problems.add("this is a pipe or a device, not a file: save its content to a file first", None)
            self._problems.raise_all()
        try:
            return tomllib.loads(self._given.read_text(encoding="utf-8-sig"))
        except FileNotFoundError:
            self._problems.add("there is no such file", None)
        except IsADirectoryError:
            self._problems.add("this is a folder, not a file", None)
        except OSError as error:
            self._problems.add(f"the file cannot be read: {error.strerror}", None)
        except UnicodeDecodeError:
            self._problems.add(self._other_content(self._given) or "this is not UTF-8 text, which TOML requires", None)
        except tomllib.TOMLDecodeError as error:
            self._problems.add(self._other_content(self._given) or f"this is not valid TOML: {error}", None)
        self._problems.raise_all()
        raise AssertionError

    def _other_content(self, path: Path) -> str | None:
        """Return the kind of a file that is no TOML by its name either; None if that is not known."""
        if path.suffix == ".toml":
            return None
        held = "a model or a policy" if is_archive(path) else _HELD.get(holds_policy(beginning(path)))
        return None if held is None else f"the file holds {held}; a TOML file of ensembles was expected"

    def _tasks(self, references: object) -> list[Callable[[System], Any]]:
        if references is None:  # an agent has none, or problems have been noted
            return []
        if not isinstance(references, list) or not all(isinstance(reference, str) for reference in references):
            self._problems.add("tasks must be a list of functions, such as ['sensors:read']", "tasks")
            return []
        functions = [self.functions.find(reference, "tasks") for reference in references]
        for reference, function in zip(references, functions, strict=True):
            if not self._is_seen(function):
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
        function = self.functions.find(reference, "emergency")
        if function is None or not self._is_seen(function):
            return None
        with self._problems.collecting("emergency"):
            check_emergency(function)
        return function if self._callbacks else None

    def _is_seen(self, function: Callable[..., Any] | None) -> bool:
        """Whether a function is of the kind and takes the arguments of the one that the file names."""
        return (self._callbacks or self.functions.looks) and function is not None and type(function) is not Unseen


def _takes_one(function: Callable[..., Any]) -> bool:
    try:
        inspect.signature(function).bind(None)
    except TypeError:
        return False
    return True


_KEYS = {
    "sensor": ("sensor", "when", "max_age", "initial"),
    "formula": ("formula", "held_for"),
    "monitor": ("monitor",),
    "latch": ("set", "reset", "initial"),
}


class Declarations:
    """Makes the declarations of a file's tables ``predicates`` and ``events``.

    Args:
        problems: Where problems are noted.
        share: In a team's file, whose part it is; ``robot2/IsMoving`` is the file's name at that agent.
        name: The manager's name.

    Attributes:
        manager: The predicate manager that knows them.
    """

    def __init__(self, problems: Problems, share: Share | None = None, name: str = "predicates") -> None:
        self.manager = PredicateManager(name)
        self._problems = problems
        self._share = share
        self._formulas: list[tuple[str, Formula]] = []

    def declare(self, document: dict[str, Any], readers: Readers) -> None:
        """Declare predicates and events, even invalid ones, so that their uses are not reported as well."""
        manager = self.manager
        self._readers = readers
        tables = ("predicates", self._predicate, manager.sensor), ("events", self._event, manager.event)
        for kind, declare, stand_in in tables:
            for name, value in self._problems.tables(document, kind):
                key = f"{kind}.{name}"
                self._problems.attempt(key, declare, name, {"formula": value} if isinstance(value, str) else value, key)
                if manager.declared.knows(name) is None:
                    stand_in(name)

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

    def _predicate(self, name: str, written: Any, key: str) -> None:
        if (reader := self._readers.of("predicates", written, PredicateTable.__struct_fields__)) is not None:
            reader.predicate(name, written, key)
            return
        table: PredicateTable | None = self._problems.convert(written, PredicateTable, key)
        if table is None:
            return
        _refuse_mixture(table, written)
        if table.formula is not None:
            self.manager.define(name, self._formula(table.formula, key), held_for=table.held_for)
        elif table.monitor is not None:
            self.manager.monitor(name, self._formula(Monitor(table.monitor).formula, key))
        elif table.set is not None and table.reset is not None:
            on, off = self._formula(table.set, key), self._formula(table.reset, key)
            self.manager.latch(name, set=on, reset=off, initial=bool(table.initial))
        else:
            self.manager.sensor(name, when=table.when, max_age=table.max_age, initial=table.initial)

    def _event(self, name: str, written: Any, key: str) -> None:
        if (reader := self._readers.of("events", written, EventTable.__struct_fields__)) is not None:
            reader.event(name, written, key)
            return
        table: EventTable | None = self._problems.convert(written, EventTable, key)
        if table is not None:
            self.manager.event(name, None if table.formula is None else self._formula(table.formula, key))

    def _formula(self, given: Formula | str, key: str) -> Formula:
        formula = parse(given) if isinstance(given, str) else given
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
    kind = (
        "latch"
        if latch
        else next((each for each in ("formula", "monitor") if getattr(table, each) is not None), "sensor")
    )
    if latch and table.formula is not None:
        raise ConfigError("a predicate has either a formula or 'set' and 'reset', not both")
    if latch and (table.set is None or table.reset is None):
        raise ConfigError("a latch needs both 'set' and 'reset'")
    if kind == "sensor" and table.held_for is not None:
        raise ConfigError("held_for needs a formula: it is the time for which that must be true")
    if kind == "sensor" and not table.sensor:
        raise ConfigError("a predicate that is not a sensor needs a 'formula', a 'monitor', or 'set' and 'reset'")
    for key in keys:
        if key not in _KEYS[kind]:
            raise ConfigError(f"a {kind} has no key {key!r}; its keys are {', '.join(_KEYS[kind])}")
