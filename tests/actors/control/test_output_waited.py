"""A deadline counts from when a thread told its input, however long that waited for the event loop."""

from __future__ import annotations

import asyncio
import threading

import pytest
from replay.held import START, recorded
from rows_of_rooms import row_of_rooms

import mdm
from mdm.actors.control.planner import Planner
from mdm.maps import Places, Pose
from mdm.problems import tiger
from mdm.replay import replay

_MS = 1_000_000


def robot_of(calls, **options):
    """A robot that goes where it is near; its sensors, its calls and its deadline are the test's."""
    predicates = mdm.PredicateManager("predicates")
    near, far = predicates.sensor("Near", initial=False), predicates.sensor("Far")
    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"stay": lambda: calls.append("stay"), "go": lambda: calls.append("go")},
        safe_action=lambda: calls.append("safe"),
        **options,
    )
    return robot, near, far


def in_thread(*calls):
    """Make calls from another thread, and wait for its end."""
    thread = threading.Thread(target=lambda: [call() for call in calls])
    thread.start()
    thread.join()


async def delivered():
    """Let the event loop take what threads have told."""
    for _ in range(3):
        await asyncio.sleep(0)


@pytest.mark.parametrize(
    ("deadline", "until", "missed"), [(0.1, 140, False), (0.1, 141, True), (0.8, 840, False), (0.8, 841, True)]
)
@pytest.mark.parametrize("by", ["sensor", "state", "batch"])
def test_input_of_a_thread_that_waited_for_longer_than_the_deadline_misses_it(tmp_path, deadline, until, missed, by):
    calls, faults = [], []
    robot, near, far = robot_of(calls, deadline=deadline)

    def together():
        with robot.predicates.batch():
            near.set(True)
            far.set(False)

    tell = {"sensor": lambda: near.set(True), "state": lambda: robot.publish_state(1), "batch": together}[by]

    async def happen(clock):
        robot.runtime.faults.subscribe(faults.append)
        calls.clear()
        clock.hold_until(40)
        in_thread(tell)
        clock.hold_until(until)
        await delivered()
        clock.hold_until(2000)
        near.set(False)  # in time: the way back
        near.set(True)

    path = tmp_path / "run.mcap"
    recorded(path, [robot], happen)
    found = [(fault.kind, fault.source, (fault.time - START) / _MS) for fault in faults]
    assert found == ([("deadline", "robot/control", until)] if missed else [])
    if missed:
        assert f"{until - 40}.000 ms after its stimulus; the deadline is {deadline} s" in faults[0].detail
    assert calls[0] == ("safe" if missed else "go")
    assert calls[-2:] == ["go", "safe"]  # the way back, and the end
    result = replay(path, [robot_of([], deadline=deadline)[0]])
    assert result.replayed > 1
    assert not result.differences


def test_what_a_thread_says_again_while_it_waits_counts_from_the_first_time(tmp_path):
    """And what it takes back before it says it again from the last."""
    for told, missed in (([True, True, True], True), ([True, False, True], False), ([False, False, True], False)):
        calls, faults = [], []
        robot, near, _ = robot_of(calls, deadline=0.1)

        async def happen(clock, robot=robot, near=near, faults=faults, told=told):
            robot.runtime.faults.subscribe(faults.append)
            for number, value in enumerate(told):
                clock.hold_until(60 * number)
                in_thread(lambda: near.set(value))  # noqa: B023 - called at once
            await delivered()

        recorded(tmp_path / f"{missed}.mcap", [robot], happen)
        assert [fault.kind for fault in faults] == ["deadline"] * missed


def test_what_was_due_while_the_loop_was_held_waited_for_nobody(tmp_path):
    """A timer that is due before the input is delivered has its own time; so has what comes behind it."""
    calls, faults = [], []
    robot, near, far = robot_of(calls, deadline=0.1)

    async def happen(clock):
        robot.runtime.faults.subscribe(faults.append)
        calls.clear()
        clock.hold_until(40)
        in_thread(lambda: far.set(True))
        robot.predicates.call_at(START + 750 * _MS, lambda: near.set(True))
        clock.hold_until(790)
        await delivered()
        calls.append("delivered")
        near.set(False)

    recorded(tmp_path / "run.mcap", [robot], happen)
    assert calls == ["go", "delivered", "stay", "safe"]
    assert faults == []


def test_a_pose_of_a_thread_counts_from_when_it_was_told(tmp_path):
    predicates = mdm.PredicateManager("predicates")
    places = Places(row_of_rooms("Hall", "Kitchen"), predicates, max_age=5)
    calls, faults = [], []
    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("place", ["Hall", "Kitchen"])],
        actions={"stay": lambda: calls.append("stay"), "go": lambda: calls.append("go")},
        safe_action=lambda: calls.append("safe"),
        deadline=0.1,
    )

    async def happen(clock):
        robot.runtime.faults.subscribe(faults.append)
        clock.hold_until(40)
        in_thread(lambda: places.see(Pose(7.0, 2.0)))
        clock.hold_until(790)
        await delivered()

    recorded(tmp_path / "run.mcap", [places, robot], happen)
    assert [fault.kind for fault in faults] == ["deadline"]
    assert calls == ["safe", "safe"]  # and once more at the end


def test_a_search_has_its_deadline_from_when_a_thread_told_its_input(tmp_path, monkeypatch):
    async def no_process(planner):
        await asyncio.Event().wait()

    monkeypatch.setattr(Planner, "_search", no_process)
    calls, faults = [], []
    robot = mdm.Ensemble(
        "tiger",
        model=tiger(),
        policy=mdm.solvers.TreeSearch(tiger(), expansions=10),
        actions={"listen": lambda: None, "open-left": lambda: None, "open-right": lambda: None},
        safe_action=lambda: calls.append("safe"),
        deadline=0.1,
    )

    async def happen(clock):
        robot.runtime.faults.subscribe(faults.append)
        clock.hold_until(101)  # the question at the start is not answered
        clock.let_go()
        faults.clear()
        clock.hold_until(200)
        in_thread(lambda: robot.publish_observation(0))
        clock.hold_until(900)
        await delivered()
        clock.let_go()

    recorded(tmp_path / "run.mcap", [robot], happen)
    assert [(fault.kind, (fault.time - START) / _MS) for fault in faults] == [("deadline", 900)]
    assert "a decision came 700.000 ms after its stimulus" in faults[0].detail
