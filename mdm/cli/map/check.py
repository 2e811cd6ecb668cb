"""``mdm map check``: find the errors in the map of a floor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.map.floor import keep, kinds, load, problem_picture, settle
from mdm.cli.report import as_json
from mdm.errors import Error
from mdm.maps.check import MARGIN, RADIUS, Problem, examine, examine_lifts, missing
from mdm.maps.files.building import load_building
from mdm.maps.files.occupancy import free_grey
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from mdm.maps.files.load import Parts

_TOLD = 10
"""Problems of a kind that are told one by one."""
_DRAWN = 50


def run(arguments: argparse.Namespace) -> int:
    """Check the map; return the exit status."""
    is_building = settle(arguments)
    if arguments.pictures is not None and Path(arguments.pictures).exists() and not Path(arguments.pictures).is_dir():
        raise Error(f"{arguments.pictures}: this is a file: give a folder for --pictures")
    radius = RADIUS if arguments.radius is None else arguments.radius
    margin = MARGIN if arguments.margin is None else arguments.margin
    if is_building:
        floors, names, problems = _check_floors(arguments, radius, margin)
    else:
        parts = load(arguments)
        floors, names, problems = {"": parts}, parts.graph.names, [*_problems(parts, arguments.map, radius, margin)]
    files = {} if arguments.pictures is None else _draw(floors, problems, Path(arguments.pictures), radius)
    backgrounds = {name: _background(parts) for name, parts in floors.items()}
    if arguments.json:
        told = [
            {"kind": each.kind, "problem": each.text, "places": each.places, "picture": files.get(index)}
            | ({"floor": each.floor} if is_building else {})
            for index, each in enumerate(problems)
        ]
        background = backgrounds if is_building else backgrounds[""]
        print(as_json({"places": names, "background": background, "problems": told}))
    else:
        _tell(problems, files)
        for name, background in backgrounds.items():
            of = f"{name}: " if name else ""
            for colour, count in background.items():
                print(f"note: {of}the colour {colour} is no place's: the background, of {count:,} cells")
        on = f" on {counted(len(floors), 'floor')}" if is_building else ""
        found = counted(len(problems), "problem") if problems else "no problems"
        print(f"{counted(len(names), 'place')}{on}, {found}")
    return 1 if problems else 0


def _check_floors(
    arguments: argparse.Namespace, radius: float, margin: float
) -> tuple[dict[str, Parts], Sequence[str], list[Problem]]:
    """Return the floors of a building, the names of all places, and the problems of all floors and lifts."""
    building = load_building(arguments.map, robot=kinds(arguments))
    problems = [
        problem.on(name)
        for name, parts in building.floors.items()
        for problem in _problems(parts, building.maps[name], radius, margin, alone=False)
    ]
    grids = {name: parts.grid for name, parts in building.floors.items()}
    problems += examine_lifts(building.graph, building.lifts, grids, radius=radius)
    return building.floors, building.graph.names, problems


def _problems(parts: Parts, path: str | Path, radius: float, margin: float, *, alone: bool = True) -> Iterator[Problem]:
    """Yield the errors of a floor, whose map has a path."""
    # Unknown cells that are free by the threshold.
    found = free_grey(path)
    if found is not None:
        grey, count, free = found
        smaller = (math.ceil((255 - grey) / 255 * 1000 - 1e-6) - 1) / 1000
        text = (
            f"free_thresh, {free:g}, makes all {count:,} cells of the grey {grey:g} free, and there are brighter ones: "
            f"is that what is unknown? Then give a smaller one: {smaller:g}"
        )
        yield Problem("greys", text, ())
    yield from parts.problems
    options: dict[str, Any] = {"radius": radius, "margin": margin, "colours": parts.colours, "alone": alone}
    yield from examine(parts.labels, parts.graph, parts.grid, **options)


def _background(parts: Parts) -> dict[int, int]:
    """Return the colours of the image of labels that are rightly no place's, with the numbers of their cells."""
    labels = parts.labels
    wrong = {*labels.strays}
    if parts.grid is not None and parts.colours is not None:
        wrong |= missing(labels, parts.grid, parts.colours).keys()
    return {colour: count for colour, count in labels.unnamed.items() if colour not in wrong}


def _tell(problems: Sequence[Problem], files: dict[int, str]) -> None:
    for kind in dict.fromkeys(problem.kind for problem in problems):
        print(kind)
        alike = [index for index, problem in enumerate(problems) if problem.kind == kind]
        for index in alike[:_TOLD]:
            print(f"  {problems[index].text}{f'  [{files[index]}]' if index in files else ''}")
        if len(alike) > _TOLD:
            print(f"  and {len(alike) - _TOLD} more")


def _draw(floors: dict[str, Parts], problems: Sequence[Problem], folder: Path, radius: float) -> dict[int, str]:
    """Draw a picture for each problem that is somewhere; return their files by the numbers of the problems."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Error(f"{folder}: the folder for --pictures cannot be made: {error.strerror}") from None
    files: dict[int, str] = {}
    for index, problem in enumerate(problems[:_DRAWN]):
        if problem.floor not in floors:
            continue  # it is about several floors
        picture = problem_picture(floors[problem.floor], problem, radius)
        if picture is not None:
            path = folder / f"{index + 1:02d}-{problem.kind}.png"
            keep(picture, path)
            files[index] = str(path)
    return files
