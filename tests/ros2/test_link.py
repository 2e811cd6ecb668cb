"""The link: opened before the first sensor, closed behind the safe actions; where it cannot open, nothing starts."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest
from patience import PATIENCE
from ros2.stand_in import StandIn
from sentences import refused

import mdm
from mdm.errors import Error
from mdm.ros2 import Link, WireError
from mdm.runtime import Actor
from mdm.testing import run_virtual


class Noted(StandIn):
    """A wire that notes what happens with it."""

    def __init__(self, notes, fails=False):
        super().__init__()
        self.notes, self.fails = notes, fails

    async def open(self, runtime):
        if self.fails:
            raise WireError("there is no ROS")
        self.notes.append("opened")
        await super().open(runtime)

    async def close(self):
        self.notes.append("closed")


class Sensor(Actor):
    """An actor that notes its life."""

    def __init__(self, notes):
        super().__init__("sensor")
        self.notes = notes

    def on_start(self):
        self.notes.append("started")

    def on_stop(self):
        self.notes.append("stopped")


def test_it_opens_before_the_actors_and_closes_behind_them():
    notes = []
    link = Link(Noted(notes), mdm.PredicateManager())

    async def main(runtime):
        await runtime.start(Sensor(notes))

    run_virtual(main, extensions=[link])
    assert notes == ["opened", "started", "stopped", "closed"]


def test_a_wire_that_cannot_open_ends_the_start():
    notes = []
    link = Link(Noted(notes, fails=True), mdm.PredicateManager())

    async def main(runtime):
        notes.append("began")

    with refused(WireError):
        run_virtual(main, extensions=[link])
    assert notes == []


class Failing:
    """Reports that fail where they are told to."""

    def __init__(self, where):
        self.where = where

    def open(self, runtime):
        if self.where == "open":
            raise OSError("no reports")

    def close(self):
        if self.where == "close":
            raise OSError("no reports")


@pytest.mark.parametrize("where", ["open", "close"])
def test_the_wire_is_given_back_whatever_fails(where):
    notes = []
    link = Link(Noted(notes), mdm.PredicateManager(), Failing(where))

    async def main(runtime):
        notes.append("began")
        runtime.observe(Faults(notes))

    if where == "open":
        with refused(Error):
            run_virtual(main, extensions=[link])
        assert notes == ["opened", "closed"]
    else:
        run_virtual(main, extensions=[link])
        assert notes == ["opened", "began", "closed", "observer"]


class Faults(mdm.Observer):
    """Notes the kinds of faults."""

    def __init__(self, notes):
        self.notes = notes

    def on_fault(self, fault):
        self.notes.append(fault.kind)


def test_a_link_serves_one_runtime_after_the_other():
    predicates = mdm.PredicateManager()
    link = Link(StandIn(), predicates)
    link.topic("/number", "std_msgs/msg/Float64").predicate("Small", "data < 1 until > 2", max_age=1.0)

    async def main(runtime):
        await runtime.start(predicates)
        told = []
        for data in (1.5, 0.5, 1.5):
            link.wire.send("/number", data=data)
            told.append(predicates.value("Small"))
        await asyncio.sleep(2)
        return [*told, predicates.value("Small")]

    for _ in range(2):
        assert run_virtual(main, extensions=[link]) == [None, True, True, None]


@pytest.mark.parametrize(("imports", "absent"), [("mdm, mdm.config", "mdm.ros2"), ("mdm.ros2", "rclpy")])
def test_who_has_no_link_loads_none_and_the_package_loads_no_ros(imports, absent):
    program = f"import {imports}, sys; raise SystemExit({absent!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=PATIENCE).returncode == 0
