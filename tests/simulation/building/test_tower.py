"""The tower: robots that take lifts from floor to floor, in virtual time."""

from __future__ import annotations

import asyncio
from itertools import pairwise

import pytest
from building_file import BUILDING, write_building
from sentences import refused

import mdm
from mdm.errors import ConfigError, MapError
from mdm.maps import Places, Pose, load_floors
from mdm.messages import PoseUpdate
from mdm.simulation.building import DriveError, Tower, Visits


@pytest.fixture
def floors(tmp_path):
    return load_floors(write_building(tmp_path))


def goal(tower, name):
    return tower.floors.graph.node(name).goal


def run(tower, script, *others):
    """Return what a script returns that has the runtime of a tower that has started."""
    results = []

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            for actor in (*others, tower):
                await runtime.start(actor)
            results.append(await script(runtime))

    mdm.run(main, virtual=True)
    return results[0]


def robot(tower, name="ada", at="ground.store", **options):
    return tower.robot(name, at=at, radius=0.12, **options)


def test_a_ride_takes_its_seconds_and_ends_on_the_other_floor(floors):
    tower = Tower(floors, seed=1)
    ada = robot(tower, noise=0.0)

    async def script(runtime):
        told = []
        runtime.channel("building/ada/pose", PoseUpdate).subscribe(told.append)
        before = runtime.clock.now()
        ride = asyncio.create_task(ada.ride("lift", goal(tower, "upper.store")))
        await runtime.clock.sleep(6.0)
        assert ada.rides
        assert (ada.floor, ada.pose) == ("ground", goal(tower, "ground.store"))
        await ride
        assert runtime.clock.now() - before == pytest.approx(12e9, abs=2e8)
        assert not ada.rides
        assert (ada.floor, ada.pose) == ("upper", goal(tower, "upper.store"))
        await runtime.clock.sleep(1.0)
        await ada.go(goal(tower, "upper.hall"))
        assert abs(ada.pose.x) < 0.3
        return [(pose.time / 1e9, pose.floor, pose.x) for pose in told]

    told = run(tower, script)
    times = [time for time, _, _ in told]
    assert max(later - time for time, later in pairwise(times)) < 0.15  # it is never silent
    floors_told = [floor for _, floor, _ in told]
    assert floors_told == sorted(floors_told)  # ground, then upper
    assert {x for time, _, x in told if time < 12.0} == {2.0}
    assert ada.collisions == 0


def test_the_same_seed_gives_the_same_run(floors):
    def poses():
        tower = Tower(floors, seed=3, visits={"upper": [Visits("person", every=5.0, stay=10.0)]})
        ada = robot(tower)

        async def script(runtime):
            told = []
            runtime.channel("building/ada/pose", PoseUpdate).subscribe(told.append)
            await ada.go(goal(tower, "ground.store"))
            await ada.ride("lift", goal(tower, "upper.store"))
            await ada.go(goal(tower, "upper.hall"))
            return told

        return run(tower, script)

    assert poses() == poses()


def test_two_robots_that_meet_at_the_lift_change_floors(floors):
    tower = Tower(floors, seed=1)
    ada, bob = robot(tower), robot(tower, "bob", "upper.store")

    async def script(runtime):
        rides = ada.ride("lift", goal(tower, "upper.store")), bob.ride("lift", goal(tower, "ground.store"))
        await asyncio.gather(*rides)
        return runtime.clock.now() / 1e9

    assert run(tower, script) == pytest.approx(24.0, abs=0.5)  # one after the other
    assert (ada.floor, bob.floor) == ("upper", "ground")
    assert (ada.collisions, bob.collisions) == (0, 0)


def test_who_stands_before_the_lift_is_waited_for(floors):
    tower = Tower(floors, seed=1)
    ada, bob = robot(tower), robot(tower, "bob", "upper.store")

    async def script(runtime):
        with refused(DriveError):
            await ada.ride("lift", goal(tower, "upper.store"))
        assert runtime.clock.now() / 1e9 == pytest.approx(42.0, abs=0.5)
        assert ada.rides
        on = asyncio.create_task(ada.go(goal(tower, "upper.hall")))
        await runtime.clock.sleep(5.0)
        assert ada.rides
        await bob.go(goal(tower, "upper.office"))
        await on
        assert not ada.rides

    run(tower, script)
    assert (ada.collisions, bob.collisions) == (0, 0)


def test_a_ride_that_is_cancelled_ends_where_it_began(floors):
    tower = Tower(floors, seed=1)
    ada = robot(tower)

    async def script(runtime):
        ride = asyncio.create_task(ada.ride("lift", goal(tower, "upper.store")))
        await runtime.clock.sleep(5.0)
        ride.cancel()
        await asyncio.gather(ride, return_exceptions=True)
        assert (ada.rides, ada.floor) == (True, "ground")
        await ada.go(goal(tower, "ground.hall"))
        assert (ada.rides, ada.floor) == (False, "ground")
        await ada.go(goal(tower, "ground.store"))
        ride = asyncio.create_task(ada.ride("lift", goal(tower, "upper.store")))
        await runtime.clock.sleep(5.0)
        ride.cancel()
        await asyncio.gather(ride, return_exceptions=True)
        await ada.ride("lift", goal(tower, "upper.store"))  # out of the lift, and in again
        assert (ada.rides, ada.floor) == (False, "upper")

    run(tower, script)


def test_what_cannot_be_done_is_told(floors):
    tower = Tower(floors, seed=1)
    ada = robot(tower, at="ground.hall")

    async def script(runtime):
        await runtime.clock.sleep(0.5)
        for drive, words in (
            (ada.go(goal(tower, "upper.hall")), "robot 'ada' is on 'ground', and cannot drive to 'upper'"),
            (ada.ride("lift", goal(tower, "upper.store")), "robot 'ada' is at 0.00, 3.00, and not before 'lift'"),
            (ada.ride("stairs", goal(tower, "upper.store")), "no lift 'stairs' takes robot 'ada' from 'ground' to"),
            (ada.ride("lift", goal(tower, "ground.store")), "no lift 'lift' takes robot 'ada' from 'ground' to 'grou"),
        ):
            with pytest.raises(DriveError) as caught:
                await drive
            assert words in str(caught.value)

    run(tower, script)
    with refused(ConfigError):
        robot(tower, at="upper.hall")
    with refused(MapError):
        robot(tower, "bob", Pose(0.0, 3.0))
    with refused(ConfigError):
        Tower(floors, visits={"roof": []})


def test_a_slide_leads_down_alone(tmp_path):
    slide = BUILDING.replace('"ground.store", "upper.store"', '"upper.store", "ground.store"') + "one_way = true\n"
    tower = Tower(load_floors(write_building(tmp_path, slide)), seed=1)
    ada = robot(tower, at="upper.store")

    async def script(runtime):
        await ada.ride("lift", goal(tower, "ground.store"))
        with refused(DriveError):
            await ada.ride("lift", goal(tower, "upper.store"))

    run(tower, script)
    assert ada.floor == "ground"


def test_a_robot_that_rides_is_in_its_place_until_it_is_on_the_other_floor(floors):
    tower = Tower(floors, seed=1)
    predicates = mdm.PredicateManager()
    places = Places(floors, predicates)
    ada = robot(tower, places=places)

    async def script(runtime):
        faults = []
        runtime.faults.subscribe(faults.append)
        await runtime.clock.sleep(0.3)
        ride = asyncio.create_task(ada.ride("lift", goal(tower, "upper.store")))
        found = set()
        for _ in range(11):
            await runtime.clock.sleep(1.0)
            found.add(places.place)
        await ride
        await runtime.clock.sleep(0.3)
        return found, places.place, faults

    assert run(tower, script, places) == ({"ground.store"}, "upper.store", [])
