"""The file of a robot that `mdm map model --robot` writes: from a map alone to a patrol, in virtual time."""

from __future__ import annotations

import asyncio
import shlex
from pathlib import Path

import blocks
import pytest
from building_file import write_building
from floor_file import write_floor

from mdm import load_system
from mdm.testing import probe, run_virtual

ROBOT = """
import asyncio, math
from mdm.maps import Pose

class Wheels:
    at = (0.0, 3.0)

    async def go(self, goal):
        while math.dist(Wheels.at, (goal.x, goal.y)) > 0.01:
            left = math.dist(Wheels.at, (goal.x, goal.y))
            part = min(0.05 / left, 1.0)
            Wheels.at = tuple(a + part * (b - a) for a, b in zip(Wheels.at, (goal.x, goal.y)))
            await asyncio.sleep(0.1)

async def localise(system):
    while True:
        system.places.see(Pose(*Wheels.at))
        await asyncio.sleep(0.1)
"""


def patrol(path, seconds):
    """Return where the robot of a file arrives, and how many of its actions failed."""
    system = load_system(path)

    async def main(runtime):
        await runtime.start(system)
        told = probe(system.predicates.events)
        await asyncio.sleep(seconds)
        arrived = [event for update in told for event in update.events if event.endswith(".arrived")]
        return [event.removesuffix(".arrived") for event in arrived], dict(system.ensembles["patrol"].action.ended)

    return run_virtual(main)


@pytest.mark.parametrize("timed", [[], ["--speed", "0.5", "--period", "2"]])
def test_from_a_map_alone_to_a_robot_that_visits_all_rooms(mdm, floor, tmp_path, timed, monkeypatch):
    """Five commands, and nothing edited but the robot's own code."""
    folder = tmp_path / "floor"
    monkeypatch.chdir(folder)
    options = ("--radius", "0.12")
    (folder / "robot.py").write_text(ROBOT)
    for command in (
        ("goals", "map.yaml", "-o", "rooms.xml", "--least", "2", *options),
        ("draft", "map.yaml", "rooms.xml", "-o", "labels.png"),
        ("check", "map.yaml", "labels.png", "rooms.xml", *options),
        ("model", "map.yaml", "labels.png", "rooms.xml", "--visit", "all", *options, *timed, "-o", "patrol.npz")
        + ("--robot", "robot.toml"),
    ):
        assert mdm("map", *command)[0] == 0
    assert mdm("solve", "patrol.npz", "-o", "patrol.policy")[0] == 0
    assert mdm("check", "robot.toml") == (0, ["robot.toml: ensembles, no problems found"], "")
    arrived, ended = patrol(folder / "robot.toml", 300)
    assert min(arrived.count(f"Room{number}") for number in (1, 2, 3)) >= 5
    assert ended.get("failed", 0) == 0


def test_the_page_s_commands_make_a_robot_that_visits_all_rooms_of_a_simulated_building(mdm, tmp_path, monkeypatch):
    """With its `robot.py`, but for a smaller robot: the rooms' door is 0.4 m wide."""
    folder = tmp_path / "floor"
    write_floor(folder)
    monkeypatch.chdir(folder)
    heading = "## From a map to a patrol"
    [commands], [program] = (blocks.texts("docs/maps.md", kind, heading, "## Places") for kind in ("console", "python"))
    (folder / "robot.py").write_text(program.replace("speed=0.5", "speed=0.5, radius=0.12"))
    *first, last = [shlex.split(line, comments=True)[1:] for line in commands.splitlines()]
    for command in first:
        radius = ("--radius", "0.12") if command[0] == "map" and command[1] != "draft" else ()
        least = ("--least", "2") if command[1] == "goals" else ()
        status, _, errors = mdm(*command, *radius, *least)
        assert (status, errors) == (0, ""), command
    assert last == ["run", "patrol.toml", "--virtual", "--seconds", "7200"]
    arrived, ended = patrol(folder / "patrol.toml", 200)
    assert min(arrived.count(f"Room{number}") for number in (1, 2, 3)) >= 3
    assert ended.get("failed", 0) == 0


def test_a_latch_is_a_predicate_of_the_file(mdm, floor, tmp_path, monkeypatch):
    folder = tmp_path / "floor"
    monkeypatch.chdir(folder)
    (folder / "robot.py").write_text(ROBOT)
    model = ("map", "model", *floor, "--latch", "half way=office/store", "-o", "patrol.npz", "--robot", "robot.toml")
    status, output, errors = mdm(*model)
    assert (status, errors) == (0, "")
    assert output[-1] == "robot.toml: a robot that does this, with the parts in robot.py beside it"
    assert (folder / "robot.py").read_text() == ROBOT
    assert mdm("solve", "patrol.npz", "-o", "patrol.policy")[0] == 0
    arrived, _ = patrol(folder / "robot.toml", 200)
    assert min(arrived.count("office"), arrived.count("store")) >= 3


@pytest.mark.parametrize(
    "arguments", [["--visit", "all"], ["--speed", "0.5", "--durations", "times.npz", "--latch", "there=office/store"]]
)
def test_the_project_runs_as_it_stands(mdm, floor, tmp_path, monkeypatch, arguments):
    folder = tmp_path / "floor"
    monkeypatch.chdir(folder)
    model = ("map", "model", *floor, *arguments, "--radius", "0.12", "-o", "patrol.npz", "--robot", "robot.toml")
    status, output, errors = mdm(*model)
    assert (status, errors) == (0, "")
    assert output[-2:] == [
        "patrol.policy: its policy; mdm solve makes one with bounds of your own",
        "robot.toml: a robot that does this, with the parts in robot.py beside it",
    ]
    assert mdm("check", "robot.toml") == (0, ["robot.toml: ensembles, no problems found"], "")
    arrived, ended = patrol(folder / "robot.toml", 300)
    assert min(arrived.count("office"), arrived.count("store")) >= 3
    assert ended.get("failed", 0) == 0


def test_a_model_that_cannot_be_solved_as_it_is_says_so(mdm, floor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = ("map", "model", *floor, "--reward", "office=2", "--discount", "1", "-o", "p.npz", "--robot", "r.toml")
    status, output, errors = mdm(*model)
    assert (status, errors) == (0, "")
    assert (
        output[-2]
        == "r.toml: a robot that does this, once mdm solve has made p.policy, with the parts in robot.py beside it"
    )
    assert output[-1].startswith("note: there is no policy yet: the discount is 1, and from state 'office' rewards")
    assert sorted(path.name for path in tmp_path.glob("*.*")) == ["p.npz", "r.toml", "robot.py"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--robot robot.txt", "--robot: its file ends in .toml"),
        ("--robot robot.toml --noise 0.1", "--robot: places that are seen with --noise make beliefs"),
        ("--robot robot.toml --factors a:b", "--robot: only you know which predicates your --factors are"),
        ("--robot robot.toml --stay Stay", "--robot: an action that stays is none of the map's"),
    ],
)
def test_what_no_file_could_say_is_refused(mdm, floor, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    status, output, errors = mdm("map", "model", *floor, "-o", "model.npz", *arguments.split())
    assert (status, output) == (2, [])
    assert words in errors
    assert not list(tmp_path.glob("*.npz"))


def test_the_page_s_commands_make_a_robot_that_visits_all_rooms_of_two_floors(mdm, tmp_path, monkeypatch):
    """With its `robot.py`, but for a smaller robot."""
    write_building(tmp_path / "site")
    monkeypatch.chdir(tmp_path / "site")
    heading = "**A patrol of all floors**"
    [commands], [program] = (blocks.texts("docs/maps.md", kind, heading, "## Models") for kind in ("console", "python"))
    Path("robot.py").write_text(program.replace("speed=0.5", "speed=0.5, radius=0.12"))
    model, solve, run = [shlex.split(line)[1:] for line in commands.splitlines()]
    assert mdm(*model, "--radius", "0.12")[0] == 0
    assert mdm("check", "patrol.toml")[::2] == (0, "")
    assert mdm(*solve)[0] == 0
    assert mdm("check", "patrol.toml")[::2] == (0, "")
    assert run == ["run", "patrol.toml", "--virtual", "--seconds", "7200"]
    arrived, ended = patrol(Path("patrol.toml"), 250)
    rooms = [f"{floor}.{room}" for floor in ("ground", "upper") for room in ("hall", "office", "store")]
    assert min(arrived.count(room) for room in rooms) >= 2
    assert ended.get("failed", 0) == 0
    assert mdm("run", "patrol.toml", "--virtual", "--seconds", "60")[0] == 0
