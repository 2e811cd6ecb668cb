"""``mdm map``: verbs that propose, draft, check and show the map of a floor, or make a model of it."""

from __future__ import annotations

import argparse
import math
from typing import Any

from mdm.cli.usage import add_discount, add_verb, complete, count, finite, seconds

__all__ = ["DISCOUNT", "RADIUS", "STAGES", "SUCCESS", "VERBS", "add_map"]

SUCCESS, DISCOUNT, STAGES, RADIUS = 0.9, 0.95, 4, 0.25
"""Of a model: the probability that a way is gone in a step, its discount, stages of durations, metres of a robot."""

VERBS = {
    "goals": "propose rooms, goals and ways from a map alone",
    "draft": "draft the labels of a map from the goals of its graph",
    "check": "list what is wrong with a map",
    "show": "show the places and ways of a map",
    "model": "make a model of a robot that goes the ways of a map",
}
"""The verbs, and a line of help for each."""


def add_map(verbs: Any, line: str) -> None:
    """Add the verb, its own verbs and their arguments."""
    about = (
        "Propose, draft, check and show the map of a floor: its grid, the labels of its places, their graph; and make "
        "a model from it, which mdm solve takes."
    )
    parser = add_verb(verbs, "map", line, about, "mdm map show map.yaml labels.png graph.xml -o floor.png")
    kinds = parser.add_subparsers(dest="map_verb", metavar="VERB", required=True)
    for name, add in zip(VERBS, (_add_goals, _add_draft, _add_check, _add_show, _add_model), strict=True):
        kind = add(kinds, VERBS[name])
        kind.add_argument("--json", action="store_true", help="one JSON object")
        complete(kind, f"map {name}", f"mdm.cli.map.{name}")


def _add_goals(verbs: Any, line: str) -> argparse.ArgumentParser:
    about = (
        "Divide a map at its doors into rooms, put a goal into each where the robot fits well, and lead ways through "
        "the doors; and write this as a graph. It is a proposal: rename the rooms, move goals, leave rooms out or add "
        "some; then see mdm map draft, which divides the map by them. mdm map show tells coordinates."
    )
    parser = add_verb(verbs, "goals", line, about, "mdm map goals map.yaml -o graph.xml --picture rooms.png")
    parser.add_argument("map", metavar="MAP.yaml", help="ROS's map.yaml, whose image is a PGM, PNG or BMP")
    parser.add_argument(
        "-o", "--output", metavar="GRAPH.xml", required=True, help="the graph, as the original's TopologicalMap"
    )
    _add_robot(parser)
    parser.add_argument(
        "--least",
        metavar="M2",
        type=_metres,
        help="the least area of a room, in square metres of where a robot fits (4)",
    )
    parser.add_argument("--picture", metavar="PNG", help="draw the rooms into a file (needs mdm[maps])")
    return parser


def _add_draft(verbs: Any, line: str) -> argparse.ArgumentParser:
    about = (
        "Divide a map into the places of a graph, whose goals say where they are, and write an image with a colour for "
        "each place. It is a draft: rooms are divided at narrow passages, and where there is none, the border is a "
        "convention. Correct it in a paint program, then see mdm map check."
    )
    parser = add_verb(verbs, "draft", line, about, "mdm map draft map.yaml graph.xml -o labels.png")
    parser.add_argument("map", metavar="MAP.yaml", help="ROS's map.yaml, whose image is a PGM, PNG or BMP")
    parser.add_argument(
        "graph",
        metavar="GRAPH",
        help="the original's TopologicalMap (XML), LCAS's tmap2 (YAML), or Nav2's route graph (GeoJSON)",
    )
    _add_kinds(parser)
    parser.add_argument(
        "-o", "--output", metavar="LABELS.png", required=True, help="the image of labels (needs mdm[maps])"
    )
    return parser


def _add_check(verbs: Any, line: str) -> argparse.ArgumentParser:
    about = (
        "List what is wrong with a map: goals that are not in their own place, or where the robot does not fit; places "
        "that are nowhere deep enough to be entered; ways between places that do not touch, or by a passage that is "
        "too narrow; places that touch and have no way; places that cannot be reached from each other; stray colours, "
        "and two names of one colour. Of a building's floors also: lifts that stop where the robot does not fit. The "
        "exit status is 1 where something is wrong."
    )
    parser = add_verb(
        verbs, "check", line, about, "mdm map check map.yaml labels.png graph.xml --radius 0.3 --pictures problems"
    )
    _add_floor(parser)
    _add_robot(parser)
    parser.add_argument(
        "--pictures", metavar="DIR", help="a folder for a picture of each problem, of the first 50 (needs mdm[maps])"
    )
    return parser


def _add_show(verbs: Any, line: str) -> argparse.ArgumentParser:
    about = (
        "Show a map: its places with their areas, goals and ways, and how wide the passages between them are. A "
        "passage's width is twice its largest clearance, true to a cell. Without a graph, show the map alone with "
        "lines of coordinates, by which goals can be chosen. Of a building show each floor, and where lifts lead."
    )
    parser = add_verb(verbs, "show", line, about, "mdm map show map.yaml labels.png graph.xml -o floor.png")
    _add_floor(parser)
    parser.add_argument("-o", "--output", metavar="PNG", help="draw the map into a file (needs mdm[maps])")
    parser.add_argument(
        "--radius", metavar="M", type=_metres, help="leave out passages that are too narrow for a robot of this radius"
    )
    parser.add_argument("--coordinates", action="store_true", help="draw lines of coordinates, too")
    return parser


def _add_model(verbs: Any, line: str) -> argparse.ArgumentParser:
    about = (
        "Make a model whose states are the places of a map, with latches and factors of your own, and whose actions "
        "are the labels of its ways: a way is gone in a step with a probability of success, or else the robot stays. "
        "With --noise it is a POMDP, whose observations are the places that are seen. How long ways take is known from "
        "the lengths of their paths with --speed: for decisions at a fixed rate (--period) as probabilities of "
        "success, or for decisions after each action as durations, which mdm solve --durations takes."
    )
    parser = add_verb(
        verbs,
        "model",
        line,
        about,
        "mdm map model map.yaml labels.png graph.xml --latch half=Hall/Kitchen -o patrol.npz",
    )
    _add_floor(parser, "; or a FILE.toml to write, of a robot that does this, which mdm run takes")
    parser.add_argument("-o", "--output", metavar="MODEL", required=True, help="the model: .pomdpx, .pgmx or .npz")
    parser.add_argument("--reward", metavar="PLACE=VALUE", action="append", default=[], type=_reward, dest="rewards")
    parser.add_argument(
        "--latch",
        metavar="NAME=ON/OFF[:REWARD]",
        action="append",
        default=[],
        type=_latch,
        dest="latches",
        help="a factor that is 'yes' from the place ON to the place OFF, else 'no'; each change earns the reward (1)",
    )
    parser.add_argument(
        "--visit",
        metavar="PLACE",
        action="append",
        default=[],
        dest="visits",
        help="a place to come to again and again, in the order of a short tour (the factor 'next'); 'all' for all",
    )
    parser.add_argument(
        "--factors",
        metavar="MODULE:FUNCTION",
        help="a function of the graph that returns more factors (mdm.maps.model.FloorFactor); modules beside GRAPH "
        "take precedence",
    )
    parser.add_argument("--start", metavar="PLACE", help="where the robot is first; by default it may be anywhere")
    parser.add_argument("--stay", metavar="NAME", help="one more action, which stays at no cost")
    parser.add_argument(
        "--success", metavar="P", type=_probability, help=f"the probability that a way is gone in a step ({SUCCESS})"
    )
    add_discount(parser, f"of a step, with --durations of a second ({DISCOUNT})")
    parser.add_argument("--noise", metavar="M", type=_metres, help="the standard deviation of poses, in metres")
    parser.add_argument("--speed", metavar="M/S", type=_speed, help="of the robot, in metres a second")
    parser.add_argument("--period", metavar="S", type=seconds, help="the seconds between decisions at a fixed rate")
    parser.add_argument("--durations", metavar="FILE.npz", help="write how long actions take")
    parser.add_argument(
        "--stages", metavar="N", type=count, help=f"the more, the less durations vary: Erlang's stages ({STAGES})"
    )
    parser.add_argument("--radius", metavar="M", type=_metres, help=f"the radius of the robot, in metres ({RADIUS})")
    return parser


def _probability(text: str) -> float:
    number = finite(text)
    if number is None or not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"a number above 0 and at most 1 was expected, not {text!r}")
    return number


def _speed(text: str) -> float:
    number = finite(text)
    if number is None or number <= 0:
        raise argparse.ArgumentTypeError(f"metres a second, above 0, were expected, not {text!r}")
    return number


def _reward(text: str) -> tuple[str, float]:
    place, _, value = text.rpartition("=")
    number = finite(value)
    if not place or number is None:
        raise argparse.ArgumentTypeError(f"PLACE=VALUE, a place and a number, was expected, not {text!r}")
    return place, number


def _latch(text: str) -> tuple[str, str]:
    name, _, places = text.partition("=")
    on, _, off = places.partition("/")
    if not name or not on or not off:
        raise argparse.ArgumentTypeError(f"NAME=ON/OFF or NAME=ON/OFF:REWARD was expected, not {text!r}")
    return name, places


def _add_floor(parser: argparse.ArgumentParser, robot: str = "") -> None:
    """Add the arguments for the files of a floor; a graph without labels comes as the labels."""
    parser.add_argument(
        "map",
        metavar="MAP.yaml",
        help="ROS's map.yaml, whose image is a PGM, PNG or BMP; or a building.toml, alone, which names several floors",
    )
    parser.add_argument(
        "labels",
        metavar="LABELS.png",
        nargs="?",
        help="an image of the same size, with a colour for each place; without, the zones of the graph are its places",
    )
    parser.add_argument(
        "graph",
        metavar="GRAPH",
        nargs="?",
        help="the original's TopologicalMap (XML), LCAS's tmap2 (YAML), or Nav2's route graph (GeoJSON)",
    )
    parser.add_argument(
        "--names",
        metavar="FILE",
        help="predicate_labels.yaml, the colours of places; by default those under their goals",
    )
    parser.add_argument(
        "--reach",
        metavar="M",
        type=_metres,
        help="how far from its goal a place without zone reaches over free cells, in metres",
    )
    _add_kinds(parser, robot)


def _add_kinds(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add the argument for what the robot is; where there is more, also for the file that is written of it."""
    parser.add_argument(
        "--robot",
        metavar="KIND=VALUE|FILE.toml" if more else "KIND=VALUE",
        action="append",
        default=[],
        type=str if more else _kind,
        dest="kinds",
        help=f"what the robot is, such as robot=short, by which the restrictions of a tmap2 are judged{more}",
    )


def _kind(text: str) -> str:
    kind, _, value = text.partition("=")
    if not kind or not value:
        raise argparse.ArgumentTypeError(f"KIND=VALUE, such as robot=short, was expected, not {text!r}")
    return text


def _add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the size of the robot, and for how deep inside a place it is there."""
    parser.add_argument("--radius", metavar="M", type=_metres, help="the radius of the robot, in metres (0.25)")
    parser.add_argument(
        "--margin",
        metavar="M",
        type=_metres,
        help="how deep inside a place a robot must be to be there, in metres (0.3)",
    )


def _metres(text: str) -> float:
    """Parse an argument as a number of metres of 0 or more."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"a number of metres, 0 or more, was expected, not {text!r}")
    return number
