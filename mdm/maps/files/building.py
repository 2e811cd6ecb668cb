"""Buildings: a file in TOML that names the maps of several floors, and the lifts between them.

It has a table ``[floors.NAME]`` per floor, with the paths ``map`` and ``graph`` relative to the file, and ``labels``,
``names`` or ``reach`` as `load_map` takes them; a table ``[lifts.NAME]`` per lift, with its ``stops``, the ``seconds``
from one to the next, and perhaps ``one_way``; and perhaps the ``start`` of the robot.
"""

from __future__ import annotations

import re
import tomllib
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from mdm.errors import FormatError, MapError
from mdm.formats.source import Source
from mdm.maps.files.load import load_parts
from mdm.maps.files.occupancy import image_of
from mdm.maps.map import Floors, Lift, joined
from mdm.texts import in_words

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from os import PathLike

    from mdm.maps.files.load import Parts
    from mdm.maps.graph import Graph

_Table = TypeVar("_Table", bound=msgspec.Struct)
_PLACE = re.compile(r" \(at line (\d+), column (\d+)\)")


class _FloorTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The files of a floor, relative to the building's."""

    map: str
    graph: str
    labels: str | None = None
    names: str | dict[str, int] | None = None
    reach: float | None = None


class _LiftTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    stops: list[str]
    seconds: float
    one_way: bool = False


class _Document(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    floors: dict[str, Any]
    lifts: dict[str, Any] = {}
    start: str | None = None


@dataclass(frozen=True, eq=False)
class BuildingParts:
    """The parts of a building, of which those of a floor need not fit each other.

    Args:
        floors: The parts of each floor, by its name.
        lifts: The ways between them.
        start: The place where the robot is first, where the file says so.
        maps: The file of each floor's map.
        files: All files that were read.
    """

    floors: dict[str, Parts]
    lifts: tuple[Lift, ...]
    start: str | None
    maps: dict[str, Path]
    files: tuple[Path, ...]

    @cached_property
    def graph(self) -> Graph:
        """The places and ways of all floors, and the lifts."""
        return joined({name: parts.graph for name, parts in self.floors.items()}, self.lifts)

    def whole(self) -> Floors:
        """Return the floors, if the parts of each fit each other.

        Raises:
            MapError: If they do not.
        """
        for name, parts in self.floors.items():
            if parts.problems:
                raise MapError(f"floor {name!r}: {parts.problems[0].text}")
        return Floors({name: parts.whole() for name, parts in self.floors.items()}, self.lifts, self.start)


def load_floors(path: str | PathLike[str], *, robot: Mapping[str, str] | None = None) -> Floors:
    """Load several floors and the lifts between them from a building's file, such as ``building.toml``.

    Args:
        path: The file.
        robot: The properties of the robot, as `load_map` takes them.

    Raises:
        FormatError: If the file, or one that it names, is missing or malformed, or a lift stops nowhere.
        MapError: If the files of a floor do not fit each other, or Pillow or PyYAML is missing where one is needed.
    """
    return load_building(path, robot=robot).whole()


def load_building(path: str | PathLike[str], *, robot: Mapping[str, str] | None = None) -> BuildingParts:
    """Load the parts of a building as `load_floors` does, whether or not those of a floor fit each other."""
    file = _File(Path(path))
    document = file.table(file.document, _Document)
    if not document.floors:
        raise file.error("there are no floors: name one or more", "floors")
    tables = {name: file.table(table, _FloorTable, "floors", name) for name, table in document.floors.items()}
    floors = {name: file.floor(name, table, robot) for name, table in tables.items()}
    graphs = {name: parts.graph for name, parts in floors.items()}
    lifts: list[Lift] = []
    with file.telling("floors"):
        joined(graphs, ())
    for name, given in document.lifts.items():
        table = file.table(given, _LiftTable, "lifts", name)
        with file.telling("lifts", name, "seconds" if table.seconds <= 0 else "stops"):
            lifts.append(Lift(name, tuple(table.stops), table.seconds, table.one_way))
            joined(graphs, lifts)
    maps = {name: file.source.path.parent / table.map for name, table in tables.items()}
    files = file.source.path, *file.read, *(image_of(path) for path in maps.values())
    parts = BuildingParts(floors, tuple(lifts), document.start, maps, files)
    if document.start is not None:
        with file.telling("start"):
            parts.graph.node(document.start)
    return parts


class _File:
    """A building's file, whose errors are told with their lines."""

    def __init__(self, path: Path) -> None:
        self.source = Source(path)
        self.read: list[Path] = []
        try:
            self.document = tomllib.loads(self.source.text)
        except tomllib.TOMLDecodeError as error:
            place = _PLACE.search(str(error))
            line, column = (None, None) if place is None else map(int, place.groups())
            self.source.fail(f"this is no TOML: {_PLACE.sub('', str(error))}", line=line, column=column)

    def table(self, given: Any, kind: type[_Table], *path: str) -> _Table:
        """Return a table in its type."""
        where = f"[{'.'.join(path)}]" if path else "the file"
        try:
            return msgspec.convert(given, kind)
        except msgspec.ValidationError as error:
            text, _, place = str(error).partition(" - at `$")
            inner = re.findall(r"\.(\w+)", place)
        named = re.search("`(.*)`", text)
        if named and "unknown field" in text:
            keys = ", ".join(kind.__struct_fields__)
            raise self.error(f"{where} has a key {named[1]!r}, which is none; the keys are {keys}", *path, named[1])
        if named and "missing required field" in text:
            raise self.error(f"{where} has no key {named[1]!r}, which is needed", *path)
        told = in_words(text, given, place.rstrip("`").replace("[...]", ""))
        raise self.error(f"{'.'.join((*path, *inner))}: {told}", *path, *inner)

    def floor(self, name: str, table: _FloorTable, robot: Mapping[str, str] | None) -> Parts:
        """Load the files of a floor."""

        def path(key: str, given: str) -> Path:
            if not given or "\0" in given:
                raise self.error(f"the path of a file was expected, not {given!r}", "floors", name, key)
            self.read.append(self.source.path.parent / given)
            return self.read[-1]

        grid, graph = path("map", table.map), path("graph", table.graph)
        labels = None if table.labels is None else path("labels", table.labels)
        names = path("names", table.names) if isinstance(table.names, str) else table.names
        with self.telling("floors", name):
            return load_parts(graph, grid=grid, labels=labels, names=names, reach=table.reach, robot=robot)

    @contextmanager
    def telling(self, *path: str) -> Iterator[None]:
        """Tell an error about a map, in the block, with the line of a key."""
        try:
            yield
        except MapError as error:
            raise self.error(str(error), *path) from None

    def error(self, message: str, *path: str) -> FormatError:
        """Return an error at a key, or at the nearest one above it that has a line of its own."""
        while path and path not in self._lines:
            path = path[:-1]
        return FormatError(message, file=self.source.path, line=self._lines.get(path))

    @cached_property
    def _lines(self) -> dict[tuple[str, ...], int]:
        """The line where each key is first written, as far as it has a line of its own."""
        lines: dict[tuple[str, ...], int] = {}
        header: tuple[str, ...] = ()
        for number, line in enumerate(self.source.text.split("\n"), 1):
            table = re.match(r"\s*\[\s*([^\[\]]+?)\s*\]\s*(#.*)?$", line)
            key = re.match(r"\s*((?:\"[^\"]*\"|'[^']*'|[^=\"'#])+?)\s*=", line)
            if table:
                header = path = tuple(_keys(table[1]))
            elif key:
                path = (*header, *_keys(key[1]))
            else:
                continue
            for end in range(1, len(path) + 1):
                lines.setdefault(path[:end], number)
        return lines


def _keys(text: str) -> Iterator[str]:
    """Yield the parts of a dotted key; none where it is no key."""
    try:
        inner: Any = tomllib.loads(f"{text} = 0")
    except tomllib.TOMLDecodeError:
        return
    while isinstance(inner, dict):
        (key, inner), *_ = inner.items()
        yield key
