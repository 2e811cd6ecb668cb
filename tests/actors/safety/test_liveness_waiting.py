"""Waiting: an ensemble that should decide and does not know its state says so."""

from __future__ import annotations

import asyncio

from mdm import Ensemble, FixedRate, PredicateManager, StateFactor
from mdm.testing import probe, run_virtual


def two(manager, **options):
    return Ensemble(
        "robot",
        policy=[0, 0, 0, 1],
        actions={"A": lambda: None, "B": lambda: None},
        predicates=manager,
        states=[StateFactor("p", ["P"]), StateFactor("q", ["Q"])],
        **options,
    )


def waits(faults):
    return [(fault.time / 1e9, fault.detail) for fault in faults if fault.kind == "waiting"]


def test_it_is_told_once_and_again_when_it_changes():
    async def main(runtime):
        manager = PredicateManager()
        sensor, other = manager.sensor("S"), manager.sensor("Q")
        manager.define("P", "not S")
        robot = two(manager)
        faults = probe(runtime.faults)
        await runtime.start(robot)
        assert robot.statistics().waiting == ("Q", "S")
        await asyncio.sleep(5)
        assert waits(faults) == [(1.0, "cannot decide while Q and S are unknown")]
        sensor.set(True)
        assert waits(faults)[1:] == [(5.0, "cannot decide while Q is unknown")]
        assert robot.statistics().waiting == ("Q",)
        other.set(True)
        await asyncio.sleep(5)
        assert robot.statistics().waiting == ()
        assert len(waits(faults)) == 2
        other.set(None)
        await asyncio.sleep(5)
        assert waits(faults)[2:] == [(11.0, "cannot decide while Q is unknown")]

    run_virtual(main)


def test_who_knows_within_a_second_is_silent():
    async def main(runtime):
        manager = PredicateManager()
        sensors = [manager.sensor("P"), manager.sensor("Q")]
        faults = probe(runtime.faults)
        await runtime.start(two(manager, drive=FixedRate(2.0)))
        for sensor in sensors:
            await asyncio.sleep(0.4)
            sensor.set(True)
        await asyncio.sleep(5)
        assert waits(faults) == []

    run_virtual(main)


def test_a_child_waits_once_it_is_started_and_a_stopped_one_does_not():
    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("P", initial=True)
        manager.sensor("Q")
        child = Ensemble(
            "child", policy=[0, 0], actions={"A": lambda: None}, predicates=manager, states=[StateFactor("q", ["Q"])]
        )
        top = Ensemble("top", policy=[0, 1], actions={"Child": child, "Idle": lambda: None})
        faults = probe(runtime.faults)
        await runtime.start(manager)
        await runtime.start(top)
        await asyncio.sleep(5)
        assert [fault.source for fault in faults] == ["top"]
        assert faults[0].detail == "cannot decide while a state on top/state is unknown"
        top.publish_state(0)
        await asyncio.sleep(5)
        assert [fault.source for fault in faults] == ["top", "top/child"]
        top.publish_state(1)
        await asyncio.sleep(5)
        assert child.statistics().waiting == ()
        assert len(faults) == 2

    run_virtual(main)
