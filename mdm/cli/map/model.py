"""``mdm map model``: a model of a robot that goes the ways of a map."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.cli.map import DISCOUNT, RADIUS, STAGES, SUCCESS
from mdm.cli.map.floor import inputs, kinds, load, settle
from mdm.cli.report import as_json, columns
from mdm.cli.usage import UsageError, finite
from mdm.config.functions import find_function
from mdm.errors import Error
from mdm.formats import save_durations, save_model, save_policy
from mdm.formats.target import check_place, write_text
from mdm.maps import Floors, Map
from mdm.maps.files.building import load_building
from mdm.maps.graph import tour
from mdm.maps.model import FloorFactor, arrivals, durations, latch, model, sightings, visits
from mdm.models.units import in_words
from mdm.solvers import solve

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from mdm.maps import Graph
    from mdm.models import Durations, FactoredMDP, FactoredPOMDP
    from mdm.models.matrices import Vector
    from mdm.models.units import Unit

_SUFFIXES = (".pomdpx", ".pgmx", ".npz")
_SOLVING = 30.0
"""Seconds for the policy of a robot's file, at most."""
_PROGRAM = '''"""The parts of a robot that is not there: it drives straight to its goals. Put those of yours here."""

import asyncio
import math

from mdm.maps import Pose


class Wheels:
    """Drives at half a metre a second, and rides lifts in ten seconds."""

    at = Pose(AT)

    async def go(self, goal):
        while (left := math.dist((Wheels.at.x, Wheels.at.y), (goal.x, goal.y))) > 0.01:
            part = min(0.05 / left, 1.0)
            x, y = Wheels.at.x + part * (goal.x - Wheels.at.x), Wheels.at.y + part * (goal.y - Wheels.at.y)
            Wheels.at = Pose(x, y, floor=Wheels.at.floor)
            await asyncio.sleep(0.1)

    async def ride(self, lift, goal):
        await asyncio.sleep(10)
        Wheels.at = goal


async def localise(system):
    """Tell the pose ten times a second."""
    while True:
        system.places.see(Wheels.at)
        await asyncio.sleep(0.1)
'''
_SPEED = 0.5
"""Metres a second by which a tour of several floors weighs driving against lifts, if nobody says another speed."""


def run(arguments: argparse.Namespace) -> int:
    """Make the model; return the exit status."""
    is_building = settle(arguments)
    arguments.robot = next((each for each in arguments.kinds if "=" not in each), None)  # the file to write
    _check_usage(arguments)
    _check_robot(arguments)
    floor: Map | Floors
    if is_building:
        building = load_building(arguments.map, robot=kinds(arguments))
        if arguments.start is None:
            arguments.start = building.start
        floor, files = building.whole(), [*map(str, building.files)]
    else:
        floor, files = load(arguments).whole(), inputs(arguments)
    for target in (arguments.output, arguments.durations, arguments.robot):
        if target is not None:
            check_place(target, *files)
    taken = None
    if arguments.speed is not None:
        taken = arrivals(floor, speed=arguments.speed, radius=_given(arguments.radius, RADIUS))
    tour = _tour(arguments, floor)
    made = _made(arguments, floor, taken, tour)
    save_model(made, arguments.output)
    lasting = None
    if arguments.durations is not None and taken is not None:
        lasting = durations(made, taken, stages=_given(arguments.stages, STAGES))
        save_durations(lasting, arguments.durations)
    unsolved = None
    if arguments.robot is not None:
        latches = [(name, *_places(floor.graph, places)[:2]) for name, places in arguments.latches]
        write_text(arguments.robot, _robot_text(arguments, floor.graph, tour, latches))
        unsolved = _write_parts(arguments, floor.graph, made, lasting)
    facts = {**_facts(arguments, made, floor.graph, taken), "tour": list(tour), "unsolved": unsolved}
    if arguments.json:
        print(as_json(facts))
    else:
        _tell(facts)
    return 0


def _write_parts(
    arguments: argparse.Namespace, graph: Graph, made: FactoredMDP | FactoredPOMDP, lasting: Durations | None
) -> str | None:
    """Write the policy that a robot's file names, and a ``robot.py`` without a robot where there is none yet.

    Returns:
        Why there is no policy, in words; None where there is one.
    """
    asked, unsolved = arguments.interruption.asked, None
    try:
        with arguments.interruption.deferred():
            found = solve(made, durations=lasting, time=_SOLVING, progress=lambda _: bool(asked()))
        save_policy(found.policy, Path(arguments.output).with_suffix(".policy"), made)
    except Error as error:  # such as a discount of 1
        unsolved = str(error)
    program = Path(arguments.robot).parent / "robot.py"
    if not program.exists():
        goal = graph.node(arguments.start or graph.names[0]).goal
        at = f"{goal.x!r}, {goal.y!r}" + (f", floor={goal.floor!r}" if goal.floor else "")
        write_text(program, _PROGRAM.replace("AT", at))
    return unsolved


def _check_usage(arguments: argparse.Namespace) -> None:
    """Refuse arguments that contradict each other."""
    if Path(arguments.output).suffix.lower() not in _SUFFIXES:
        raise Error(f"{arguments.output}: models of maps are written as {', '.join(_SUFFIXES[:-1])} or {_SUFFIXES[-1]}")
    speed, period, kept = arguments.speed, arguments.period, arguments.durations
    refused = {
        "--period needs --speed: how long do ways take?": speed is None and period is not None,
        "--durations needs --speed": speed is None and kept is not None,
        "--speed needs --period, for decisions at a fixed rate, or --durations, for decisions after each action": (
            speed is not None and period is None and kept is None
        ),
        "--period is for decisions at a fixed rate, --durations for decisions after each action: give one": (
            period is not None and kept is not None
        ),
        "with --period the speed tells the probabilities of success: leave --success out": (
            period is not None and arguments.success is not None
        ),
        "--stages is for --durations": arguments.stages is not None and kept is None,
        "--radius is for --speed, --noise and --visit": (
            arguments.radius is not None and speed is None and arguments.noise is None and not arguments.visits
        ),
        "--durations writes an archive: its file ends in .npz": (
            kept is not None and Path(kept).suffix.lower() != ".npz"
        ),
        "--durations and -o are the same file": (
            kept is not None and Path(kept).resolve() == Path(arguments.output).resolve()
        ),
        "with a --discount of 1 time costs nothing: leave --durations out": (
            kept is not None and arguments.discount == 1
        ),
    }
    for why, is_so in refused.items():
        if is_so:
            raise UsageError(why)
    for option, names in (("latch", arguments.latches), ("reward", arguments.rewards)):
        given = [name for name, _ in names]
        twice = [name for index, name in enumerate(given) if name in given[:index]]
        if twice:
            raise UsageError(f"--{option} is given twice for {twice[0]!r}")


def _made(
    arguments: argparse.Namespace, floor: Map | Floors, taken: Vector | None, tour: Sequence[str]
) -> FactoredMDP | FactoredPOMDP:
    """Return the model."""
    success: float | Vector = _given(arguments.success, SUCCESS)
    if taken is not None and arguments.period is not None:
        success = np.minimum(arguments.period / taken, 1.0)
    seen = None
    if arguments.noise is not None:
        seen = sightings(floor, arguments.noise, radius=_given(arguments.radius, RADIUS))
    made = model(
        floor.graph,
        factors=_factors(arguments, floor.graph, tour),
        success=success,
        rewards=dict(arguments.rewards),
        sightings=seen,
        discount=_given(arguments.discount, DISCOUNT),
        start=arguments.start,
        stay=arguments.stay,
    )
    of: Unit = "step" if arguments.period is None else arguments.period
    return made.with_discount(made.discount, of=of if arguments.durations is None else "second")


def _tour(arguments: argparse.Namespace, floor: Map | Floors) -> tuple[str, ...]:
    """Return the places to come to in the order of a tour; none where none are given."""
    graph, given = floor.graph, arguments.visits
    if not given:
        return ()
    lengths = None
    if isinstance(floor, Floors) or floor.grid is not None:
        # Of a floor the shortest tour is the quickest one, whatever the speed; lifts take what they take.
        speed = _given(arguments.speed, _SPEED) if isinstance(floor, Floors) else 1.0
        taken = arrivals(floor, speed=speed, radius=_given(arguments.radius, RADIUS))
        lengths = {
            (edge.source, edge.target): float(taken[graph.names.index(edge.source), graph.labels.index(edge.label)])
            for edge in graph.edges
        }
    everywhere = given == ["all"] and "all" not in graph.names
    return tour(graph, None if everywhere else given, lengths)


def _factors(arguments: argparse.Namespace, graph: Graph, tour: Sequence[str]) -> list[FloorFactor]:
    """Return the factors beside the place: latches, then those of the user's function."""
    factors = []
    if tour:
        factors.append(visits(graph, tour))
    for name, text in arguments.latches:
        on, off, reward = _places(graph, text)
        if on == off:
            raise UsageError(f"--latch: {name!r} would be switched on and off in {on!r}: give it two places")
        factors.append(latch(graph, name, on=on, off=off, reward=reward))
    reference = arguments.factors
    if reference is None:
        return factors
    function = find_function(reference, Path(arguments.graph or arguments.map).parent)
    try:
        returned = function(graph)
        own = [returned] if isinstance(returned, FloorFactor) else None if returned is None else list(returned)
    except (Exception, SystemExit) as error:
        raise Error(f"{reference} fails: {type(error).__name__}: {error}") from error
    if own is None:
        raise Error(f"{reference} returns nothing: give FloorFactor objects")
    for factor in own:
        if not isinstance(factor, FloorFactor):
            raise Error(f"{reference} returns a {type(factor).__name__} among its factors: give FloorFactor objects")
    return factors + own


def _places(graph: Graph, text: str) -> tuple[str, str, float]:
    """Return the two places of a latch and its reward; names of places may have slashes and colons, too."""
    readings = [(text, 1.0)]
    body, colon, number = text.rpartition(":")
    if colon and (reward := finite(number)) is not None:
        readings.insert(0, (body, reward))
    for places, reward in reversed(readings):
        for place in (index for index, letter in enumerate(places) if letter == "/"):
            if places[:place] in graph.names and places[place + 1 :] in graph.names:
                return places[:place], places[place + 1 :], reward
    on, _, off = readings[0][0].partition("/")
    return graph.node(on).name, graph.node(off).name, readings[0][1]  # one of them raises


def _facts(
    arguments: argparse.Namespace, made: FactoredMDP | FactoredPOMDP, graph: Graph, taken: Vector | None
) -> dict[str, Any]:
    """Return the model's description, ready for JSON."""
    ways = []
    for edge in graph.edges if taken is not None else ():
        assert taken is not None
        time = float(taken[graph.names.index(edge.source), graph.labels.index(edge.label)])
        chance = _given(arguments.success, SUCCESS) if arguments.period is None else min(arguments.period / time, 1.0)
        ways.append({"from": edge.source, "label": edge.label, "to": edge.target, "seconds": time, "success": chance})
    return {
        "model": arguments.output,
        "durations": arguments.durations,
        "robot": arguments.robot,
        "policy": None if arguments.robot is None else str(Path(arguments.output).with_suffix(".policy")),
        "kind": made.kind,
        "states": len(made.state_space),
        "factors": {factor.name: len(factor) for factor in made.state_space.factors},
        "actions": list(made.action_space.factors[0].names),
        "discount": made.discount,
        "discount_of": in_words(made.discount_of),
        "ways": ways,
        "earns": bool(arguments.visits or arguments.rewards or arguments.latches or arguments.factors),
    }


def _tell(facts: dict[str, Any]) -> None:
    factors = ", ".join(f"{name} ({size})" for name, size in facts["factors"].items())
    print(f"states    {facts['states']}: {factors}")
    print(f"actions   {', '.join(facts['actions'])}")
    print(f"discount  {facts['discount']:g} of {facts['discount_of']}")
    if facts["ways"]:
        rows = [("way", "seconds", "success")]
        for way in facts["ways"]:
            name = f"{way['from']}, {way['label']}: {way['to']}"
            rows.append((name, f"{way['seconds']:.1f}", f"{way['success']:.3g}"))
        print("\n".join(["", *columns(rows, {1, 2}), ""]))
    if facts["tour"]:
        places = ", ".join(f'"{name}"' for name in facts["tour"])
        print(f"tour      {', '.join(facts['tour'])}, and so on")
        if facts["robot"] is None:
            print(f"note: for the factor 'next', write into the table [places] of a TOML file: tour = [{places}]")
    if not facts["earns"]:
        print("note: nothing is earned in it, so that nothing is better than to do nothing: see --reward and --latch")
    if facts["durations"] is not None:
        print(f"{facts['durations']}: how long its actions take; solve it with mdm solve --durations")
    print(f"{facts['model']}: a model ({facts['kind']})")
    if facts["robot"] is not None:
        if facts["unsolved"] is None:
            print(f"{facts['policy']}: its policy; mdm solve makes one with bounds of your own")
        needed = "with" if facts["unsolved"] is None else f"once mdm solve has made {facts['policy']}, with"
        print(f"{facts['robot']}: a robot that does this, {needed} the parts in robot.py beside it")
        if facts["unsolved"] is not None:
            print(f"note: there is no policy yet: {facts['unsolved']}")


def _given(value: Any, default: Any) -> Any:
    return default if value is None else value


def _check_robot(arguments: argparse.Namespace) -> None:
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


def _robot_text(
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
