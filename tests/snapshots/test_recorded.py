"""Snapshots of a record, against those of the same run while it was running."""

from __future__ import annotations

import asyncio
import tempfile
from collections import Counter

import msgspec
import pytest
from decided import ensemble
from sentences import refused
from shown import a_robot

import mdm
from mdm import Error
from mdm.config.recorded import attach_configuration, load_recorded
from mdm.recording import Record, Recorder
from mdm.snapshots import Event, LiveRun, RecordedRun
from mdm.testing import run_virtual


@pytest.fixture
def robot(tmp_path):
    """Record a robot; return the frames that were seen while it ran, the events, and the record."""
    file = a_robot(tmp_path)
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, file)
    frames = []

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(mdm.load_system(file))
        for _ in range(600):
            frames.append((runtime.now(), live.frame({"top", "top/walk"})))
            await asyncio.sleep(0.05 + 1e-6)  # beside the times at which something happens
        return list(live.ring)

    events = run_virtual(main, record=recorder)
    return frames, events, Record(tmp_path / "run.mcap")


def restored(record):
    with tempfile.TemporaryDirectory() as folder:
        system = load_recorded(record, folder)
        run = RecordedRun(record, system, ensembles=system.ensembles, predicates=system.predicates)
    run.restore()
    return run


def test_a_record_shows_what_was_seen_live(robot):
    frames, _, record = robot
    run = restored(record)
    first, _ = record.span
    scene = run.scene()
    assert scene.remarks == ()
    assert {each.definition for each in scene.predicates} >= {"set by code", "not Near"}
    for time, live in frames[2:]:
        frame = run.frame((time - first) / 1e9, {"top", "top/walk"})
        for now, then in zip(frame.ensembles, live.ensembles, strict=True):
            assert (now.mode, now.epoch, now.action, now.decisions) == (
                *(then.mode, then.epoch, then.action, then.decisions),
            )
            assert [life.action for life in now.live] == [life.action for life in then.live]
            assert [cause.kind for cause in now.causes] == [cause.kind for cause in then.causes]
            assert (now.idle is None) == (then.idle is None)
        assert frame.predicates == live.predicates
        for path, detail in live.details.items():
            assert frame.details[path].state == detail.state


def test_its_events_are_those_that_were_seen_live(robot):
    _, events, record = robot
    run = RecordedRun(record)
    encoded, _ = run.after(0, 10**9)
    found = [msgspec.json.decode(each, type=Event) for each in encoded]
    for kind in ("fault", "mode", "idle"):
        seen = [(event.source, event.name, event.status) for event in events if event.kind == kind]
        kept = [(event.source, event.name, event.status) for event in found if event.kind == kind]
        assert kept[: len(seen)] == seen  # what came at the very end was not looked at any more
        assert len(seen) > 1
    ends = [(event.source, event.name, event.life) for event in events if event.status not in {"", "running"}]
    assert {each for each in ends if each[2]} <= {(event.source, event.name, event.life) for event in found}


def test_changes_of_predicates_are_events_as_they_were_live(robot):
    _, events, record = robot
    run = restored(record)
    found = [msgspec.json.decode(each, type=Event) for each in run.after(0, 10**9)[0]]
    kept = [(event.name, event.status) for event in found if event.kind == "predicate"]
    seen = [(event.name, event.status) for event in events if event.kind == "predicate"]
    assert len(seen) > 20
    for name in {name for name, _ in seen}:
        live = [each for each in seen if each[0] == name]
        assert [each for each in kept if each[0] == name][: len(live)] == live  # the last was not looked at any more
    assert [event.number for event in found] == list(range(1, len(found) + 1))


def test_steps_lead_from_one_to_the_next_and_back(robot):
    _, _, record = robot
    run = RecordedRun(record)
    first, _ = record.span
    for kind, topic in (("decision", "decisions"), ("fault", "faults"), ("mode", "modes")):
        times = sorted({(each.time - first) / 1e9 for each in record.messages([topic])})
        at, found = -1.0, []
        at = run.step(kind, run.last, back=True) if run.last not in times else run.last
        while True:
            found.append(at)
            before = run.step(kind, at, back=True)
            if before == at:
                break
            at = before
        assert found[::-1] == times
        forward = [times[0]]
        while (after := run.step(kind, forward[-1])) != forward[-1]:
            forward.append(after)
        assert forward == times
    changes, before = set(), {}
    for each in record.messages(["decisions"]):
        if before.get(each.message.ensemble) != each.message.action:
            changes.add((each.time - first) / 1e9)
        before[each.message.ensemble] = each.message.action
    at, found = -1.0, [0.0] if 0.0 in changes else []
    while (after := run.step("change", at)) != max(at, 0.0):
        found.append(after)
        at = after
    assert found == sorted(changes)
    assert len(found) > 10
    with refused(Error):
        run.step("breath", 0.0)


def test_without_a_configuration_beliefs_have_the_names_of_the_record(tmp_path):
    seen = []

    async def main(runtime):
        robot = ensemble()
        await runtime.start(robot)
        for word in ("hear-left", "hear-left", "hear-right"):
            await asyncio.sleep(1)
            robot.publish_observation(word)
            seen.append(robot.controller.decided_by.copy())

    run_virtual(main, record=tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    run = RecordedRun(record)
    for second, belief in enumerate(seen, 1):
        detail = run.frame(second + 0.5, {"robot"}).details["robot"]
        assert dict(detail.belief.top) == pytest.approx(
            dict(zip(mdm.problems.tiger().state_space.names, belief, strict=True)), abs=1e-6
        )
        assert detail.observation == ("hear-right" if second == 3 else "hear-left")
        heard = [(1.0, "hear-left"), (2.0, "hear-left"), (3.0, "hear-right")][:second]
        assert detail.observations == tuple(heard)
        assert dict(detail.tally) == Counter([name for _, name in heard])
    assert run.scene().ensembles[0].actions[0] == "listen"


def test_a_torn_record_says_so(robot, tmp_path):
    _, _, record = robot
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(record.path.read_bytes()[: record.size * 2 // 3])
    run = RecordedRun(Record(torn))
    assert run.scene().remarks[0] == "the record ends before its run did"
    assert run.scene().remarks[1].endswith(": what follows is not there")
    assert run.frame(run.last).ensembles


def test_it_says_that_the_process_was_killed(robot):
    record = robot[2]
    record.closed = False  # as its file then says
    assert RecordedRun(record).scene().remarks == ("the run's process ended before it closed the record",)


def test_a_step_shows_what_it_leads_to_between_microseconds(tmp_path):
    robot = ensemble()

    async def main(runtime):
        await runtime.start(robot)
        for number in range(20):
            await runtime.clock.sleep(0.1 + 1e-9 * (number * 37 % 100 + 1))
            robot.publish_observation("hear-left")

    run_virtual(main, record=tmp_path / "run.mcap")
    run = RecordedRun(Record(tmp_path / "run.mcap"))
    at, shown = -1.0, []
    while (after := run.step("decision", at)) != max(at, run.first):
        at = msgspec.json.decode(msgspec.json.encode(after))  # as it goes to a browser and comes back
        shown.append(run.frame(at).ensembles[0].epoch)
    assert shown == list(range(1, 21))
