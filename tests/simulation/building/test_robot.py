"""Robots: they come where they are sent, or say why not."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from maps.floors import FURNITURE, Floor, flat, offices
from passage import MIDDLE, PASSAGE, Scripted
from sentences import refused

import mdm
from mdm.maps import Pose
from mdm.simulation.building import Building, DriveError, Whereabouts
from mdm.simulation.building.refuge import refuge


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
        assert robot.goal == goal
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
        with refused(DriveError):
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
        with refused(DriveError):
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


# -- Giving way ------------------------------------------------------------------------------------------------------

EAST = Pose(15.0, MIDDLE)


def met(act, *guests, first="guests", at=8.25):
    """Carry something out with a robot that is in a passage on its way to the east, and others who are there.

    Args:
        act: Takes the robot, what waits until that is aside or is not, the guests, and the clock.
        guests: Where each is, and how far it has to go to the west.
        first: Who was put there first, the ``guests`` or the ``robot``.
        at: Where the robot is.
    """
    building = Building(PASSAGE.map(), seed=1)
    scripted = [Scripted(building, f"guest{number}", *guest) for number, guest in enumerate(guests)]
    robot = building.robot("ada", at=Pose(at, MIDDLE))
    if first == "robot":
        building = Building(PASSAGE.map(), seed=1)
        robot = building.robot("ada", at=Pose(at, MIDDLE))
        scripted = [Scripted(building, f"guest{number}", *guest) for number, guest in enumerate(guests)]

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            clock = runtime.clock
            tasks = [asyncio.create_task(one.keep_telling(clock)) for one in scripted]
            drive = asyncio.create_task(robot.go(EAST))
            await clock.sleep(0.05)

            async def until(aside, most=60.0):
                """Return the seconds until the robot is aside, or is not any more; None where that lasts longer."""
                begin = clock.now()
                while is_aside(robot) is not aside:
                    await clock.sleep(0.1)
                    if drive.done() or clock.now() - begin > most * 1e9:
                        return None
                return (clock.now() - begin) / 1e9

            try:
                return await act(robot, until, scripted, clock)
            finally:
                for task in (*tasks, drive):
                    task.cancel()
                await asyncio.gather(*tasks, drive, return_exceptions=True)

    return mdm.run(main, virtual=True)


def is_aside(robot):
    return robot.remaining > 0 and not robot.turns


BLOCKING = (9.0, 9.5)
"""In front of the robot, on its way to the west."""


@pytest.mark.parametrize(("first", "least", "most"), [("guests", 1.8, 3.5), ("robot", 5.8, 7.5)])
def test_the_later_one_of_two_gives_way_first(first, least, most):
    async def act(robot, until, guests, clock):
        return await until(aside=True)

    assert least <= met(act, BLOCKING, first=first) <= most


def test_what_a_held_loop_has_not_stepped_is_not_waiting():
    async def act(robot, until, guests, clock):
        await clock.sleep(0.5)
        for _ in range(2):
            asyncio.get_running_loop()._virtual.now += 5_000_000_000
            for guest in guests:
                guest.tell()
            await clock.sleep(0.1)
        assert guests[0].guest.is_here
        assert robot.turns  # it is neither aside nor at its wits' end
        return robot.pose.x

    assert met(act, BLOCKING, first="robot") < 8.5


def test_a_robot_that_gets_on_gives_no_way():
    """Who blocked it is away every second; only what it has waited since it came nearer counts."""

    async def act(robot, until, guests, clock):
        for _ in range(8):
            assert await until(aside=True, most=1.5) is None
            guests[0].x += 0.25
        return robot.pose.x

    assert met(act, (8.95, 9.5)) > 9.0


@pytest.mark.parametrize(
    ("others", "seconds"),
    [
        ([], None),  # it only stands
        ([(10.5, 11.0)], (1.8, 4.5)),
        ([(12.5, 13.0)], None),  # it is too far away
    ],
)
def test_a_robot_gives_way_to_those_who_drive_near_it(others, seconds):
    async def act(robot, until, guests, clock):
        return await until(aside=True, most=10.0)

    found = met(act, (9.0, 0.0), *others)
    assert found is None if seconds is None else seconds[0] <= found <= seconds[1]


def test_who_only_stands_there_is_not_the_one_that_goes_first():
    """The robot was put there before the one that drives, though after the one that stands."""
    building = Building(PASSAGE.map(), seed=1)
    stands = Scripted(building, "stands", 9.0)
    robot = building.robot("ada", at=Pose(8.25, MIDDLE))
    drives = Scripted(building, "drives", 10.0, 11.0)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            tasks = [asyncio.create_task(one.keep_telling(runtime.clock)) for one in (stands, drives)]
            tasks.append(asyncio.create_task(robot.go(EAST)))
            await runtime.clock.sleep(5.5)
            assert not is_aside(robot)
            await runtime.clock.sleep(2.5)
            assert is_aside(robot)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    mdm.run(main, virtual=True)


def test_a_robot_between_two_others_has_nowhere_to_go(monkeypatch):
    """It looks for a refuge, which takes its time, once in a while and not in every step."""
    looked = []

    def look(*arguments):
        looked.append(refuge(*arguments))
        return looked[-1]

    monkeypatch.setattr("mdm.simulation.building.robot.refuge", look)

    async def act(robot, until, guests, clock):
        return await until(aside=True, most=20.0)

    assert met(act, BLOCKING, (7.5, 0.0)) is None
    assert 5 <= len(looked) <= 10
    assert set(looked) == {None}


def test_a_robot_aside_leaves_room_to_pass():
    async def act(robot, until, guests, clock):
        await until(aside=True)
        await clock.sleep(14.0)
        assert is_aside(robot)
        return robot.pose

    there = met(act, BLOCKING)
    assert there.x < 5.0  # in the room
    assert abs(there.y - MIDDLE) > 0.8  # both have a radius of 0.25, and there are 0.4 between the two


@pytest.mark.parametrize(
    ("driven", "is_over"),
    [
        ([0.0], False),
        ([1.9], False),
        ([2.1], True),
        ([-2.1], True),  # it goes elsewhere
        ([9.5], True),  # it stands
        ([2.1, 0.0], False),
        ([2.1, 11.0], True),
        ([2.1, 2.1], True),
    ],
)
def test_a_stay_aside_ends_when_all_others_have_driven_on(driven, is_over):
    async def act(robot, until, guests, clock):
        await until(aside=True)
        await clock.sleep(13.0)
        assert is_aside(robot)
        for guest, metres in zip(guests, driven, strict=True):
            guest.remaining -= metres
        await clock.sleep(0.3)
        assert is_aside(robot) is not is_over
        if is_over:
            column = robot.turns[0][1]  # it looks for its way from where it is: the goal is not in sight
            assert 4.5 < PASSAGE.frame.centre(0, column)[0] < 6.0

    met(act, *[BLOCKING, (10.5, 11.0)][: len(driven)])


def test_a_stay_aside_ends_in_time_and_is_not_waiting():
    """Who never passes is in the way; the half minute of patience has what the robot was aside added."""

    async def act(robot, until, guests, clock):
        stays, tries = [], []
        while (seconds := await until(aside=True)) is not None:
            tries.append(seconds)
            stays.append(await until(aside=False))
        return stays, tries, clock.now() / 1e9

    stays, tries, end = met(act, BLOCKING)
    assert len(stays) >= 3
    assert all(15.0 <= seconds <= 15.3 for seconds in stays)
    assert all(seconds > 1.8 for seconds in tries)  # it comes back and tries again before it gives way again
    assert end == pytest.approx(sum(stays) + 30.0, abs=4.0)


def test_a_robot_aside_that_is_sent_elsewhere_goes_at_once():
    async def act(robot, until, guests, clock):
        await until(aside=True)
        await clock.sleep(1.0)
        drive = asyncio.create_task(robot.go(Pose(-1.0, MIDDLE)))
        await clock.sleep(0.2)
        assert not is_aside(robot)
        begin = clock.now()
        await drive
        return (clock.now() - begin) / 1e9

    assert met(act, BLOCKING) < 30.0


@settings(max_examples=12)
@given(
    gap=st.floats(0.0, 0.7), tilt=st.floats(-1.2, 1.2), aside=st.floats(-0.4, 0.4), far=st.floats(0.6, 1.5),
    yaw=st.floats(-math.pi, math.pi),
)  # fmt: skip
@example(gap=0.6, tilt=0.64, aside=0.0, far=0.7, yaw=-0.4)
@example(gap=0.578125, tilt=0.5, aside=0.0, far=1.0, yaw=0.0)
def test_a_robot_comes_past_two_that_stand_close_together(gap, tilt, aside, far, yaw):
    """Between them, if there is room, or around; it gets in between, and out again, where there hardly is."""
    building = Building(Floor(8.0, 8.0, {"hall": (0.0, 0.0, 8.0, 8.0)}, {}).map(), seed=1)
    middle, apart = (2.0, 3.0), 0.2 + gap / 2
    robot = building.robot("ada", at=Pose(middle[0] + aside, middle[1] - far, yaw), speed=1.0)
    guests = [building.guest(name, radius=0.2) for name in ("left", "right")]
    places = [(middle[0] + side * math.cos(tilt), middle[1] + side * math.sin(tilt)) for side in (-apart, apart)]
    if any(math.dist(place, (robot.pose.x, robot.pose.y)) < 0.48 for place in places):
        return

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)

            async def stand():
                while True:
                    for guest, place in zip(guests, places, strict=True):
                        guest.take(Whereabouts(0, *place, 0.0, (0.0, 0.0), 0.0, ()))
                    await asyncio.sleep(0.5)

            standing = asyncio.create_task(stand())
            await robot.go(Pose(middle[0], middle[1] + 1.5, 1.5))
            standing.cancel()

    mdm.run(main, virtual=True)
    assert robot.collisions == 0
