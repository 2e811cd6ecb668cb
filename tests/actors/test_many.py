"""Many ensembles in one runtime: what one event means for all of them takes no stack, and no more time for each."""

from __future__ import annotations

import asyncio
import sys

from mdm import Actor, Ensemble, PredicateManager, StateFactor
from mdm.testing import run_virtual

MANY = 520  # their turns, one within the other, would be more than the stack is deep


def ensembles(log, number, *, max_age=None, shared=False):
    """Ensembles with a safe action each; behind one sensor, or each behind its own."""
    managers = [PredicateManager(f"predicates{place}") for place in range(1 if shared else number)]
    sensors = [manager.sensor("S", initial=False, max_age=max_age) for manager in managers]
    robots = [
        Ensemble(
            f"robot{place}",
            policy=[0, 1],
            actions={"Rest": lambda: log.append("rest"), "Go": lambda: log.append("go")},
            predicates=managers[0 if shared else place],
            states=[StateFactor("s", ["S"])],
            safe_action=lambda: log.append("safe"),
        )
        for place in range(number)
    ]
    return robots, sensors


def test_many_ensembles_start_decide_and_end():
    log = []

    async def main(runtime):
        robots, sensors = ensembles(log, MANY)
        for one in robots:
            await runtime.start(one)
        assert log == ["rest"] * MANY
        for sensor in sensors:
            sensor.set(True)
        assert log[MANY:] == ["go"] * MANY
        log.clear()

    run_virtual(main)
    assert log == ["safe"] * MANY


def test_a_sensor_that_goes_stale_makes_all_behind_it_safe_and_they_come_back():
    assert sys.getrecursionlimit() < 2 * MANY
    log = []

    async def main(runtime):
        robots, (sensor,) = ensembles(log, MANY, max_age=1.0, shared=True)
        for one in robots:
            await runtime.start(one)
        sensor.set(True)
        log.clear()
        await asyncio.sleep(2.0)
        assert log == ["safe"] * MANY
        assert {one.mode for one in robots} == {"safe"}
        sensor.set(False)
        assert log[MANY:] == ["rest"] * MANY
        assert {one.mode for one in robots} == {"deciding"}
        assert {one.life for one in robots} == {"running"}

    run_virtual(main)


def test_what_a_start_costs_does_not_grow_with_the_number_of_siblings():
    """Counted as comparisons of names, whatever the machine does besides."""
    compared = [0]

    class Name(str):
        __slots__ = ()

        def __eq__(self, other):
            compared[0] += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    async def main(runtime):
        for number in range(300):
            await runtime.start(Actor(Name(f"actor{number}")))

    run_virtual(main)
    assert compared[0] < 3000
