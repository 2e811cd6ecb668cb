"""``mdm map model``."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from building_file import write_building
from floor_file import GRAPH
from places import EXAMPLES

from mdm import load_model, load_policy
from mdm.formats import load_durations
from mdm.maps import load_map
from mdm.maps.model import arrivals, sightings

PATROL = [EXAMPLES / "patrol" / name for name in ("floor.yaml", "labels.png", "floor.xml")]
RECORDED = {
    "SoccerField": ("Up", None),  # the latch turns on arrival: this half cannot occur there
    "LRM": ("Up", "Down"),
    "SouthCorridor": ("Right", "Down"),
    "CoffeeRoom": ("Down", "Down"),
    "WestCorridor": ("Down", "Left"),
    "ElevatorHallway": (None, "Up"),
}
"""What the original's recorded policy does in each room, before half of the round and after, where both can occur."""


@pytest.mark.parametrize("suffix", ["npz", "pgmx", "pomdpx"])
def test_the_patrol_of_the_original_from_a_map_to_its_policy(mdm, tmp_path, suffix):
    path, policy = tmp_path / f"patrol.{suffix}", tmp_path / "policy.npz"
    latch = "PatrolHalfwayThrough=ElevatorHallway/SoccerField"
    status, output, errors = mdm("map", "model", *PATROL, "--latch", latch, "-o", path)
    assert status == 0, errors
    assert output == [
        "states    12: position (6), PatrolHalfwayThrough (2)",
        "actions   Up, Down, Left, Right",
        "discount  0.95 of a step",
        f"{path}: a model (MDP)",
    ]
    assert all(line.startswith("mdm: warning: ") for line in errors.splitlines())
    assert mdm("solve", path, "-o", policy, "--gap", "1e-6")[0] == 0
    model = load_model(path)
    solved, actions = load_policy(policy, model), model.action_space.factors[0].names
    rooms = load_map(PATROL[2], grid=PATROL[0], labels=PATROL[1]).graph.names
    for place, room in enumerate(rooms):
        for half, recorded in enumerate(RECORDED[room]):
            assert recorded in {None, actions[solved.action(2 * place + half)]}, (room, half)


def test_all_that_is_given_is_in_the_model(mdm, floor, tmp_path):
    path = tmp_path / "floor.npz"
    arguments = ["--success", "0.8", "--reward", "store=5", "--latch", "half=office/hall:3", "--start", "hall"]
    status, output, errors = mdm(
        "map",
        "model",
        *floor,
        *arguments,
        "--stay",
        "Stay",
        "--discount",
        "0.5",
        "--noise",
        "0.2",
        "-o",
        path,
        "--json",
    )
    facts = json.loads(output[0])
    assert (status, errors) == (0, "")
    assert facts["factors"] == {"position": 3, "half": 2}
    assert facts["actions"] == ["Up", "Right", "Down", "Left", "Stay"]
    made = load_model(path)
    assert (made.kind, made.discount) == ("POMDP", 0.5)
    assert made.transition("Up", "hall no", "office yes") == pytest.approx(0.8)
    assert made.reward("Up", "hall no") == pytest.approx(0.8 * 3)
    assert made.reward("Right", "hall no") == pytest.approx(0.8 * 5)
    assert made.reward("Stay", "hall no") == 0
    assert made.initial_belief.tolist() == [1, 0, 0, 0, 0, 0]
    seen = sightings(load_map(floor[2], grid=floor[0], labels=floor[1]), 0.2)
    assert made.observation("Up", "store no", "hall") == pytest.approx(seen[2, 0])


def test_at_a_fixed_rate_ways_take_as_long_on_average_as_their_paths(mdm, floor, tmp_path):
    path = tmp_path / "floor.npz"
    arguments = ["--speed", "0.5", "--period", "2", "--radius", "0.12", "-o", path]
    status, output, _ = mdm("map", "model", *floor, *arguments, "--reward", "office=1")
    taken = arrivals(load_map(floor[2], grid=floor[0], labels=floor[1]), speed=0.5, radius=0.12)
    made = load_model(path)
    assert status == 0
    assert made.transition("Up", "hall", "office") == pytest.approx(min(1.0, 2 / taken[0, 0]))
    assert output[4].split() == ["way", "seconds", "success"]
    assert output[5].split() == ["hall,", "Up:", "office", f"{taken[0, 0]:.1f}", f"{min(1.0, 2 / taken[0, 0]):.3g}"]
    assert mdm("map", "model", *floor, *arguments[:3], "999", *arguments[4:], "--reward", "office=1")[0] == 0
    assert load_model(path).transition("Up", "hall", "office") == 1.0  # at most


def test_solving_with_durations_is_iteration_over_time(mdm, facts, floor, tmp_path):
    """From the command line alone, to the value that a direct iteration over decisions has."""
    path, drive = tmp_path / "floor.npz", tmp_path / "drive.npz"
    arguments = ["--speed", "0.5", "--durations", drive, "--stages", "3", "--radius", "0.12", "--discount", "0.98"]
    status, output, errors = mdm("map", "model", *floor, *arguments, "--latch", "half=office/store", "-o", path)
    assert (status, errors) == (0, "")
    assert "discount  0.98 of a second" in output
    assert output[-2].startswith(f"{drive}: how long its actions take")
    made, durations = load_model(path), load_durations(drive)
    means, stages = durations.table(made)
    assert (stages == 3).all()
    solved = facts("solve", path, "--durations", drive, "-o", tmp_path / "policy.npz", "--gap", "1e-9")
    worth = (1 - math.log(0.98) * means / stages) ** -stages
    transitions = np.array([np.array(made.transition_matrix(action)) for action in range(4)])
    values = np.zeros(6)
    for _ in range(2000):
        values = (made.rewards + worth * np.einsum("ast,t->sa", transitions, values)).max(axis=1)
    assert solved["lower"] == pytest.approx(made.initial_belief @ values, abs=1e-8)


@pytest.fixture
def own(floor):
    """Write a module of factors beside the graph, and forget it afterwards."""
    sys.modules.pop("own_floor_factors", None)
    (Path(floor[2]).parent / "own_floor_factors.py").write_text(OWN)
    yield
    sys.modules.pop("own_floor_factors", None)


OWN = """
import numpy as np
from mdm.maps.model import FloorFactor

def lamp(graph):
    stays = np.tile(np.eye(2), (len(graph.names), 1, 1))
    return FloorFactor("lamp", ("off", "on"), stays)

def both(graph):
    one = lamp(graph)
    return [one, FloorFactor("bell", ("off", "on"), one.transitions)]

def fails(graph):
    return 1 / 0

def leaves(graph):
    raise SystemExit(3)

def other(graph):
    return [1]

def ragged(graph):
    return FloorFactor("lamp", ("off", "on"), [[1.0], [1.0, 2.0]])

def shape(graph):
    return FloorFactor("lamp", ("off", "on"), np.eye(2))

def row(graph):
    return FloorFactor("lamp", ("off", "on"), 2 * lamp(graph).transitions)

def rewards(graph):
    return FloorFactor("lamp", ("off", "on"), lamp(graph).transitions, np.ones((7, 7)))

def endless(graph):
    return FloorFactor("lamp", ("off", "on"), lamp(graph).transitions, np.inf * lamp(graph).transitions)

def initial(graph):
    return FloorFactor("lamp", ("off", "on"), lamp(graph).transitions, initial=(1.0,))

def position(graph):
    return FloorFactor("position", ("off", "on"), lamp(graph).transitions)
"""


@pytest.mark.usefixtures("own")
def test_factors_of_ones_own(mdm, floor, tmp_path):
    path = tmp_path / "floor.npz"
    arguments = ["--factors", "own_floor_factors:both", "--latch", "half=office/store", "-o", path]
    assert mdm("map", "model", *floor, *arguments)[0] == 0
    assert [factor.name for factor in load_model(path).state_space.factors] == ["position", "half", "lamp", "bell"]
    arguments[1] = "own_floor_factors:lamp"
    assert mdm("map", "model", *floor, *arguments)[0] == 0
    assert len(load_model(path).state_space.factors) == 3


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("fails", "own_floor_factors:fails fails: ZeroDivisionError"),
        ("leaves", "own_floor_factors:leaves fails: SystemExit"),
        ("other", "own_floor_factors:other returns a int among its factors"),
        ("nothing", "has no 'nothing'"),
        ("ragged", "the transitions of 'lamp' are no array of numbers"),
        ("shape", "the transitions of 'lamp' have the shape (2, 2), not (3, 2, 2)"),
        ("row", "the transitions of 'lamp'"),
        ("rewards", "the rewards of 'lamp' have the shape (7, 7), not (3, 2, 2)"),
        ("endless", "the rewards of 'lamp' are not all finite"),
        ("initial", "the first values of 'lamp' have the shape (1,), not (2,)"),
        ("position", "two factors are called 'position'"),
    ],
)
def test_factors_that_are_none(mdm, floor, tmp_path, function, words):
    arguments = ["--factors", f"own_floor_factors:{function}", "-o", tmp_path / "floor.npz"]
    status, output, errors = mdm("map", "model", *floor, *arguments)
    assert (status, output) == (1, [])
    assert words in errors
    assert "Traceback" not in errors
    assert "unexpected" not in errors
    assert not (tmp_path / "floor.npz").exists()


def test_a_patrol_that_visits_all_places(mdm, floor, tmp_path):
    """Wherever one begins in the model, by its policy one comes to the place that is next, and that then changes."""
    model, policy = tmp_path / "floor.npz", tmp_path / "policy.npz"
    status, output, errors = mdm("map", "model", *floor, "--visit", "all", "--radius", "0.12", "-o", model)
    assert (status, errors) == (0, "")
    assert "tour      hall, store, office, and so on" in output
    assert any(line.endswith('[places] of a TOML file: tour = ["hall", "store", "office"]') for line in output)
    assert mdm("solve", model, "-o", policy)[0] == 0
    made, chosen = load_model(model), load_policy(policy)
    places = ("hall", "office", "store")
    assert [factor.names for factor in made.state_space.factors] == [places, ("hall", "store", "office")]
    for state in range(9):
        visited, here = set(), state
        for _ in range(12):
            here = int(np.argmax(made.transition_matrix(chosen.action(here))[here]))
            visited.add(here // 3)
        assert visited == {0, 1, 2}
    both = ("--visit", "store", "--visit", "office", "--radius", "0.12")
    facts = json.loads(mdm("map", "model", *floor, *both, "-o", model, "--json")[1][0])
    assert facts["tour"] == ["store", "office"]
    for given, words in (("attic", "there is no place 'attic'"), ("hall", "a tour takes two places or more")):
        status, _, errors = mdm("map", "model", *floor, "--visit", given, "--radius", "0.12", "-o", model)
        assert (status, words in errors, "Traceback" in errors) == (1, True, False)


def test_places_with_slashes_and_colons(mdm, floor, tmp_path):
    graph = tmp_path / "graph.xml"
    graph.write_text(GRAPH.replace("hall", "a/b").replace("office", "c:2"))
    arguments = [*floor[:2], graph, "-o", tmp_path / "floor.npz"]
    for latch, reward in (
        ("half=c:2/a/b", 1.0),
        ("half=c:2/a/b:3", 3.0),
        ("half=a/b/c:2", 1.0),
        ("half=a/b/c:2:4", 4.0),
    ):
        assert mdm("map", "model", *arguments, "--latch", latch)[0] == 0
        assert load_model(tmp_path / "floor.npz").rewards.max() == pytest.approx(reward - 0.01)


def test_a_model_in_which_nothing_is_earned_is_noted(mdm, floor, tmp_path):
    status, output, _ = mdm("map", "model", *floor, "-o", tmp_path / "floor.npz")
    assert status == 0
    assert output[-2].startswith("note: nothing is earned")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--reward", "attic=1"], "there is no place 'attic'"),
        (["--latch", "half=attic/hall"], "there is no place 'attic'"),
        (["--latch", "half=hall/attic:2"], "there is no place 'attic'"),
        (["--latch", "position=hall/store"], "two factors are called 'position'"),
        (["--start", "attic"], "there is no place 'attic'"),
        (["--stay", "Up"], "'Up' is a way of the map"),
        (["--speed", "1", "--period", "1", "--radius", "9"], "a robot with a radius of 9 m does not fit"),
        (["--noise", "0.1", "--radius", "9"], "fits nowhere in 'hall'"),
        (["--factors", "nothing"], "'module:name'"),
        (["--factors", "no_such_module_there:f"], "there is no module 'no_such_module_there'"),
        (["--names", "nowhere.yaml"], "nowhere.yaml"),
        (["--reach", "1"], "how far places reach is told by the image of labels"),
    ],
)
def test_what_does_not_fit_the_map(mdm, floor, tmp_path, arguments, words):
    status, output, errors = mdm("map", "model", *floor, *arguments, "-o", tmp_path / "floor.npz")
    assert (status, output) == (1, [])
    assert words in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "floor.npz").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--period 1", "--period needs --speed"),
        ("--durations d.npz", "--durations needs --speed"),
        ("--speed 1", "--speed needs --period"),
        ("--speed 1 --period 1 --durations d.npz", "give one"),
        ("--speed 1 --period 1 --success 0.5", "leave --success out"),
        ("--stages 2", "--stages is for --durations"),
        ("--speed 1 --period 1 --stages 2", "--stages is for --durations"),
        ("--radius 0.3", "--radius is for --speed, --noise and --visit"),
        ("--speed 1 --durations d.txt", "its file ends in .npz"),
        ("--speed 1 --durations floor.npz", "the same file"),
        ("--speed 1 --durations d.npz --discount 1", "time costs nothing"),
        ("--latch half=hall/store --latch half=store/hall", "--latch is given twice for 'half'"),
        ("--latch half=hall/hall", "switched on and off in 'hall'"),
        ("--reward hall=1 --reward hall=2", "--reward is given twice for 'hall'"),
        ("--latch half=hall", "NAME=ON/OFF"),
        ("--latch hall/store", "NAME=ON/OFF"),
        ("--reward hall", "PLACE=VALUE"),
        ("--reward hall=nan", "PLACE=VALUE"),
        ("--reward hall=much", "PLACE=VALUE"),
        ("--success 1.5", "above 0 and at most 1"),
        ("--success nan", "above 0 and at most 1"),
        ("--speed 0", "metres a second"),
        ("--speed inf", "metres a second"),
        ("--noise -1", "a number of metres, 0 or more"),
        ("--discount 2", "above 0 and at most 1"),
        ("--period 0", "seconds above 0"),
        ("--stages 0", "a whole number of 1 or more"),
    ],
)
def test_wrong_usage_is_2(mdm, floor, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    status, output, errors = mdm("map", "model", *floor, "-o", "floor.npz", *arguments.split())
    assert (status, output) == (2, [])
    assert words in errors
    assert "Traceback" not in errors
    assert not list(tmp_path.glob("*.npz"))


@pytest.mark.parametrize("name", ["map.yaml", "map.pgm", "labels.ppm", "graph.xml"])
@pytest.mark.parametrize("content", [None, b"", b"\0\1", b"{", b"[", b"<", b"P5 1 1 255\n\0", b"a: &a [*a]\n"])
def test_broken_files_give_a_sentence(mdm, floor, tmp_path, name, content):
    path = Path(floor[0]).parent / name
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)
    status, output, errors = mdm("map", "model", *floor, "-o", tmp_path / "floor.npz")
    assert (status, output) == (1, [])
    assert errors.startswith("mdm map model: ")
    assert errors.count("\n") == 1
    assert not (tmp_path / "floor.npz").exists()


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("floor.pomdp", ".pomdpx, .pgmx or .npz"),
        ("floor", ".pomdpx, .pgmx or .npz"),
        ("floor.pomdpx.gz", ".pomdpx, .pgmx or .npz"),
        ("nowhere/floor.npz", "nowhere/floor.npz"),
        ("folder.npz", "this is a folder"),
    ],
)
def test_places_where_nothing_can_be_written(mdm, floor, tmp_path, output, words):
    (tmp_path / "folder.npz").mkdir()
    status, told, errors = mdm("map", "model", *floor, "-o", tmp_path / output)
    assert (status, told) == (1, [])
    assert words in errors


def test_no_input_is_overwritten(mdm, floor, tmp_path):
    graph = Path(floor[2]).rename(tmp_path / "graph.npz")
    before = graph.read_bytes()
    arguments = ["--speed", "1", "--durations", graph, "-o", tmp_path / "floor.npz"]
    for wrong in (["-o", graph], arguments):
        status, output, errors = mdm("map", "model", *floor[:2], graph, *wrong)
        assert (status, output) == (1, [])
        assert "this file is an input and would be overwritten" in errors
    assert graph.read_bytes() == before


def test_a_map_with_faults_is_told(mdm, floor, tmp_path):
    Path(floor[2]).write_text(GRAPH.replace("0.0 5.0 1.5707963", "0.0 3.2 0"))
    status, output, errors = mdm("map", "model", *floor, "-o", tmp_path / "floor.npz")
    assert (status, output) == (1, [])
    assert "lie on the same colour" in errors


def test_the_floors_of_a_building_make_one_model(mdm, tmp_path):
    building, model, times = write_building(tmp_path), tmp_path / "site.npz", tmp_path / "times.npz"
    options = ("--radius", "0.12", "--speed", "0.5", "--durations", times, "--visit", "all", "-o", model)
    status, output, errors = mdm("map", "model", building, *options)
    assert (status, errors) == (0, "")
    assert output[0] == "states    36: position (6), next (6)"
    assert output[1] == "actions   Up, Right, Down, Left, lift to upper, lift to ground"
    assert any(
        line.split() == ["ground.store,", "lift", "to", "upper:", "upper.store", "12.0", "0.9"] for line in output
    )
    made = load_model(model)
    assert made.transition("lift to upper", "ground.store ground.hall", "upper.store ground.hall") == pytest.approx(0.9)
    assert made.initial_belief[0] == 1.0  # the start of the building's file
    (tour,) = (line.split(maxsplit=1)[1].split(", ") for line in output if line.startswith("tour"))
    floors = [place.partition(".")[0] for place in tour[:-1]]
    assert sum(one != other for one, other in zip(floors, floors[1:] + floors[:1], strict=True)) == 2


RESTRICTED = """nodes:
{}
- node:
    name: C
    pose: {{orientation: {{w: 1, x: 0, y: 0, z: 0}}, position: {{x: 2.0, y: 3.5}}}}
"""
NODE = """- node:
    name: {name}
    pose: {{orientation: {{w: 1, x: 0, y: 0, z: 0}}, position: {{x: 0.0, y: {y}}}}}
    edges:
    - {{node: {other}, action: move_base}}
    - {{node: C, action: move_base, restrictions_planning: robot_short}}"""


@pytest.fixture
def restricted(tmp_path):
    """A graph whose ways to C are for short robots."""
    path = tmp_path / "restricted.tmap2"
    path.write_text(
        RESTRICTED.format(
            "\n".join(NODE.format(name=a, other=b, y=y) for a, b, y in (("A", "B", 3.0), ("B", "A", 5.0)))
        )
    )
    return path


@pytest.mark.parametrize(
    ("kind", "labels"), [("robot=short", ["to B", "to C", "to A"]), ("robot=tall", ["to B", "to A"])]
)
def test_the_ways_of_the_model_are_those_of_the_robot(mdm, floor, restricted, tmp_path, kind, labels):
    arguments = ["map", "model", floor[0], restricted, "--reach", "3", "-o", tmp_path / "model.npz"]
    status, _, errors = mdm(*arguments)
    assert (status, "cannot be judged: say what the robot is" in errors) == (1, True)
    robot = tmp_path / "robot.toml"
    assert mdm(*arguments, "--robot", kind, "--robot", robot)[0] == 0
    assert load_model(tmp_path / "model.npz").action_space.names == tuple(labels)
    name, _, value = kind.partition("=")
    assert f'robot = {{ "{name}" = "{value}" }}' in robot.read_text()
    (tmp_path / "robot.py").write_text(
        "async def localise(system):\n    pass\n\n\nclass Wheels:\n    async def go(self, goal):\n        pass\n"
    )
    assert mdm("solve", tmp_path / "model.npz", "-o", tmp_path / "model.policy")[0] == 0
    assert mdm("check", robot)[0] == 0  # which reads the graph by what the file says of the robot


@pytest.mark.parametrize("verb", ["check", "show", "draft"])
def test_verbs_of_maps_take_what_the_robot_is(mdm, floor, restricted, tmp_path, verb):
    more = ["-o", tmp_path / "labels.png"] if verb == "draft" else ["--reach", "3"]
    for kind, told in (
        ((), "cannot be judged"),
        (("--robot", "short"), "KIND=VALUE, such as robot=short, was expected"),
    ):
        status, _, errors = mdm("map", verb, floor[0], restricted, *more, *kind)
        assert status == (2 if kind else 1)
        assert told in errors
    _, _, errors = mdm("map", verb, floor[0], restricted, *more, "--robot", "robot=short")
    assert "cannot be judged" not in errors
    assert "mdm map" not in errors
