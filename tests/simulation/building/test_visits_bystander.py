"""Bystanders: visits stand where they are, are driven around, and shut no way."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest
from maps.floors import FURNITURE, Floor, offices
from sentences import refused

import mdm
from mdm.errors import ConfigError
from mdm.maps.paths import PATH_MARGIN, Paths, drivable
from mdm.simulation.building import Building, Visits
from mdm.simulation.building.robot import DriveError


def passage(width):
    """Two rooms, and a door of a width between them."""
    door = (5.8, 4.0 - width / 2, 6.2, 4.0 + width / 2)
    return Floor(12.0, 8.0, {"west": (0, 0, 6, 8), "east": (6, 0, 12, 8)}, {("east", "west"): door}).map()


def test_a_visit_has_a_body_while_it_is_there():
    building = Building(offices().map(), visits=[Visits("person"), Visits("ghost", radius=0.0)], seed=1)
    robot = building.robot("ada", at="hall")

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            first, ghost = building.come("person", "lab"), building.come("ghost", "lab")
            (body,) = building._bystanders
            assert (body.pose.x, body.pose.y) == pytest.approx((first.x, first.y))
            assert (body.visit, body.name, body.turns, body.remaining) == (first, "person", (), 0.0)
            building.go(ghost)
            assert body.visit is first
            building.go(first)
            assert body.visit is None
            assert body.pose.x < -1e4
            second = building.come("person", "kitchen")
            assert [one.visit for one in building._bystanders] == [second]  # the same body
            third = building.come("person", "kitchen")
            assert [one.visit for one in building._bystanders] == [second, third]
            assert math.dist((second.x, second.y), (third.x, third.y)) > 0.5
            await robot.go(building.floor.graph.node("kitchen").goal)
        assert robot.collisions == 0

    mdm.run(main, virtual=True)
    with refused(ConfigError):
        Visits("person", radius=-1)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2))])
def test_robots_drive_around_people(seed):
    building = Building(offices().map(), visits=[Visits("person")], seed=seed)
    robot = building.robot("ada", at="hall", noise=0.0)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            for place in building.floor.graph.names:
                building.come("person", place)
            goals = [node.goal for node in building.floor.graph.nodes]
            bodies = [one.pose for one in building._bystanders if one.visit is not None]
            assert len(bodies) > 3
            assert min(math.dist((one.x, one.y), (goal.x, goal.y)) for one in bodies for goal in goals) > 0.69
            for goal in [*goals, goals[0]]:
                try:
                    await robot.go(goal)
                except DriveError:  # in a crowd it may get stuck, and says so; from there it finds another way
                    await asyncio.wait_for(robot.go(goal), 120)

    mdm.run(main, virtual=True)
    assert robot.collisions == 0


@pytest.mark.parametrize("width", [0.6, 0.7, 0.8])
def test_a_robot_drives_through_all_passages_that_are_a_little_wider(width):
    building = Building(passage(width), seed=1)
    robot = building.robot("ada", at="west")

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            for place in ("east", "west") * 3:
                await asyncio.wait_for(robot.go(building.floor.graph.node(place).goal), 60)

    mdm.run(main, virtual=True)
    assert robot.collisions == 0


def test_a_robot_in_each_room_touches_nothing_and_nobody_waits_long():
    building = Building(offices(furniture=FURNITURE[offices]).map(), seed=2)
    names = building.floor.graph.names
    robots = [building.robot(name, at=name) for name in names]
    stood = dict.fromkeys(names, 0.0)
    longest = 0.0

    async def roam(robot, number):
        place = names.index(robot.name)
        while True:
            place = (place + 1 + number % 4) % len(names)
            try:
                await robot.go(building.floor.graph.node(names[place]).goal)
            except mdm.Error:
                await asyncio.sleep(1.0)

    async def main():
        nonlocal longest
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            roaming = [asyncio.create_task(roam(robot, number)) for number, robot in enumerate(robots)]
            for _ in range(60):
                before = {robot.name: (robot.pose.x, robot.pose.y, robot._drive) for robot in robots}
                await asyncio.sleep(1.0)
                for robot in robots:
                    x, y, drive = before[robot.name]
                    still = robot._drive is drive and math.dist((x, y), (robot.pose.x, robot.pose.y)) < 0.02
                    stood[robot.name] = stood[robot.name] + 1.0 if still else 0.0
                longest = max(longest, *stood.values())
            for task in roaming:
                task.cancel()

    mdm.run(main, virtual=True)
    assert [robot.collisions for robot in robots] == [0] * len(robots)
    assert longest < 55.0


@pytest.mark.parametrize("seed", range(5))
def test_people_leave_a_way_that_a_robot_can_take(seed):
    """By the rule of its paths, which go diagonally only past two open cells."""
    building = Building(passage(1.2), visits=[Visits("person")], seed=seed)
    robot = building.robot("ada", at="west")
    open_cells, frame = drivable(building.grid, robot.radius), building.grid.frame
    goals = [frame.cell(node.goal.x, node.goal.y) for node in building.floor.graph.nodes]

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            for _ in range(40):
                building.come("person", "west")

    mdm.run(main, virtual=True)
    rows, columns = np.indices(frame.shape)
    for body in building._bystanders:
        away = np.hypot(rows - body.cell[0], columns - body.cell[1]) * frame.resolution
        open_cells = open_cells & (away > robot.radius + body.radius + 2 * PATH_MARGIN)
    assert len(building._bystanders) > 5
    assert np.isfinite(Paths(frame, open_cells).distances([goals[0]])[0][goals[1]])
