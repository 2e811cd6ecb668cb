"""Errors of the library. Each message is one sentence: the fault, its place, and the way out."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["ConfigError", "Error", "FormatError", "MapError", "MapWarning", "ModelError", "ModelWarning", "PolicyError"]


class Error(Exception):
    """Base of all errors of the library.

    Example::

        try:
            model = mdm.load_model(path)
        except mdm.Error as error:
            print(error)  # tiger.pomdp:9:15: -0.5 is not a probability
    """


class FormatError(Error):
    """A file cannot be read or written, or is malformed.

    Args:
        message: The fault, and the expected form.
        file: The file's path, as given by the caller.
        line: The line, from 1, if known.
        column: The column, from 1, if known.
    """

    def __init__(
        self, message: str, *, file: str | Path | None = None, line: int | None = None, column: int | None = None
    ) -> None:
        place = ":".join(str(part) for part in (file, line, column) if part is not None)
        super().__init__(f"{place}: {message}" if place else message)
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.column = column


class ModelError(Error):
    """A model, policy or belief is invalid."""


class PolicyError(ModelError):
    """A policy has raised an error of another kind, its ``__cause__``, where an action was needed."""


class MapError(Error):
    """A map, its labels or its graph is invalid, or they do not fit each other."""


class MapWarning(UserWarning):
    """A map was accepted, and something of it was changed or not read."""


class ModelWarning(UserWarning):
    """A model was accepted with a change, such as normalised probabilities."""


class ConfigError(Error):
    """A configuration is invalid.

    Args:
        message: The fault, and the way out.
        file: The configuration file, if any.
        key: The path of the key, such as ``ensembles.patrol.drive``.

    Attributes:
        problems: All problems as errors of their own; for a single problem the error itself.
    """

    def __init__(self, message: str, *, file: str | Path | None = None, key: str | None = None) -> None:
        place = ": ".join(str(part) for part in (file, key) if part is not None)
        super().__init__(f"{place}: {message}" if place else message)
        self.message = message
        self.file = None if file is None else str(file)
        self.key = key
        self.problems: tuple[ConfigError, ...] = (self,)
