"""Guests: robots of other processes on the same floor."""

from __future__ import annotations

import asyncio
import math

import pytest
from passage import MIDDLE, PASSAGE, Scripted
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error, MapError
from mdm.maps import Pose
from mdm.simulation.building import Building, Whereabouts
from mdm.team.sharing.remote import Wire


def living(act, building):
    """Carry something out beside a building, in virtual time."""

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            return await act(runtime)

    return mdm.run(main, virtual=True)


def test_a_guest_goes_on_between_two_words_and_is_gone_a_second_later():
    building = Building(PASSAGE.map(), seed=1)
    guest = building.guest("bob")

    async def act(runtime):
        assert not guest.is_here
        assert guest.pose.x > 1000
        await runtime.clock.sleep(0.25)
        guest.take(Whereabouts(0, 7.0, MIDDLE, 0.5, (0.4, -0.2), 5.0, ((9.0, MIDDLE), (12.0, 1.0))))
        await runtime.clock.sleep(0.1)
        assert guest.pose == Pose(7.0, MIDDLE, 0.5)
        await runtime.clock.sleep(0.5)
        assert (guest.pose.x, guest.pose.y) == pytest.approx((7.2, MIDDLE - 0.1))
        assert guest.agent.velocity.tolist() == pytest.approx([0.4, -0.2], abs=1e-6)
        assert guest.remaining == 5.0
        assert guest.turns == tuple(PASSAGE.frame.cell(*point) for point in ((9.0, MIDDLE), (12.0, 1.0)))
        guest.take(Whereabouts(0, 7.5, MIDDLE, 0.5, (0.0, 0.0), 0.0, ()))
        await runtime.clock.sleep(0.9)
        assert guest.is_here
        assert (guest.pose, guest.remaining, guest.turns) == (Pose(7.5, MIDDLE, 0.5), 0.0, ())
        await runtime.clock.sleep(0.3)
        assert not guest.is_here
        assert guest.pose.x > 1000
        assert (guest.remaining, guest.turns) == (0.0, ())

    living(act, building)


def test_points_that_are_not_on_this_floor_are_left_out_of_a_way():
    guest = Building(PASSAGE.map()).guest("bob")
    guest.take(Whereabouts(0, 7.0, MIDDLE, 0.0, (0.0, 0.0), 5.0, ((math.nan, 0.0), (900.0, 1.0), (9.0, MIDDLE))))
    guest.steer(0.1)
    assert guest.turns == (PASSAGE.frame.cell(9.0, MIDDLE),)


def test_a_robot_tells_where_it_is_and_drives():
    building, told = Building(PASSAGE.map(), seed=1), []
    robot = building.robot("ada", at=Pose(2.0, 0.5, 0.0))

    async def act(runtime):
        runtime.channel("building/ada/whereabouts", Whereabouts).subscribe(told.append)
        await runtime.clock.sleep(0.05)
        assert told[-1] == Whereabouts(told[-1].time, 2.0, 0.5, 0.0, (0.0, 0.0), 0.0, ())
        drive = asyncio.create_task(robot.go(Pose(9.0, MIDDLE)))
        await runtime.clock.sleep(4.0)
        one, other = told[-2:]
        assert other.time - one.time == 100_000_000
        assert Pose(other.x, other.y, other.yaw) == robot.pose
        assert 0.3 < math.hypot(*other.velocity) < 0.51
        assert (other.x - one.x, other.y - one.y) == pytest.approx([0.1 * speed for speed in other.velocity], abs=0.005)
        assert told[-10].remaining > other.remaining == robot.remaining > 4.0
        assert len(other.way) > 1
        assert other.way[-1] == pytest.approx((9.0, MIDDLE), abs=0.05)
        await drive
        await runtime.clock.sleep(5.0)
        assert told[-1].velocity == pytest.approx((0.0, 0.0), abs=0.001)
        assert (told[-1].remaining, told[-1].way) == (0.0, ())

    living(act, building)


@pytest.mark.parametrize("place", [0, 1, 2, 3, 4])
def test_what_is_not_finite_is_refused(place):
    guest = Building(PASSAGE.map()).guest("bob")
    numbers = [math.nan if index == place else 1.0 for index in range(5)]
    with refused(Error):
        guest.take(Whereabouts(0, *numbers[:3], (numbers[3], 0.0), numbers[4], ()))


def test_a_guest_that_no_robot_could_be_is_refused():
    building = Building(PASSAGE.map())
    building.robot("ada", at="west")
    building.guest("bob")
    for name in ("ada", "bob"):
        with refused(ConfigError):
            building.guest(name)
    with refused(ConfigError):
        building.robot("bob", at="east")
    with refused(ConfigError):
        building.guest("eve", radius=0)


def test_a_robot_cannot_be_put_where_a_guest_is():
    building = Building(PASSAGE.map())
    guest = building.guest("bob")
    building.robot("ada", at="west")
    guest.take(Whereabouts(0, 15.0, MIDDLE, 0.0, (0.0, 0.0), 0.0, ()))
    guest.steer(0.1)
    with refused(MapError):
        building.robot("eve", at=Pose(15.3, MIDDLE))


def test_a_robot_drives_around_a_guest_and_where_one_was():
    building = Building(PASSAGE.map(), seed=1)
    robot, stands = building.robot("ada", at=Pose(-1.0, 1.0)), Scripted(building, "bob", 2.0)
    stands.y = 1.0

    async def act(runtime):
        telling = asyncio.create_task(stands.keep_telling(runtime.clock))
        drive = asyncio.create_task(robot.go(Pose(4.5, 1.0)))
        nearest = math.inf
        while not drive.done():
            await runtime.clock.sleep(0.1)
            nearest = min(nearest, math.dist((robot.pose.x, robot.pose.y), (2.0, 1.0)))
        assert 0.5 < nearest < 1.0
        assert robot.collisions == 0
        telling.cancel()
        await runtime.clock.sleep(1.5)
        await robot.go(Pose(2.0, 1.0))

    living(act, building)


@pytest.mark.parametrize("apart", [0.0, 0.3, 0.6])
def test_a_guest_that_comes_in_the_midst_of_a_robot_waits_until_that_has_left(apart):
    building = Building(PASSAGE.map(), seed=1)
    robot, comes = building.robot("ada", at=Pose(2.0, MIDDLE)), Scripted(building, "bob", 2.0 + apart, 2.5)

    async def act(runtime):
        telling = asyncio.create_task(comes.keep_telling(runtime.clock))
        await runtime.clock.sleep(1.0)
        assert not comes.guest.is_here
        assert (comes.guest.remaining, comes.guest.turns) == (0.0, ())
        await robot.go(Pose(15.0, MIDDLE))
        assert robot.collisions == 0
        assert comes.guest.is_here
        assert comes.guest.pose.x == pytest.approx(2.0 + apart)
        assert comes.guest.turns
        telling.cancel()

    living(act, building)


@pytest.mark.parametrize(
    ("order", "ahead", "delay"),
    [
        (("ada", "bob"), 0.0, 0.15),
        (("bob", "ada"), 3.0, 0.0),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in [
                (("ada", "bob"), 0.0, 0.0),
                (("ada", "bob"), 3.0, 0.0),
                (("ada", "bob"), 3.0, 0.15),
                (("bob", "ada"), 0.0, 0.0),
                (("bob", "ada"), 0.0, 0.15),
                (("bob", "ada"), 3.0, 0.15),
            ]
        ),
    ],
)
def test_robots_of_two_buildings_give_way_as_those_of_one(order, ahead, delay):
    ends = {"ada": (Pose(2.0 + ahead, MIDDLE), Pose(15.0, MIDDLE)), "bob": (Pose(15.0, MIDDLE), Pose(2.0, MIDDLE))}
    wire = Wire(Whereabouts)
    buildings = {own: Building(PASSAGE.map(), seed=1, name=f"floor of {own}") for own in ends}
    robots = {}
    guests = {}
    for own, building in buildings.items():
        for name in order:
            if name == own:
                robots[name] = building.robot(name, at=ends[name][0])
            else:
                guests[name] = building.guest(name)

    async def main():
        loop = asyncio.get_running_loop()
        async with mdm.Runtime(log=None) as runtime:
            for name, guest in guests.items():

                def take(message, guest=guest):
                    loop.call_later(delay, guest.take, wire.decode(wire.encode(message)))

                runtime.channel(f"floor of {name}/{name}/whereabouts", Whereabouts).subscribe(take)
            for building in buildings.values():
                await runtime.start(building)
            drives = [asyncio.create_task(robot.go(ends[name][1])) for name, robot in robots.items()]
            nearest = math.inf
            while not all(drive.done() for drive in drives):
                await runtime.clock.sleep(0.1)
                ada, bob = (robot.pose for robot in robots.values())
                nearest = min(nearest, math.dist((ada.x, ada.y), (bob.x, bob.y)))
            return await asyncio.gather(*drives, return_exceptions=True), nearest, runtime.clock.now() / 1e9

    ended, nearest, seconds = mdm.run(main, virtual=True)
    assert ended == [None, None]
    assert [robot.collisions for robot in robots.values()] == [0, 0]
    assert 0.5 < nearest < 1.0
    assert seconds < 75.0
