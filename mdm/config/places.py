"""Places: the map of a TOML file, whose places are predicates, and whose ways are actions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from mdm.errors import ConfigError
from mdm.maps import Navigation, Places, load_floors, load_map
from mdm.maps.places import PlacesSettings
from mdm.runtime.handler import kind_of
from mdm.runtime.supervision import describe

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.config.functions import Functions
    from mdm.config.readers import Readers
    from mdm.config.team_file import Share
    from mdm.maps import Floors, Map


class PlacesTable(PlacesSettings, frozen=True):
    """The places of a map, see `mdm.maps.load_map` and `mdm.maps.Places`; and the navigator that drives to them.

    Attributes:
        building: The file of several floors, in place of the graph and the other files of a map.
        robot: The robot's properties, by which the restrictions of a tmap2 are judged.
        navigator: A function or class that makes the navigator, ``module:name``; in a team's file it may be a table
            with one for each agent. A table whose one key is an extension's table is that extension's navigator.
        pose: A table with a key of an extension, which tells where the robot is.
    """

    graph: str | None = None
    building: str | None = None
    grid: str | None = None
    labels: str | None = None
    names: str | dict[str, int] | None = None
    reach: Annotated[float, Meta(gt=0, extra={"unit": "metres"})] | None = None
    robot: dict[str, str] | None = None
    navigator: str | dict[str, Any] | None = None
    pose: dict[str, Any] | None = None


def read_places(value: Any, readers: Readers) -> tuple[Places | None, Navigation | None]:
    """Return the places of a file, and their navigation where there is a navigator; None where there are problems.

    Args:
        value: The table ``places``.
        readers: Those of the file's extensions.
    """
    folder, predicates, functions, problems, share, _ = readers.reading
    table: PlacesTable | None = problems.convert(value, PlacesTable, "places")
    if table is None:
        return None, None
    floor = problems.attempt("places", _floor, table, folder)
    if floor is None:
        return None, None
    places = problems.attempt("places", Places, floor, predicates, **table.as_arguments(PlacesSettings))
    if places is None:
        return None, None
    if table.pose is not None:
        problems.attempt("places.pose", _see, table.pose, places, readers)
    before = len(problems)
    given = problems.attempt("places.navigator", _navigator, table.navigator, share, readers)
    if given is None and len(problems) == before:
        return places, None
    navigator = None if given is None else problems.attempt("places.navigator", _made, given, functions, readers)
    navigation = None
    if len(problems) == before:
        navigation = problems.attempt("places.navigator", Navigation, floor, navigator, places)
    if navigation is None:  # its actions are checked all the same
        navigation = problems.attempt("places", Navigation, floor, _Parked(), places)
    return (None, None) if navigation is None else (places, navigation)


def _floor(table: PlacesTable, folder: Path) -> Map | Floors:
    def path(given: str) -> Path:
        if not given or "\0" in given:
            raise ConfigError(f"the path of a file was expected, not {given!r}")
        return folder / given

    if table.building is not None:
        given = [key for key in ("graph", "grid", "labels", "names", "reach") if getattr(table, key) is not None]
        if given:
            raise ConfigError(f"a building's file names the files of its floors: leave {', '.join(given)} out")
        return load_floors(path(table.building), robot=table.robot)
    if table.graph is None:
        raise ConfigError("the required key 'graph' is missing; or give 'building', a file of several floors")
    grid, labels = (None if given is None else path(given) for given in (table.grid, table.labels))
    names = path(table.names) if isinstance(table.names, str) else table.names
    return load_map(path(table.graph), grid=grid, labels=labels, names=names, reach=table.reach, robot=table.robot)


def _see(written: dict[str, Any], places: Places, readers: Readers) -> None:
    reader = readers.of("pose", written)
    if reader is None:
        raise ConfigError("no extension of this file has these keys; code tells a pose by system.places.see(pose)")
    reader.pose(written, places, "places.pose")


def _navigator(
    given: str | dict[str, Any] | None, share: Share | None, readers: Readers
) -> str | dict[str, Any] | None:
    if not isinstance(given, dict) or readers.named(given) is not None:
        return given
    if share is None:
        raise ConfigError("a navigator per agent is for a team's file, which has a table [team]")
    return share.own(given)


def _made(reference: str | dict[str, Any], functions: Functions, readers: Readers) -> Any:
    """Return a navigator, or a stand-in for one that is not made."""
    if (reader := readers.named(reference)) is not None and isinstance(reference, dict):
        (written,) = reference.values()
        return reader.navigator(written, "places.navigator") or _Parked()
    if not isinstance(reference, str):
        raise ConfigError(f"a navigator is a function, such as 'robot:Wheels', not {reference!r}")
    make: Any = functions.find(reference, "places.navigator")
    if make is None or not functions.imported:
        return _Parked()
    kind = kind_of(make)
    if kind is not None:
        raise ConfigError(f"navigator {reference!r} cannot be made: it is {kind}, not a class or a plain function")
    try:
        return make()
    except Exception as error:
        raise ConfigError(f"navigator {reference!r} cannot be made: {describe(error)}") from error


class _Parked:
    """In place of a navigator that is not to be made, or cannot be."""

    async def go(self, goal: object) -> None:
        """Stay."""

    async def ride(self, lift: str, goal: object) -> None:
        """Stay."""
