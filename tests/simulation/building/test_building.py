"""The building: robots that share it, and the same run twice."""

from __future__ import annotations

import asyncio
import builtins
import math
import re

import crowds
import numpy as np
import pytest
from maps.floors import FURNITURE, offices
from passage import PASSAGE
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error, MapError
from mdm.maps import Floors, Map, Places, Pose
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building, DriveError, Visits


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


@pytest.mark.parametrize("seconds", [100, pytest.param(300, marks=pytest.mark.slow)])
def test_two_robots_patrol_without_touching_anything(seconds):
    poses, collisions, steps = patrolled(float(seconds), seed=2)
    assert collisions == [0, 0]
    assert steps in {10 * seconds, 10 * seconds + 1}
    assert len(poses) == 2 * steps


def sent(floor, starts, goals, **options):
    """Send robots to their goals at once; return how each drive ended, the touches of each, and the seconds in all."""
    building = Building(floor, seed=1)
    robots = [building.robot(f"robot{turn}", at=at, **options) for turn, at in enumerate(starts)]

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            drives = [robot.go(goal) for robot, goal in zip(robots, goals, strict=True)]
            return await asyncio.gather(*drives, return_exceptions=True)

    return mdm.run(main, virtual=True), [robot.collisions for robot in robots], building.steps / 10


@pytest.mark.parametrize("seconds_ahead", [0, 3, 6])
def test_robots_that_meet_in_a_passage_give_way(seconds_ahead):
    """It is too narrow for two; one drives back."""
    west, east = Pose(2.0, 3.0), Pose(15.0, 3.0)
    ends, collisions, seconds = sent(PASSAGE.map(), [Pose(2.0 + 0.5 * seconds_ahead, 3.0), east], [east, west])
    assert ends == [None, None]
    assert collisions == [0, 0]
    assert seconds < 75.0  # 26 for the way itself: it waits no longer than for the other to pass


def test_a_robot_that_stands_in_a_passage_is_in_the_way():
    ends, *_ = sent(PASSAGE.map(), [Pose(2.0, 3.0), Pose(8.0, 3.0)], [Pose(15.0, 3.0), Pose(8.0, 3.0, 3.0)])
    assert [type(end) for end in ends] == [DriveError, type(None)]
    assert re.search("has come no nearer to 15, 3 for 30 s|has been held up for 50 s", str(ends[0]))


@pytest.mark.parametrize(
    ("seed", "seconds", "least"), [(2, 70.0, 0), pytest.param(2, 400.0, 10, marks=pytest.mark.slow)]
)
def test_four_robots_come_wherever_there_is_room(seed, seconds, least):
    floor, random = offices(furniture=FURNITURE[offices]).map(), np.random.default_rng(seed)
    building = Building(floor, seed=seed)
    names = floor.graph.names
    robots = [building.robot(name, at=name, noise=0.05) for name in names[:4]]
    goals = dict(zip(robots, names, strict=False))
    arrivals = dict.fromkeys(robots, 0)

    async def roam(robot):
        while True:
            goals[robot] = str(random.choice([name for name in names if name not in goals.values()]))
            await robot.go(floor.graph.node(goals[robot]).goal)
            arrivals[robot] += 1

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            drives = [asyncio.create_task(roam(robot)) for robot in robots]
            done, _ = await asyncio.wait(drives, timeout=seconds, return_when=asyncio.FIRST_EXCEPTION)
            assert not [drive.exception() for drive in done]
            for drive in drives:
                drive.cancel()
            await asyncio.wait(drives)

    mdm.run(main, virtual=True)
    assert min(arrivals.values()) > least
    assert [robot.collisions for robot in robots] == [0, 0, 0, 0]


@pytest.mark.parametrize(("held", "steps"), [(0.0, 0), (0.5, 5), (1.0, 10), (5.0, 10)])
def test_a_building_catches_up_with_a_loop_that_was_held(held, steps):
    """By a second at most: it does not hold the loop again for as long as it was held."""
    building, poses = Building(PASSAGE.map(), seed=1), []
    robot = building.robot("ada", at=Pose(2.0, 3.0))

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/ada/pose", PoseUpdate).subscribe(poses.append)
            await runtime.start(building)
            drive = asyncio.create_task(robot.go(Pose(15.0, 3.0)))
            await runtime.clock.sleep(5.05)
            before, there, told = building.steps, robot.pose.x, len(poses)
            asyncio.get_running_loop()._virtual.now += round(held * 1e9)
            await asyncio.sleep(0)
            await runtime.clock.sleep(0.01)
            assert building.steps - before == steps
            assert robot.pose.x - there == pytest.approx(0.05 * steps, abs=0.001)  # 0.5 metres a second
            assert len(poses) - told == (1 if held else 0)
            await drive

    mdm.run(main, virtual=True)
    times = [pose.time for pose in poses]
    assert all(time % 100_000_000 == 0 for time in times)  # when it was there, and not when that was told
    assert times == sorted(set(times))


def test_the_same_seed_gives_the_same_run():
    run = patrolled(30.0, seed=4)
    assert run == patrolled(30.0, seed=4)
    assert run != patrolled(30.0, seed=5)


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


def test_places_are_told_what_is_told_on_the_channel():
    """The noisy poses, not where the robot really is."""

    class Told(list):
        see = list.append

    building, seen, poses = Building(offices().map(), seed=1), Told(), []
    building.robot("ada", at="hall", places=seen, noise=0.2)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/ada/pose", PoseUpdate).subscribe(poses.append)
            await runtime.start(building)
            await runtime.clock.sleep(5.0)

    mdm.run(main, virtual=True)
    assert [(pose.x, pose.y) for pose in seen] == [(pose.x, pose.y) for pose in poses]
    assert len({pose.x for pose in seen}) == len(seen) > 40


def test_what_does_not_fit_is_refused():
    floor = offices().map()
    with refused(MapError):
        Building(Floors({"ground": floor}))
    with refused(MapError):
        Building(Map(floor.labels, floor.graph))
    building = Building(floor)
    building.robot("ada", at="hall")
    with refused(ConfigError):
        building.robot("ada", at="lab")
    with refused(MapError):
        building.robot("bob", at=Pose(-1.9, 6.0))
    with refused(MapError):
        building.robot("bob", at="attic")
    with refused(MapError):
        building.robot("bob", at=Pose(9.3, 7.25))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"radius": 0}, "the radius of robot 'ada' is a number above 0, not 0"),
        ({"speed": -1.0}, "the speed of robot 'ada' is a number above 0, not -1"),
        ({"speed": math.inf}, "the speed of robot 'ada' is a number above 0, not inf"),
        ({"reach": math.nan}, "the reach of robot 'ada' is a number above 0, not nan"),
        ({"noise": -0.1}, "the noise of robot 'ada' is a number from 0, not -0.1"),
        ({"noise": "much"}, "the noise of robot 'ada' is a number from 0, not 'much'"),
        ({"beams": -1}, "the beams of robot 'ada' are a whole number from 0, not -1"),
        ({"beams": 1.5}, "the beams of robot 'ada' are a whole number from 0, not 1.5"),
    ],
)
def test_numbers_that_no_robot_can_have_are_refused(option, message):
    with pytest.raises(ConfigError, match=message):
        Building(offices().map()).robot("ada", at="hall", **option)


def test_a_robot_may_come_later():
    floor = offices().map()
    building, poses = Building(floor, seed=1), []

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/bob/pose", PoseUpdate).subscribe(poses.append)
            await runtime.start(building)
            await runtime.clock.sleep(1.0)
            bob = building.robot("bob", at="lab")
            await bob.go(floor.graph.node("hall").goal)
            assert math.dist((bob.pose.x, bob.pose.y), (9.0, 7.25)) < 0.3

    mdm.run(main, virtual=True)
    assert len(poses) > 100


@pytest.mark.parametrize("leaves", [False, True])
def test_drives_fail_when_the_building_stops_and_when_their_robot_leaves_the_floor(leaves):
    floor = offices().map()
    building = Building(floor, seed=1)
    robot = building.robot("ada", at="hall")

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            drive = asyncio.create_task(robot.go(floor.graph.node("lab").goal))
            await runtime.clock.sleep(1.0)
            if leaves:
                building.leave("ada")
            else:
                await runtime.stop(building)
            with refused(DriveError):
                await drive

    mdm.run(main, virtual=True)


def test_without_navground_there_is_one_sentence(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("navground"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with refused(Error):
        Building(offices().map())


def test_robots_that_share_a_passage_touch_nothing_and_do_the_same_twice():
    """An hour of up to eight robots on three floors is ``python -m crowds``."""
    floor = PASSAGE.map()
    run = crowds.crowd(floor, 4, 40.0)
    assert run.faults() == []
    assert run.drives > 0
    short = crowds.crowd(floor, 4, 10.0)
    assert crowds.crowd(floor, 4, 10.0) == short
    assert crowds.crowd(floor, 4, 10.0, seed=2).poses != short.poses


def test_what_a_crowd_should_not_do_is_told():
    assert crowds.Crowd(waited=61.0, contacts=2).faults() == ["2 contacts", "one waited for 61 s"]
