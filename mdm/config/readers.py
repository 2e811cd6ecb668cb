"""Registered tables of a file: the readers of the tables of extensions, and of entries that have their keys."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from mdm.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path

    from mdm.actors import Binding, PredicateManager
    from mdm.config.functions import Functions
    from mdm.config.tables import Problems
    from mdm.config.team_file import Share
    from mdm.maps import Places
    from mdm.runtime import Extension


class Reading(NamedTuple):
    """A file that is being read, for the reader of an extension's table.

    Attributes:
        folder: The file's folder, to which paths are relative.
        predicates: Where predicates and events are declared.
        functions: Finds functions; where it does not import them, the reader makes stand-ins and loads no library.
        problems: Where problems are noted.
        share: In a team's file, whose part it is.
        virtual: Whether it is to run in virtual time: a reader that needs real time makes stand-ins then, too.
    """

    folder: Path
    predicates: PredicateManager
    functions: Functions
    problems: Problems
    share: Share | None = None
    virtual: bool = False


class TableReader:
    """Reads an extension's table in a file, and the entries of other tables that have its keys: subclass it.

    Problems are raised as `ConfigError`, or noted in the reading's ``problems``.

    Args:
        value: The extension's own table, as it is written.
        reading: The file that is being read.

    Attributes:
        entries: The keys by which an entry is known as this reader's, by where it may stand: ``predicates``,
            ``events``, ``pose`` and ``actions``. A key that such an entry has without extensions is none of them.
    """

    entries: ClassVar[Mapping[str, frozenset[str]]] = {}

    def __init__(self, value: Any, reading: Reading) -> None:
        """Read the table."""

    def predicate(self, name: str, written: dict[str, Any], key: str) -> None:
        """Declare a predicate, and sense it while the extension is open."""

    def event(self, name: str, written: dict[str, Any], key: str) -> None:
        """Declare an event, and have it occur while the extension is open."""

    def pose(self, written: dict[str, Any], places: Places, key: str) -> None:
        """Tell the places where the robot is, by `mdm.maps.Places.see`, while the extension is open."""

    def navigator(self, written: Any, key: str) -> Any:
        """Return a navigator, see `mdm.maps.Navigation`; None where problems are noted."""

    def action(self, written: dict[str, Any], key: str) -> Binding | None:
        """Return the binding of an action; None where problems are noted."""

    def extension(self) -> Extension | None:
        """Return the extension itself; asked once, at the end, where functions are imported and there is no problem.

        The runtime opens it before the system starts, and closes it behind the safe actions; a replay has none.
        """


class Readers:
    """The readers of one file.

    Args:
        document: The file's content.
        known: The keys at its top that are no extension's.
        given: The program's own readers, by the names of their tables.
        reading: The file that is being read.
    """

    def __init__(
        self, document: Mapping[str, Any], known: Collection[str], given: Mapping[str, Any], reading: Reading
    ) -> None:
        self.reading = reading
        self._given = given
        self._open: dict[str, tuple[Mapping[str, frozenset[str]], TableReader]] = {}
        for name in given.keys() & known:
            reading.problems.add(f"mdm reads the table {name!r} itself: give that of the extension another name", name)
        for name in [name for name in document if name not in known]:
            with reading.problems.collecting(name):
                if name not in self._registered:
                    keys = f"{', '.join(known)}, and of extensions {', '.join(sorted(self._registered))}"
                    raise ConfigError(f"there is no key {name!r} here; the keys are {keys}")
                kind = self._kind(name)
                reader = reading.problems.attempt(name, kind, document[name], reading)
                self._open[name] = kind.entries, reader or TableReader(None, reading)

    @cached_property
    def _registered(self) -> dict[str, Any]:
        """Each reader by its table, or where it is: of other packages, ours, and the program's own."""
        tables: dict[str, str] = resolve_name("mdm:TABLES")  # of the package itself, which names those above this one
        return {each.name: each.value for each in entry_points(group="mdm.tables")} | tables | {**self._given}

    def _kind(self, name: str) -> type[TableReader]:
        kind = self._registered[name]
        try:
            kind = resolve_name(kind) if isinstance(kind, str) else kind
        except (Exception, SystemExit) as error:
            text = f"{type(error).__name__}: {error}"
            raise ConfigError(f"the reader of the table [{name}] cannot be imported: {text}") from None
        if not (isinstance(kind, type) and issubclass(kind, TableReader)):
            raise ConfigError(f"the reader of the table [{name}] has to be a subclass of TableReader, not {kind!r}")
        return kind

    def of(self, table: str, written: object, fields: Collection[str] = ()) -> TableReader | None:
        """Return the reader of an entry of a table, by its keys but for those that it may have without one.

        Raises:
            ConfigError: If it has a key of an extension whose table is missing in the file.
        """
        unknown = written.keys() - {*fields} if isinstance(written, dict) else ()
        for entries, reader in self._open.values() if unknown else ():
            if not entries.get(table, frozenset()).isdisjoint(unknown):
                return reader
        for name in sorted(self._registered.keys() - self._open.keys()) if unknown else ():
            keys: frozenset[str] = frozenset()
            with suppress(ConfigError):  # of one that cannot be imported nothing is known
                keys = self._kind(name).entries.get(table, keys)
            if wanted := sorted(keys.intersection(unknown)):
                raise ConfigError(f"{wanted[0]!r} is a key of the extension {name!r}: give the file a table [{name}]")
        return None

    def named(self, written: object) -> TableReader | None:
        """Return the reader whose table is the one key of a table; None where that is not so.

        Raises:
            ConfigError: If that table is missing in the file.
        """
        name = next(iter(written)) if isinstance(written, dict) and len(written) == 1 else None
        if name is not None and name not in self._open and name in self._registered:
            raise ConfigError(f"{name!r} is an extension: give the file a table [{name}]")
        return self._open[name][1] if name in self._open else None

    def extensions(self) -> tuple[Extension, ...]:
        """Return the extensions themselves; none where functions are not imported."""
        opened = self._open.items() if self.reading.functions.imported else ()
        made = [self.reading.problems.attempt(name, reader.extension) for name, (_, reader) in opened]
        return tuple([extension for extension in made if extension is not None])
