"""The errors that the library raises, each one sentence: what, where, what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["ConfigError", "Error", "FormatError", "ModelError", "ModelWarning"]


class Error(Exception):
    """Base of every error that the library raises on purpose."""


class FormatError(Error):
    """A file is not what its format asks for.

    Args:
        message: What is wrong and what was expected.
        file: The file's path, as the caller named it.
        line: The line, counted from 1, where one can be named.
        column: The column, counted from 1, where one can be named.
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
    """A model, policy or belief is not what it claims to be."""


class ModelWarning(UserWarning):
    """A model was accepted, but not quite as it was given."""


class ConfigError(Error):
    """A configuration is wrong.

    Args:
        message: What is wrong and the way out.
        file: The configuration file, where there is one.
        key: The path of the key, such as ``ensembles.patrol.drive``.

    Attributes:
        problems: Where several things are wrong, each of them; else the error itself.
    """

    def __init__(self, message: str, *, file: str | Path | None = None, key: str | None = None) -> None:
        place = ": ".join(str(part) for part in (file, key) if part is not None)
        super().__init__(f"{place}: {message}" if place else message)
        self.message = message
        self.file = None if file is None else str(file)
        self.key = key
        self.problems: tuple[ConfigError, ...] = (self,)
