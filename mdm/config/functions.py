"""Lookup of functions that a TOML file names as ``module:name``."""

from __future__ import annotations

import asyncio
import importlib
import inspect
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

from mdm.config.objects import made
from mdm.config.sources import look_for, named_in, refuse_shadowed
from mdm.errors import ConfigError
from mdm.logic import similar

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mdm.config.problems import Problems
    from mdm.models import MDP

__all__ = ["Functions", "Lasting", "Unseen", "find_function", "nothing"]


class Functions:
    """Finds the functions that a file names, and notes problems.

    Args:
        folder: The file's folder, whose modules take precedence.
        problems: Where problems are noted.
        callbacks: Whether functions are imported; otherwise each is one that does nothing, for as long as somebody says
            where the source of its module says that it is async.
        look: Whether functions that are not imported are looked for in the source of their modules; each is then one
            of that name, kind and arguments, or an `Unseen` one where the source does not tell.
    """

    def __init__(self, folder: Path, problems: Problems, *, callbacks: bool, look: bool = False) -> None:
        self._folder = folder
        self._problems = problems
        self._callbacks = callbacks
        self._look = look

    @property
    def imported(self) -> bool:
        """Whether the functions found are those that the file names, and not stand-ins that do nothing."""
        return self._callbacks

    @property
    def looks(self) -> bool:
        """Whether no module is to be run at all."""
        return self._look

    def make(self, reference: str, key: str, model: MDP | None) -> Any:
        """Return what the class or function ``module:name`` makes; None where there is none, or no module is run."""
        with self._problems.collecting(key):
            if self._look:
                look_for(reference, self._folder)
                return None
            return made(find_function(reference, self._folder), reference, model)
        return None

    def find(self, reference: str, key: str) -> Callable[..., Any] | None:
        """Return the function named ``module:name``; None where there is none, which is noted with its key."""
        with self._problems.collecting(key):
            if self._callbacks:
                return find_function(reference, self._folder)
            if self._look:
                return look_for(reference, self._folder) or Unseen(reference)
            with suppress(ConfigError):  # nothing need be there
                if inspect.iscoroutinefunction(look_for(reference, self._folder)):
                    return Lasting()
            return nothing
        return None


def find_function(reference: str, folder: Path) -> Callable[..., Any]:
    """Return the function ``module:name`` or ``module:object.name``; modules beside the file take precedence.

    Raises:
        ConfigError: If there is no such module or function, the module cannot be imported, or another module of that
            name is already loaded.
    """
    module_name, attribute = named_in(reference)
    place = str(folder.resolve())
    if place not in sys.path:
        sys.path.insert(0, place)
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = repr(error.name) if error.name == module_name else f"{error.name!r}, which {module_name!r} imports"
        raise ConfigError(f"there is no module {missing}; the file's folder is searched first") from None
    except (Exception, SystemExit) as error:
        raise ConfigError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from None
    refuse_shadowed(module_name.partition(".")[0], folder.resolve())
    function: Any = module
    for part in attribute.split("."):
        names = [name for name in dir(function) if not name.startswith("_")]
        function = getattr(function, part, None)
        if function is None:
            raise ConfigError(f"module {module_name!r} has no {attribute!r}{similar(part, names)}")
    if not callable(function):
        raise ConfigError(f"{reference!r} is a {type(function).__name__}, not a function")
    return cast("Callable[..., Any]", function)


class Lasting:
    """Stands for an async function that is not to be called: it lasts until somebody says how it ends."""

    def __init__(self) -> None:
        self._ends: list[asyncio.Future[None]] = []

    async def __call__(self) -> None:
        """Do nothing until the end."""
        end = asyncio.get_running_loop().create_future()
        self._ends.append(end)
        try:
            await end
        finally:
            self._ends.remove(end)

    def end(self, error: Exception | None = None) -> None:
        """End all that last: they fail with an error, where one is given."""
        for end in self._ends:
            if not end.done() and error is None:
                end.set_result(None)
            elif not end.done() and error is not None:
                end.set_exception(error)


class Unseen:
    """Stands for a function whose kind and arguments are not known without its module being run.

    Args:
        reference: The function, ``module:name``.
    """

    def __init__(self, reference: str) -> None:
        self.__module__, _, self.__qualname__ = reference.partition(":")
        self.__name__ = self.__qualname__.rpartition(".")[2]

    def __call__(self) -> None:
        """Do nothing."""


def nothing() -> None:
    """Do nothing, in place of a function that is not to be called."""
