"""Collection of a TOML file's problems, so that all are reported at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import ConfigError, Error, FormatError
from mdm.logic import similar
from mdm.options import misfit
from mdm.runtime.actor import TakenName

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

__all__ = ["Problems"]


class Problems:
    """The problems of a file.

    Args:
        path: The file, named in every problem.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: list[ConfigError] = []

    def __len__(self) -> int:
        return len(self._found)

    def add(self, message: str, key: str | None) -> None:
        """Add a problem with its key."""
        self._found.append(ConfigError(message, file=self._path, key=key))

    def raise_all(self) -> None:
        """Raise one error with all problems, if there are any."""
        if self._found:
            error = ConfigError("\n".join(str(problem) for problem in self._found))
            error.problems = tuple(self._found)
            raise error

    def collecting(self, key: str, *, first: bool = False) -> _Collecting:
        """Return a context manager that records an error of its block as a problem of a key and suppresses it.

        Args:
            key: The key, where the error has none of its own.
            first: Whether only the first problem of a key is recorded: the error would follow from it.
        """
        return _Collecting(self, key, first=first)

    def knows(self, key: str) -> bool:
        """Whether there is a problem of a key."""
        return any(problem.key == key for problem in self._found)

    def tables(self, document: dict[str, Any], key: str) -> list[tuple[str, Any]]:
        """Return the tables below a key by their names; a problem where there is something else."""
        tables = document.get(key, {})
        if not isinstance(tables, dict):
            self.add(f"{key} must be a table with a key per name", key)
            return []
        return list(tables.items())

    def convert(self, value: Any, kind: Any, key: str, *, partly: bool = False) -> Any:
        """Return a table as a struct; if it has problems None, or with ``partly`` a struct of its valid keys."""
        before = len(self)
        dropped: set[str] = set()
        while True:
            try:
                struct = msgspec.convert(value, kind)
            except msgspec.ValidationError as error:
                field = self._add_invalid(error, value, kind, key, dropped)
                if field is None or not isinstance(value, dict) or field not in value:
                    return None
                dropped.add(field)
                value = {name: inner for name, inner in value.items() if name != field}
            else:
                return struct if partly or len(self) == before else None

    def _add_invalid(
        self, error: msgspec.ValidationError, value: Any, kind: Any, key: str, dropped: set[str]
    ) -> str | None:
        """Add msgspec's error in our words; return the field concerned."""
        text = str(error)
        if "unknown field" in text:
            field, fields = text.split("`")[1], kind.__struct_fields__
            hint = similar(field, fields) or f"; the keys are {', '.join(fields)}"
            self.add(f"there is no key {field!r} here{hint}", f"{key}.{field}")
            return field
        if "missing required field" in text:
            field = text.split("`")[1]
            if field not in dropped:
                self.add(f"the required key {field!r} is missing", key)
            return None
        words, place = misfit(error, value, kind)
        self.add(words, f"{key}{place}")
        return place.removeprefix(".").partition("[")[0] or None


class _Collecting:
    """Records an error of its block as a problem of a key and suppresses it."""

    def __init__(self, problems: Problems, key: str, *, first: bool) -> None:
        self._problems = problems
        self._key = key
        self._first = first

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        if isinstance(error, ConfigError):
            inner = error.key or ""
            key = inner if inner.startswith(("ensembles.", "team.")) else self._key
            if not (self._first and self._problems.knows(key)):
                self._problems.add(error.message, key)
        elif isinstance(error, FormatError):
            place = f" (column {error.column})" if error.file is None and error.column is not None else ""
            self._problems.add(f"{error if error.file else error.message}{place}", self._key)
        elif isinstance(error, TakenName):
            text = f"an ensemble cannot be called {error.name!r}, as an actor beside it is: give it another name"
            self._problems.add(text, f"ensembles.{error.name}")
        elif isinstance(error, Error):
            self._problems.add(str(error), self._key)
        return isinstance(error, Error)
