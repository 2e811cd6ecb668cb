"""The values that tests give options: each option that is a number is given two of them at least.

A test at one value alone finds neither a swapped unit nor a wrong constant. A complete run, that of `make test` or of
all tests, notes the numbers that are accepted in the tables of TOML files, and as keywords by what takes a typed
dictionary. Workers hand theirs to the session that has begun them, which fails where an option had fewer than two.
"""

from __future__ import annotations

import functools
import inspect
from collections import defaultdict
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints
from weakref import WeakKeyDictionary

import msgspec
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ENOUGH = 2
RINGS = ("", "not slow")
"""What a complete run chooses by marks: nothing, or the default ring, which tests every behaviour."""


def why_partial(config: pytest.Config) -> str:
    """Return why a run is not one of all tests; empty where it is."""
    option = config.option
    if config.args_source is pytest.Config.ArgsSource.ARGS:
        return "paths are given"
    if option.markexpr not in RINGS:
        return f"-m {option.markexpr!r} is given"
    for name in ("keyword", "maxfail", "deselect", "ignore", "ignore_glob", "lf", "stepwise", "collectonly"):
        if getattr(option, name, None):
            return f"the option {name} is given"
    return ""


def is_number(kind: Any) -> bool:
    """Whether a type is that of numbers, maybe among others."""
    if get_origin(kind) is Annotated:
        return is_number(get_args(kind)[0])
    return kind in (int, float) or (get_origin(kind) not in (list, dict) and any(map(is_number, get_args(kind))))


def numbers_of(table: type) -> list[str]:
    """Return the keys of a table of TOML files that are numbers."""
    return [name for name, kind in get_type_hints(table, include_extras=True).items() if is_number(kind)]


def keywords_of(options: type) -> list[str]:
    """Return the options of a typed dictionary that are numbers."""
    written = {name: getattr(kind, "__forward_arg__", str(kind)) for name, kind in options.__annotations__.items()}
    return [name for name, kind in written.items() if {"int", "float"}.intersection(kind.split(" | "))]


def derived(kind: type) -> list[type]:
    """Return the classes that derive from one, however far below."""
    return [each for below in kind.__subclasses__() for each in (below, *derived(below))]


def tables() -> list[type]:
    """Return all tables of TOML files: structs of options that are declared in their package, or converted to there."""
    import mdm.config
    import mdm.ros2  # here, as below: runs that are not complete need nothing of it
    from mdm.options import Options
    from mdm.team.ownership import Placement
    from mdm.team.team import Agent
    from mdm.team.transport.settings import Ceiling

    for package in (mdm.config, mdm.ros2):
        for module in iter_modules(package.__path__):
            import_module(f"{package.__name__}.{module.name}")
    packages = ("mdm.config.", "mdm.ros2.")
    own = [
        table for table in derived(Options) if table.__module__.startswith(packages) and table.__name__ != "TopicTable"
    ]
    return [*own, Agent, Ceiling, Placement]


def takers() -> list[tuple[type, type, type]]:
    """Return the classes that take typed dictionaries, each with that and with the struct that checks it."""
    from mdm.actors import Binding, ControlLayer, Ensemble, options
    from mdm.controller import Controller
    from mdm.maps import places
    from mdm.options import ControllerOptions, ControllerSettings
    from mdm.recording import recorder
    from mdm.team import team

    return [
        (Ensemble, options.SafetyOptions, options.SafetySettings),
        (ControlLayer, options.ControlOptions, options.ControlSettings),
        (Controller, ControllerOptions, ControllerSettings),
        (Binding, options.BindingOptions, options.BindingSettings),
        (places.Places, places.PlacesOptions, places.PlacesSettings),
        (recorder.Recorder, recorder.RecorderOptions, recorder.RecorderSettings),
        (team.Team, team.TeamOptions, team.TeamSettings),
    ]


def known() -> list[str]:
    """Return all options that are numbers: of tables behind their names, and keywords."""
    found = {f"{table.__name__}.{name}" for table in tables() for name in numbers_of(table)}
    found.update(f"keyword {name}" for _, options, _ in takers() for name in keywords_of(options))
    return sorted(found)


class Values:
    """The values that options were given, of which no more are kept than are needed."""

    def __init__(self) -> None:
        self.given: dict[str, set[float]] = defaultdict(set)

    def note(self, option: str, value: object) -> None:
        """Note what an option was given, where that is a number or the rate of a drive."""
        value = getattr(value, "rate", value)
        if isinstance(value, int | float) and not isinstance(value, bool) and len(self.given[option]) < ENOUGH:
            self.given[option].add(float(value))

    def merge(self, given: Mapping[str, list[float]]) -> None:
        """Take what another process has noted."""
        for option, values in given.items():
            for value in values:
                self.note(option, value)

    def too_few(self, options: list[str]) -> list[str]:
        """Return which options had fewer values than are needed, with those."""
        return [
            f"{option}: {', '.join(f'{value:g}' for value in self.given[option]) or 'none'}"
            for option in options
            if len(self.given[option]) < ENOUGH
        ]

    def listen(self) -> None:
        """Note from now on what is accepted."""
        from mdm.config.tables import Problems

        for taker, options, settings in takers():
            taker.__init__ = self._heard(taker.__init__, keywords_of(options), settings)
        numbers = {table: numbers_of(table) for table in tables()}
        convert, raise_all = Problems.convert, Problems.raise_all
        waiting: WeakKeyDictionary[Problems, list[tuple[str, Any]]] = WeakKeyDictionary()

        @functools.wraps(convert)
        def converted(problems: Any, value: Any, kind: Any, *args: Any, **options: Any) -> Any:
            table = convert(problems, value, kind, *args, **options)
            if table is not None and isinstance(value, dict):
                waiting.setdefault(problems, []).extend(
                    (f"{kind.__name__}.{name}", getattr(table, name)) for name in numbers.get(kind, ()) if name in value
                )
            return table

        @functools.wraps(raise_all)
        def raised(problems: Any) -> None:
            found = waiting.pop(problems, [])
            raise_all(problems)
            for option, value in found:
                self.note(option, value)

        Problems.convert, Problems.raise_all = converted, raised

    def _heard(self, initialise: Callable[..., None], names: list[str], settings: type) -> Callable[..., None]:
        signature = inspect.signature(initialise)
        defaults = {field.name: field.default for field in msgspec.structs.fields(settings)}

        @functools.wraps(initialise)
        def initialised(*args: Any, **options: Any) -> None:
            initialise(*args, **options)
            given = dict(zip(signature.parameters, args, strict=False)) | options
            for name in names:
                if name in given and given[name] != defaults[name]:
                    self.note(f"keyword {name}", given[name])

        return initialised


class ValuesPlugin:
    """Notes the values of a complete run, over all its workers, and judges them at its end.

    Args:
        config: The session's.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.values = Values()
        self._worker = getattr(config, "workerinput", None)
        self._why_not = why_partial(config) if self._worker is None else self._worker["why_partial"]
        self._too_few: list[str] = []

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Tell a worker whether the run is complete."""
        node.workerinput["why_partial"] = self._why_not

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take what a worker has noted."""
        self.values.merge(getattr(node, "workeroutput", {}).get("values", {}))

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Begin to note, where tests run in this process."""
        if not self._why_not and session.items:
            self.values.listen()

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Hand over what was noted; where workers have, and all tests have passed, fail if that is too little."""
        if self._worker is not None:
            given = {option: sorted(values) for option, values in self.values.given.items()}
            session.config.workeroutput["values"] = given
        elif not self._why_not and exitstatus == pytest.ExitCode.OK:
            self._too_few = self.values.too_few(known())
            if self._too_few:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED
        elif not self._why_not:
            self._why_not = "not all tests have passed"

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Name the options that were given too few values, or say why that is not known."""
        if self._too_few:
            terminalreporter.section(f"options that tests gave fewer than {ENOUGH} values")
            for each in self._too_few:
                terminalreporter.line(each)
        elif self._why_not and terminalreporter.verbosity >= 0:
            terminalreporter.line(f"How many values each option was given is not judged: {self._why_not}.")
