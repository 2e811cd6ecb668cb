"""Handles of sensors' code, and what a truth value is."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

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
