"""The building: robots that share it, and the same run twice."""

from __future__ import annotations

import asyncio
import builtins

import pytest
from maps.floors import FURNITURE, offices

import mdm
from mdm.errors import ConfigError, Error, MapError
from mdm.maps import Map, Places, Pose
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building, Visits


def patrolled(seconds, seed):
    """Let two robots drive from room to room; return all poses that were told, and the collisions."""
    floor = offices(furniture=FURNITURE[offices]).map()
    building = Building(floor, visits=[Visits("person", every=30.0, stay=30.0)], seed=seed)
    robots = [building.robot(name, at=at, beams=9) for name, at in (("ada", "hall"), ("bob", "lab"))]
    poses = []

    async def patrol(robot, first):
        turn = first
        while True:
            turn += 1
            await robot.go(floor.graph.node(floor.graph.names[turn % 6]).goal)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            for robot in robots:
                runtime.channel(f"building/{robot.name}/pose", PoseUpdate).subscribe(poses.append)
            await runtime.start(building)
            drives = [asyncio.create_task(patrol(robot, turn)) for turn, robot in enumerate(robots)]
            await runtime.clock.sleep(seconds)
            for drive in drives:
                drive.cancel()
            assert all(
                isinstance(end, asyncio.CancelledError) for end in await asyncio.gather(*drives, return_exceptions=True)
            )

    mdm.run(main, virtual=True)
    return poses, [robot.collisions for robot in robots], building.steps


def test_two_robots_patrol_without_touching_anything():
    poses, collisions, steps = patrolled(300.0, seed=2)
    assert collisions == [0, 0]
    assert steps in {3000, 3001}
    assert len(poses) == 2 * steps


def test_the_same_seed_gives_the_same_run():
    assert patrolled(60.0, seed=4) == patrolled(60.0, seed=4)
    assert patrolled(60.0, seed=4) != patrolled(60.0, seed=5)


def test_places_are_told_of_poses():
    floor = offices().map()
    building, predicates = Building(floor, seed=1), mdm.PredicateManager()
    places = Places(floor, predicates)
    robot = building.robot("ada", at="hall", places=places)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            for actor in (predicates, places, building):
                await runtime.start(actor)
            await runtime.clock.sleep(0.5)
            assert predicates.value("hall") is True
            await robot.go(floor.graph.node("kitchen").goal)
            assert (predicates.value("hall"), predicates.value("kitchen")) == (False, True)
            assert predicates.value("kitchen.at_goal") is True

    mdm.run(main, virtual=True)


def test_what_does_not_fit_is_refused():
    floor = offices().map()
    with pytest.raises(MapError, match="needs a map with a grid"):
        Building(Map(floor.labels, floor.graph))
    building = Building(floor)
    building.robot("ada", at="hall")
    with pytest.raises(ConfigError, match="two robots are called 'ada'"):
        building.robot("ada", at="lab")
    with pytest.raises(MapError, match="'bob' does not fit at -1.9, 6: it would stand in a wall"):
        building.robot("bob", at=Pose(-1.9, 6.0))
    with pytest.raises(MapError, match="no place 'attic'"):
        building.robot("bob", at="attic")


def test_without_navground_there_is_one_sentence(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("navground"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(Error, match="simulated buildings need navground: pip install"):
        Building(offices().map())
