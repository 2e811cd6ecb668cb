"""The ensembles that a function of a Python file returns: to name it is the consent to run it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.actors import Ensemble
from mdm.actors.options import FixedRate
from mdm.cli.files.oddities import of_document, of_ensembles
from mdm.cli.files.shields import of_shields
from mdm.config import System
from mdm.config.functions import find_function
from mdm.errors import ConfigError, Error
from mdm.runtime.handler import kind_of
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from mdm.cli.files.check import Findings


def examine(name: str) -> Findings:
    """Return the content, the problems and the notes of the ensembles that a function returns.

    Args:
        name: The file and the function, such as ``robot.py:make``. The file's folder is searched first for modules.
    """
    try:
        ensembles = _ensembles(_made(name))
        problems = [*map(str, _problems(ensembles))]
    except Error as error:
        return None, [f"{name}: {problem}" for problem in getattr(error, "problems", ()) or (error,)], []
    if problems:
        return "ensembles", [f"{name}: {problem}" for problem in problems], []
    odd = [*of_document(_content(ensembles)), *of_ensembles(ensembles.values()), *of_shields(ensembles.values())]
    return "ensembles", [], [f"{name}: {text}" for _, text in odd]


def _made(name: str) -> Any:
    """Return the result of the function.

    Raises:
        ConfigError: If there is no such function, it is no plain one, or it raises.
    """
    file, _, function = name.rpartition(":")
    if name.endswith(".py") or not function:
        raise ConfigError("name a function in it that returns ensembles, such as robot.py:make; it is run")
    path = Path(file)
    if not path.is_file():
        raise ConfigError(f"there is no file {file}")
    make = find_function(f"{path.stem}:{function}", path.parent)
    if (kind := kind_of(make)) is not None:
        raise ConfigError(f"{function!r} is {kind}, not a plain function")
    try:
        return make()
    except Error:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(f"{function!r}, called without arguments, has raised {describe(error)}") from None


def _ensembles(made: Any) -> dict[str, Ensemble]:
    """Return the ensembles of a system, or those given and those below them, by their names.

    Raises:
        ConfigError: If it is something else.
    """
    if isinstance(made, System):
        return dict(made.ensembles)
    given = made.values() if isinstance(made, Mapping) else made
    waiting = [given] if isinstance(given, Ensemble) else [*given] if isinstance(given, Iterable) else []
    if not waiting or not all(isinstance(each, Ensemble) for each in waiting):
        raise ConfigError(f"it returns {type(made).__name__}, not an Ensemble, several of them or a System")
    found: dict[str, Ensemble] = {}
    while waiting:
        ensemble = waiting.pop(0)
        if found.setdefault(ensemble.name, ensemble) is not ensemble:
            raise ConfigError(f"two ensembles are called {ensemble.name!r}: give one another name")
        waiting += ensemble.subensembles
    return found


def _problems(ensembles: Mapping[str, Ensemble]) -> list[Error]:
    """Return all that would keep ensembles from starting."""
    found: list[Error] = []
    for ensemble in ensembles.values():
        if not ensemble.bound:  # else those above include it
            found += ensemble.misfits() if ensemble.shared else ensemble.problems()
    for manager in {each.predicates for each in ensembles.values()}:
        try:
            if manager is not None:
                manager.network().compile()
        except Error as error:
            found.append(error)
    return found


def _content(ensembles: Mapping[str, Ensemble]) -> dict[str, Any]:
    """Return the content of a file that would say the same, as far as notes are made on it."""
    content: dict[str, Any] = {"predicates": {}, "events": {}, "ensembles": {}}
    for name, ensemble in ensembles.items():
        status = ensemble.status()
        table: dict[str, Any] = {"deadline": status.deadline}
        table["drive"] = status.drive.rate if isinstance(status.drive, FixedRate) else None
        for kind, layer in (("states", ensemble.state), ("observations", ensemble.observation)):
            factors = () if layer is None else layer.factors
            table[kind] = {factor.name: [source for source in factor.sources if source] for factor in factors}
        table["actions"] = {
            action: {"pause": binding.sequel.pause, "timeout": binding.timeout}
            | ({} if binding.ensemble is None else {"ensemble": binding.ensemble.name})
            for action, binding in zip(ensemble.action.names, ensemble.action.bindings, strict=True)
        }
        content["ensembles"][name] = table
        if ensemble.predicates is not None:
            declared = ensemble.predicates.declared
            for each, kind in declared.names.items():
                content[f"{kind}s"][each] = declared.written(each)
    return content
