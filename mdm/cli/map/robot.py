"""The TOML file of a robot that acts by a model of a map: its places, states and actions."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.map.floor import kinds
from mdm.cli.usage import UsageError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from mdm.maps import Graph

__all__ = ["check", "text"]


def check(arguments: argparse.Namespace) -> None:
    """Refuse a file that could not express the model."""
    if arguments.robot is None:
        return
    for given, why in (
        (Path(arguments.robot).suffix.lower() != ".toml", "its file ends in .toml"),
        (arguments.noise is not None, "places that are seen with --noise make beliefs: leave one of them out"),
        (arguments.factors is not None, "only you know which predicates your --factors are: leave one of them out"),
        (arguments.stay is not None, "an action that stays is none of the map's: leave --stay out"),
    ):
        if given:
            raise UsageError(f"--robot: {why}")


def text(
    arguments: argparse.Namespace, graph: Graph, tour: Sequence[str], latches: Sequence[tuple[str, str, str]]
) -> str:
    """Return the file.

    Args:
        arguments: Those of ``mdm map model``.
        graph: The places and ways.
        tour: The places to come to one after the other, where there are some.
        latches: The name of each latch, and the places that switch it on and off.
    """
    folder = Path(arguments.robot).parent
    model = Path(arguments.output)

    def path(given: str | Path) -> str:
        return _quoted(Path(os.path.relpath(given, folder)).as_posix())

    lines = [
        "# A robot on a map, as `mdm map model` has written it. In robot.py are its own parts: `localise`, which tells",
        "# poses by `system.places.see(pose)`, and `Wheels`, whose `go(goal)` drives"
        + ("." if arguments.graph is not None else ", and whose `ride(lift, goal)` takes lifts."),
        'tasks = ["robot:localise"]',
        "",
        "[places]",
    ]
    if arguments.graph is None:
        lines.append(f"building = {path(arguments.map)}")
    else:
        lines += [f"graph = {path(arguments.graph)}", f"grid = {path(arguments.map)}"]
    lines += [f"{key} = {path(given)}" for key in ("labels", "names") if (given := getattr(arguments, key)) is not None]
    if arguments.reach is not None:
        lines.append(f"reach = {arguments.reach!r}")
    if robot := kinds(arguments):
        lines.append(
            f"robot = {{ {', '.join(f'{_quoted(kind)} = {_quoted(value)}' for kind, value in robot.items())} }}"
        )
    if tour:
        lines.append(f"tour = [{', '.join(map(_quoted, tour))}]")
    lines += ['navigator = "robot:Wheels"', ""]
    if latches:
        lines.append("[predicates]")
        lines += [f"{_quoted(name)} = {{ set = {_reached(on)}, reset = {_reached(off)} }}" for name, on, off in latches]
        lines.append("")
    lines += ["[ensembles.patrol]", f"model = {path(model)}", f"policy = {path(model.with_suffix('.policy'))}"]
    lines.append('on_failed_action = "decide"                  # again, after a pause')
    if arguments.period is not None:
        lines.append(f"drive = {1 / arguments.period!r}")
    lines += ["", "[ensembles.patrol.states.position]", *_table((name, f"{name}.reached") for name in graph.names)]
    if tour:
        lines += ["", "[ensembles.patrol.states.next]", *_table((name, f"{name}.next") for name in tour)]
    for name, _, _ in latches:
        lines += ["", f"[ensembles.patrol.states.{_quoted(name)}]", *_table([("yes", name)])]
    lines += ["", "[ensembles.patrol.actions]"]
    then = "" if arguments.period is not None else ', then = "decide"'
    lines += [f"{_quoted(label)} = {{ way = {_quoted(label)}{then} }}" for label in graph.labels]
    return "\n".join([*lines, ""])


def _table(rows: Iterable[tuple[str, str]]) -> list[str]:
    return [f"{_quoted(key)} = {_quoted(value)}" for key, value in rows]


def _reached(place: str) -> str:
    """Return the formula for a place that is reached, as a text of TOML."""
    return "'\"" + place + ".reached\"'" if '"' not in place and "'" not in place else _quoted(f"{place}.reached")


def _quoted(given: str) -> str:
    """Return a basic string of TOML, whose escapes are those of JSON."""
    return json.dumps(given, ensure_ascii=False)
