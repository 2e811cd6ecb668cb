"""The scene of a run: what does not change while one looks at it, and is sent once."""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["EnsembleScene", "FactorScene", "FloorScene", "PlaceScene", "PredicateScene", "Scene", "WayScene"]


class FactorScene(msgspec.Struct, frozen=True):
    """A factor of states.

    Attributes:
        name: Its name.
        symbols: The names of its symbols, where there are few enough to list.
        told_by: The predicates that tell it, where an ensemble has a state layer and they are few.
    """

    name: str
    symbols: tuple[str, ...]
    told_by: tuple[str, ...] = ()


class EnsembleScene(msgspec.Struct, frozen=True):
    """An ensemble.

    Attributes:
        path: Its path among actors.
        parent: The place of the ensemble above it in the scene; -1 at the top.
        bound: The action of that one that it is bound to; empty at the top.
        summary: The kind of its process, in a few words.
        actions: The names of its actions, in their order.
        states: How many states there are; 0 where that is not known.
        factors: The factors of its states.
        grid: Whether two factors of the states are the rows and columns of a grid.
    """

    path: str
    parent: int
    bound: str
    summary: str
    actions: tuple[str, ...] = ()
    states: int = 0
    factors: tuple[FactorScene, ...] = ()
    grid: bool = False


class PredicateScene(msgspec.Struct, frozen=True):
    """A predicate: its name, how it is defined, and whether the page may set it, for no sensor tells it."""

    name: str
    definition: str
    settable: bool = False


class PlaceScene(msgspec.Struct, frozen=True):
    """A place of a floor: its name, and its goal by rows and columns of the raster, with fractions."""

    name: str
    row: float
    column: float


class WayScene(msgspec.Struct, frozen=True):
    """A way from a place to another one, by their names, with its label."""

    source: str
    target: str
    label: str


class FloorScene(msgspec.Struct, frozen=True):
    """A floor: its raster, and the places on it.

    Attributes:
        name: Empty where there is but one.
        rows: Of the raster, from top to bottom.
        columns: Of the raster, from left to right.
        metres: The width of a cell.
        raster: A byte a cell, row by row: 0 of no place, 255 occupied, else the place's number from 1 on.
        places: The places with their goals, in the order of their numbers.
        ways: The ways between them.
    """

    name: str
    rows: int
    columns: int
    metres: float
    raster: bytes
    places: tuple[PlaceScene, ...]
    ways: tuple[WayScene, ...]


class Scene(msgspec.Struct, frozen=True):
    """A run, as far as it stays as it is.

    Attributes:
        version: Of the library; a page of another one is loaded anew.
        source: A running system, or a record.
        title: Of the run, such as a file's name.
        began: The time in nanoseconds since 1970 of second 0, 0 where that is not known.
        first: Of a record, its first second.
        last: Of a record, its last second.
        ensembles: All ensembles, each behind the one above it.
        predicates: All predicates.
        floors: The floors of the robot's map.
        control: Whether commands are taken.
        remarks: What should be known of the run, such as that its record is torn.
    """

    version: str
    source: Literal["live", "record"]
    title: str
    began: int
    first: float
    last: float
    ensembles: tuple[EnsembleScene, ...]
    predicates: tuple[PredicateScene, ...]
    floors: tuple[FloorScene, ...] = ()
    control: bool = False
    remarks: tuple[str, ...] = ()
