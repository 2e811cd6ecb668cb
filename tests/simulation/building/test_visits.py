"""Visits, against what exponential times say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from maps.floors import Floor, offices
from sentences import refused

import mdm
from mdm.errors import ConfigError, MapError
from mdm.simulation.building import Building, VisitChange, Visits


@pytest.mark.parametrize("seconds", [1500.0, pytest.param(3600.0, marks=pytest.mark.slow)])
def test_visits_come_and_go_at_their_rates(seconds):
    building = Building(
        offices().map(), visits=[Visits("person", every=20.0, stay=60.0, places=["lab", "west"])], seed=5
    )
    changes = []

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/visits", VisitChange).subscribe(changes.append)
            await runtime.start(building)
            await runtime.clock.sleep(seconds)

    mdm.run(main, virtual=True)
    came = [change for change in changes if change.came]
    assert abs(len(came) - seconds / 20) < 4 * math.sqrt(seconds / 20)
    assert {change.place for change in came} == {"lab", "west"}
    assert abs(sum(change.place == "lab" for change in came) - len(came) / 2) < 2 * math.sqrt(len(came))
    begun = {change.number: change.time for change in came}
    stays = [(change.time - begun[change.number]) / 1e9 for change in changes if not change.came]
    assert abs(sum(stays) / len(stays) - 60.0) < 4 * 60.0 / math.sqrt(len(stays))
    for change in came:
        assert building.floor.labels.name(change.x, change.y) == change.place


def spread(seconds):
    """Return the standard deviation of times over their mean: 1 where they are exponential."""
    return np.std(seconds) / np.mean(seconds)


@pytest.mark.parametrize("seconds", [2400.0, pytest.param(7200.0, marks=pytest.mark.slow)])
def test_times_of_visits_are_exponential(seconds):
    building = Building(offices().map(), visits=[Visits("person", every=10.0, stay=30.0)], seed=7)
    changes = []

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/visits", VisitChange).subscribe(changes.append)
            await runtime.start(building)
            await runtime.clock.sleep(seconds)

    mdm.run(main, virtual=True)
    came = {change.number: change.time / 1e9 for change in changes if change.came}
    error = 1 / math.sqrt(seconds / 10)  # of the spread of so many exponential times
    assert abs(spread(np.diff(list(came.values()))) - 1) < 4 * error
    stays = [change.time / 1e9 - came[change.number] for change in changes if not change.came]
    assert abs(spread(stays) - 1) < 4 * error


def test_what_has_to_be_seen_to_stays_until_then():
    building = Building(offices().map(), visits=[Visits("fire")], seed=1)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            await runtime.clock.sleep(1000.0)
            assert building.present("fire") == ()
            fire = building.come("fire", "lab")
            await runtime.clock.sleep(1000.0)
            assert building.present("fire") == building.present("fire", "lab") == (fire,)
            assert building.present("fire", "west") == ()
            building.go(fire)
            building.go(fire)
            assert building.present("fire") == ()

    mdm.run(main, virtual=True)


CLOSET = Floor(
    6.0,
    4.0,
    {"room": (0.0, 0.0, 5.0, 4.0), "closet": (5.0, 0.0, 5.8, 4.0)},
    {("closet", "room"): (4.8, 1.7, 5.2, 2.3)},
)


def test_wrong_visits_are_refused():
    floor = offices().map()
    with refused(ConfigError):
        Visits("fire", every=-1)
    for places in ([], "lab"):
        with refused(ConfigError):
            Visits("fire", places=places)
    with refused(MapError):
        Building(CLOSET.map(), visits=[Visits("fire")])
    with refused(ConfigError):
        Building(floor, visits=[Visits("fire"), Visits("fire")])
    with refused(MapError):
        Building(floor, visits=[Visits("fire", places=["attic"])])
    with refused(ConfigError):
        Building(floor, visits=[Visits("fire")]).present("flood")
