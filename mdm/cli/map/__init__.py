"""``mdm map``: verbs that propose, draft, check and show the map of a floor, or make a model of it."""

from __future__ import annotations

import argparse
import math

from mdm.cli.usage import JSON, Argument, Verb, count, finite, number, seconds, share

__all__ = ["DISCOUNT", "RADIUS", "STAGES", "SUCCESS", "VERBS"]

SUCCESS, DISCOUNT, STAGES, RADIUS = 0.9, 0.95, 4, 0.25
"""Of a model: the probability that a way is gone in a step, its discount, stages of durations, metres of a robot."""

_metres = number("a number of metres, 0 or more,", 0, apart=(math.inf,))
_speed = number("metres a second, above 0,", 0, apart=(0, math.inf), be="were")


def _reward(text: str) -> tuple[str, float]:
    place, _, value = text.rpartition("=")
    reward = finite(value)
    if not place or reward is None:
        raise argparse.ArgumentTypeError(f"PLACE=VALUE, a place and a number, was expected, not {text!r}")
    return place, reward


def _latch(text: str) -> tuple[str, str]:
    name, _, places = text.partition("=")
    on, _, off = places.partition("/")
    if not name or not on or not off:
        raise argparse.ArgumentTypeError(f"NAME=ON/OFF or NAME=ON/OFF:REWARD was expected, not {text!r}")
    return name, places


def _kind(text: str) -> str:
    kind, _, value = text.partition("=")
    if not kind or not value:
        raise argparse.ArgumentTypeError(f"KIND=VALUE, such as robot=short, was expected, not {text!r}")
    return text


def _given_again(words: str, help: str | None, type: object, dest: str) -> Argument:  # noqa: A002
    return Argument(words, help, type, action="append", default=[], dest=dest)  # type: ignore[arg-type]


_GRAPH = "the original's TopologicalMap (XML), LCAS's tmap2 (YAML), or Nav2's route graph (GeoJSON)"
_MAP = Argument("map MAP.yaml", "ROS's map.yaml, whose image is a PGM, PNG or BMP")
_ROBOT = "what the robot is, such as robot=short, by which the restrictions of a tmap2 are judged"
_KINDS = _given_again("--robot KIND=VALUE", _ROBOT, _kind, "kinds")
_FLOOR = (
    Argument(
        "map MAP.yaml",
        "ROS's map.yaml, whose image is a PGM, PNG or BMP; or a building.toml, alone, which names several floors",
    ),
    Argument(
        "labels [LABELS.png]",
        "an image of the same size, with a colour for each place; without, the zones of the graph are its places",
    ),
    Argument("graph [GRAPH]", _GRAPH),
    Argument("--names FILE", "predicate_labels.yaml, the colours of places; by default those under their goals"),
    Argument("--reach M", "how far from its goal a place without zone reaches over free cells, in metres", _metres),
)
"""The files of a floor; a graph without labels comes as the labels."""
_SIZE = (
    Argument("--radius M", "the radius of the robot, in metres (0.25)", _metres),
    Argument("--margin M", "how deep inside a place a robot must be to be there, in metres (0.3)", _metres),
)

_VERBS = {
    "goals": Verb(
        "Divide a map at its doors into rooms, put a goal into each where the robot fits well, and lead ways "
        "through the doors; and write this as a graph. It is a proposal: rename the rooms, move goals, leave rooms "
        "out or add some; then see mdm map draft, which divides the map by them. mdm map show tells coordinates.",
        "mdm map goals map.yaml -o graph.xml --picture rooms.png",
        (
            _MAP,
            Argument("-o --output GRAPH.xml", "the graph, as the original's TopologicalMap", required=True),
            *_SIZE,
            Argument(
                "--least M2",
                "the least area of a room, in square metres of where a robot fits (4)",
                _metres,
            ),
            Argument("--picture PNG", "draw the rooms into a file (needs pillow and pyyaml)"),
            JSON,
        ),
        "map.draft:goals",
        line="propose rooms, goals and ways from a map alone",
    ),
    "draft": Verb(
        "Divide a map into the places of a graph, whose goals say where they are, and write an image with a colour "
        "for each place. It is a draft: rooms are divided at narrow passages, and where there is none, the border "
        "is a convention. Correct it in a paint program, then see mdm map check.",
        "mdm map draft map.yaml graph.xml -o labels.png",
        (
            _MAP,
            Argument("graph GRAPH", _GRAPH),
            _KINDS,
            Argument("-o --output LABELS.png", "the image of labels (needs pillow and pyyaml)", required=True),
            JSON,
        ),
        "map.draft",
        line="draft the labels of a map from the goals of its graph",
    ),
    "check": Verb(
        "List what is wrong with a map: goals that are not in their own place, or where the robot does not fit; "
        "places that are nowhere deep enough to be entered; ways between places that do not touch, or by a passage "
        "that is too narrow; places that touch and have no way; places that cannot be reached from each other; "
        "stray colours, and two names of one colour. Of a building's floors also: lifts that stop where the robot "
        "does not fit. The exit status is 1 where something is wrong.",
        "mdm map check map.yaml labels.png graph.xml --radius 0.3 --pictures problems",
        (
            *_FLOOR,
            _KINDS,
            *_SIZE,
            Argument("--pictures DIR", "a folder for a picture of each problem, of the first 50 (needs pillow)"),
            JSON,
        ),
        "map.check",
        line="list what is wrong with a map",
    ),
    "show": Verb(
        "Show a map: its places with their areas, goals and ways, and how wide the passages between them are. A "
        "passage's width is twice its largest clearance, true to a cell. Without a graph, show the map alone with "
        "lines of coordinates, by which goals can be chosen. Of a building show each floor, and where lifts lead.",
        "mdm map show map.yaml labels.png graph.xml -o floor.png",
        (
            *_FLOOR,
            _KINDS,
            Argument("-o --output PNG", "draw the map into a file (needs pillow and pyyaml)"),
            Argument("--radius M", "leave out passages that are too narrow for a robot of this radius", _metres),
            Argument("--coordinates", "draw lines of coordinates, too"),
            JSON,
        ),
        "map.show",
        line="show the places and ways of a map",
    ),
    "model": Verb(
        "Make a model whose states are the places of a map, with latches and factors of your own, and whose "
        "actions are the labels of its ways: a way is gone in a step with a probability of success, or else the "
        "robot stays. With --noise it is a POMDP, whose observations are the places that are seen. How long ways "
        "take is known from the lengths of their paths with --speed: for decisions at a fixed rate (--period) as "
        "probabilities of success, or for decisions after each action as durations, which mdm solve --durations "
        "takes.",
        "mdm map model map.yaml labels.png graph.xml --latch half=Hall/Kitchen -o patrol.npz",
        (
            *_FLOOR,
            _given_again(
                "--robot KIND=VALUE|FILE.toml",
                f"{_ROBOT}; or a FILE.toml to write, of a robot that does this, which mdm run takes",
                str,
                "kinds",
            ),
            Argument("-o --output MODEL", "the model: .pomdpx, .pgmx or .npz", required=True),
            _given_again("--reward PLACE=VALUE", None, _reward, "rewards"),
            _given_again(
                "--latch NAME=ON/OFF[:REWARD]",
                "a factor that is 'yes' from the place ON to the place OFF, else 'no'; each change earns the "
                "reward (1)",
                _latch,
                "latches",
            ),
            _given_again(
                "--visit PLACE",
                "a place to come to again and again, in the order of a short tour (the factor 'next'); 'all' for all",
                None,
                "visits",
            ),
            Argument(
                "--factors MODULE:FUNCTION",
                "a function of the graph that returns more factors (mdm.maps.model.FloorFactor); modules beside "
                "GRAPH take precedence",
            ),
            Argument("--start PLACE", "where the robot is first; by default it may be anywhere"),
            Argument("--stay NAME", "one more action, which stays at no cost"),
            Argument("--success P", f"the probability that a way is gone in a step ({SUCCESS})", share),
            Argument("--discount G", f"of a step, with --durations of a second ({DISCOUNT})", share),
            Argument("--noise M", "the standard deviation of poses, in metres", _metres),
            Argument("--speed M/S", "of the robot, in metres a second", _speed),
            Argument("--period S", "the seconds between decisions at a fixed rate", seconds),
            Argument("--durations FILE.npz", "write how long actions take"),
            Argument("--stages N", f"the more, the less durations vary: Erlang's stages ({STAGES})", count),
            Argument("--radius M", f"the radius of the robot, in metres ({RADIUS})", _metres),
            JSON,
        ),
        "map.model",
        line="make a model of a robot that goes the ways of a map",
    ),
}

VERBS = {
    "map": Verb(
        "Propose, draft, check and show the map of a floor: its grid, the labels of its places, their graph; and make "
        "a model from it, which mdm solve takes.",
        "mdm map show map.yaml labels.png graph.xml -o floor.png",
        chosen=("map_verb", "VERB"),
        verbs=_VERBS,
    )
}
