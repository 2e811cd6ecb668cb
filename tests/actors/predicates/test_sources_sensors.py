"""Handles of sensors' code, and what a truth value is."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from sentences import refused

import mdm
from mdm import Error, PredicateManager
from mdm.actors.predicates.sources import truth
from mdm.testing import run_virtual


@pytest.mark.parametrize(
    ("value", "found"), [(True, True), (False, False), (None, None), (np.True_, True), (np.bool_(0), False)]
)
def test_truth_values(value, found):
    assert truth("A", value) is found


@pytest.mark.parametrize("value", [1, 0, "yes", "", [], 1.0, np.int64(1), np.array([True])])
def test_others_are_refused_by_name(value):
    with refused(Error):
        truth("A", value)


def test_values_are_seen_at_once():
    async def main(runtime):
        manager = PredicateManager()
        door, bell = manager.sensor("DoorIsOpen"), manager.event("Bell")
        manager.latch("Rang", set="Bell", reset="DoorIsOpen")
        await runtime.start(manager)
        assert door.value is None
        bell.fire()
        assert manager.value("Rang") is True
        for value in (np.True_, False, None):
            door.set(value)
            assert door.value is (None if value is None else bool(value))
        assert manager.value("Rang") is False
        with refused(Error):
            door.set("open")
        assert door.value is None

    run_virtual(main)


def test_what_a_thread_tells_after_the_end_is_counted_and_raises_nothing():
    predicates = PredicateManager()
    near, bell = predicates.sensor("Near", initial=False), predicates.event("Bell")
    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"stay": lambda: None, "go": lambda: None},
    )

    async def main(runtime):
        await runtime.start(robot)
        near.set(False)
        return runtime

    runtime = run_virtual(main)
    raised = []

    def together():
        with predicates.batch():
            near.set(True)

    def drive():
        for call in (
            *(lambda: near.set(True), lambda: predicates.sense("Near", True), bell.fire, together),
            *(lambda: predicates.occur("Bell"), lambda: robot.publish_state(1)),
        ):
            try:
                call()
            except Exception as error:
                raised.append(error)

    driver = threading.Thread(target=drive)
    driver.start()
    driver.join()
    assert raised == []
    assert runtime.statistics().dispatcher.refused == 6
    assert near.value is False


def test_a_sensor_shows_its_predicate_and_its_value():
    sensor = PredicateManager().sensor("DoorIsOpen")
    assert repr(sensor) == "<Sensor 'DoorIsOpen': None>"
