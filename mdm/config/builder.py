"""Construction of actors from a TOML file; all problems are collected."""

from __future__ import annotations

import inspect
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.config.declarations import Declarations
from mdm.config.ensembles import Ensembles
from mdm.config.functions import Functions
from mdm.config.problems import Problems
from mdm.config.system import System

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["load_system"]


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
        self._functions = Functions(path.parent, self._problems, callbacks=callbacks)
        self._declarations = Declarations(self._problems)

    def system(self) -> System:
        """Return the system, or raise all problems."""
        document = self._read()
        known = ("predicates", "events", "ensembles", "tasks")
        for key in document:
            if key not in known:
                self._problems.add(f"there is no key {key!r} here; the keys are {', '.join(known)}", key)
        self._declarations.declare(document)
        builder = Ensembles(self._path.parent, self._declarations.manager, self._functions, self._problems)
        ensembles = builder.build(document)
        tasks = self._tasks(document.get("tasks", []))
        self._declarations.check()
        builder.check(ensembles)
        if builder.complete:
            self._declarations.check_ends({name for ensemble in ensembles.values() for name in ensemble.action.names})
        self._problems.raise_all()
        return System(self._declarations.manager, ensembles, tasks)

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

    def _tasks(self, references: object) -> list[Callable[[System], Any]]:
        if not isinstance(references, list) or not all(isinstance(reference, str) for reference in references):
            self._problems.add("tasks must be a list of functions, such as ['sensors:read']", "tasks")
            return []
        functions = [self._functions.find(reference, "tasks") for reference in references]
        for reference, function in zip(references, functions, strict=True):
            if function is None or not self._callbacks:
                continue
            if not inspect.iscoroutinefunction(function):
                self._problems.add(f"task {reference!r} is not an async function", "tasks")
            elif not _takes_one(function):
                self._problems.add(f"task {reference!r} must take one argument, the System", "tasks")
        return [function for function in functions if function is not None] if self._callbacks else []


def _takes_one(function: Callable[..., Any]) -> bool:
    try:
        inspect.signature(function).bind(None)
    except TypeError:
        return False
    return True
