"""Robots: they come where they are sent, or say why not."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest
from maps.floors import FURNITURE, flat, offices

import mdm
from mdm.maps import Pose
from mdm.simulation.building import Building, DriveError


def driven(act, *, floor=None, at="hall", **options):
    """Carry something out with a robot of a floor, in virtual time."""
    building = Building((offices(furniture=FURNITURE[offices]) if floor is None else floor).map(), seed=1)
    robot = building.robot("ada", at=at, **options)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            return await act(robot, building, runtime)

    return mdm.run(main, virtual=True)


def test_a_robot_comes_through_doors_and_turns_to_the_yaw():
    goal = Pose(1.5, 2.5, -2.0)

    async def act(robot, building, runtime):
        assert robot.remaining == 0.0
        drive = asyncio.create_task(robot.go(goal))
        await asyncio.sleep(0)
        begin = robot.remaining  # before the first step
        assert 5.0 < begin < 30.0
        await runtime.clock.sleep(5.0)
        before = robot.remaining
        assert 0 < before < begin
        await runtime.clock.sleep(5.0)
        assert robot.remaining < before
        await drive
        seconds = runtime.clock.now() / 1e9
        return robot.pose, robot.collisions, seconds

    pose, collisions, seconds = driven(act)
    assert math.dist((pose.x, pose.y), (goal.x, goal.y)) < 0.25
    assert abs(math.remainder(pose.yaw - goal.yaw, math.tau)) < 0.35
    assert collisions == 0
    straight = math.dist((9.0, 7.25), (goal.x, goal.y))
    assert straight / 0.5 < seconds < 2.5 * straight / 0.5


def test_a_drive_that_is_cancelled_stops():
    async def act(robot, building, runtime):
        drive = asyncio.create_task(robot.go(Pose(16.0, 2.5)))
        await runtime.clock.sleep(4.0)
        drive.cancel()
        with pytest.raises(asyncio.CancelledError):
            await drive
        await runtime.clock.sleep(1.0)
        there = robot.pose
        await runtime.clock.sleep(5.0)
        assert math.dist((robot.pose.x, robot.pose.y), (there.x, there.y)) < 0.01
        assert robot.remaining == 0.0

    driven(act)


def test_a_robot_that_is_sent_elsewhere_says_so_where_it_was_sent_first():
    async def act(robot, building, runtime):
        first = asyncio.create_task(robot.go(Pose(16.0, 2.5)))
        await runtime.clock.sleep(1.0)
        second = asyncio.create_task(robot.go(Pose(9.5, 7.25)))
        with pytest.raises(DriveError, match="'ada' was sent to 9.5, 7.25 before it had come"):
            await first
        await second

    driven(act)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (Pose(500.0, 0.0), "'ada' does not fit at 500, 0: give it a goal at least 0.25 m from all walls"),
        (Pose(-1.95, -0.95), "'ada' does not fit at"),
        (Pose(math.nan, 0.0), "'ada' cannot drive to .* it is not finite"),
    ],
)
def test_a_goal_where_it_does_not_fit_is_refused(goal, message):
    async def act(robot, building, runtime):
        with pytest.raises(DriveError, match=message):
            await robot.go(goal)

    driven(act)


def test_a_room_that_no_door_is_wide_enough_for_cannot_be_reached():
    async def act(robot, building, runtime):
        with pytest.raises(DriveError, match="'ada' finds no way to -0.5, 5"):
            await robot.go(Pose(-0.5, 5.0))

    driven(act, floor=flat(), at="living", radius=0.5)


def test_estimates_scatter_as_the_noise_says():
    async def act(robot, building, runtime):
        return np.array([(pose.x, pose.y) for pose in (robot.estimate() for _ in range(4000))])

    found = driven(act, noise=0.2)
    np.testing.assert_allclose(found.mean(axis=0), (9.0, 7.25), atol=0.02)
    np.testing.assert_allclose(found.std(axis=0), 0.2, rtol=0.05)


def test_ranges_are_the_distances_to_walls():
    async def act(robot, building, runtime):
        await runtime.clock.sleep(0.5)
        return robot.ranges

    behind, right, ahead, left = driven(act, floor=offices(), at=Pose(5.5, 7.25), beams=5, reach=4.0)[:4]
    assert behind == pytest.approx(4.0)  # the corridor is longer than the reach
    assert ahead == pytest.approx(4.0)
    assert right == pytest.approx(1.175, abs=0.051)  # a cell
    assert left == pytest.approx(1.175, abs=0.051)  # a cell


def test_a_robot_sees_what_is_near_and_not_behind_a_wall():
    async def act(robot, building, runtime):
        assert robot.sees(11.0, 7.0)
        assert not robot.sees(17.0, 7.0)  # too far
        assert robot.sees(17.0, 7.0, reach=20.0)
        assert not robot.sees(9.0, 10.0)  # a wall
        assert not robot.sees(100.0, 7.0, reach=200.0)

    driven(act, floor=offices())
