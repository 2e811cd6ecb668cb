"""Records that are shown by their summaries, against those of which all is read."""

from __future__ import annotations

import asyncio
import logging
import random
import zlib
from collections import Counter
from itertools import pairwise

import msgspec
import pytest
from replay.systems import System
from sentences import refused
from shown import a_robot

import mdm
from mdm.cli.records import page
from mdm.cli.records.page import recorded_run
from mdm.config.recorded import attach_configuration
from mdm.errors import Error
from mdm.messages import PoseUpdate
from mdm.recording import Record, Recorder
from mdm.snapshots import Event, RecordedRun
from mdm.snapshots.reducer import Track, parts_of
from mdm.snapshots.summary import Summary, beside, decoded, keep, packed, summary_of, unpack
from mdm.testing import run_virtual


def ran(path, seed, seconds=0.2):
    """Record a random system; return its ensembles."""
    system = System(seed, behaviour=f"behaviour of {seed}")
    logging.disable()
    try:
        run_virtual(lambda runtime: system.run(runtime, seconds), record=path)
    finally:
        logging.disable(logging.NOTSET)
    return {each.path: each for each in (*system.ensembles, system.steady)}


@pytest.fixture
def robot(tmp_path):
    """Record a robot of a file; return the record's path."""
    file = a_robot(tmp_path)
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, file)

    async def main(runtime):
        await runtime.start(mdm.load_system(file))
        await asyncio.sleep(30)

    run_virtual(main, record=recorder)
    return tmp_path / "run.mcap"


def events(encoded):
    return [msgspec.json.decode(each, type=Event) for each in encoded]


def shown(run, moments):
    """Return all that a run shows: its scene, its pictures at moments, its lanes, its events, and its steps."""
    paths = [each.path for each in run.scene().ensembles]
    predicates = [each.name for each in run.scene().predicates]
    frames = [run.frame(moment, paths) for moment in moments]
    lanes = [run.lanes(*sorted(pair), paths, predicates, most) for most in (7, 2000) for pair in pairwise(moments)]
    steps = [
        run.step(kind, moment, back=back)
        for kind in ("decision", "change", "fault", "mode", "judgement")
        for moment in moments[:4]
        for back in (False, True)
    ]
    return run.scene(), frames, lanes, run.after(0, 10**9), run.after(0, 10**9, rare=True), steps, run.judgements


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(each, marks=pytest.mark.slow) for each in range(3, 16))])
def test_a_summary_shows_all_that_reading_shows(tmp_path, seed):
    ensembles = ran(tmp_path / "run.mcap", seed)
    record = Record(tmp_path / "run.mcap")
    read = RecordedRun(record, ensembles=ensembles)
    brief = RecordedRun(record, ensembles=ensembles, summary=decoded(read.summary().encoded()))
    chance = random.Random(seed)
    moments = [0.0, *(chance.uniform(0, read.last) for _ in range(12)), read.last]
    assert shown(brief, moments) == shown(read, moments)


def test_the_summary_of_a_restored_record_has_its_predicates_and_needs_no_replay(robot, monkeypatch):
    read = recorded_run(robot)
    assert not beside(Record(robot)).exists(), "a short record needs none"
    monkeypatch.setattr(page, "_LONG", 1)
    recorded_run(robot)
    monkeypatch.setattr(RecordedRun, "restore", lambda *_: pytest.fail("it is replayed"))
    monkeypatch.setattr(RecordedRun, "_read", lambda *_: pytest.fail("it is read"))
    moments = [0.0, 3.0, 11.0, 21.1, 29.0]
    assert shown(recorded_run(robot), moments) == shown(read, moments)


def test_where_the_folder_cannot_be_written_the_record_is_shown_all_the_same(robot, monkeypatch):
    monkeypatch.setattr(page, "_LONG", 1)
    beside(Record(robot)).mkdir()
    assert recorded_run(robot).restored is not None
    assert [each.name for each in robot.parent.iterdir() if "summary" in each.name] == ["run.mcap.summary"]


def summarised(tmp_path, seed=1):
    """Return a record, and the summary that is kept beside it."""
    ran(tmp_path / "run.mcap", seed)
    record = Record(tmp_path / "run.mcap")
    assert keep(RecordedRun(record).summary(), record)
    return record, summary_of(record)


@pytest.mark.filterwarnings("ignore")
def test_a_damaged_or_foreign_summary_and_one_of_a_record_that_grew_are_refused(tmp_path):
    record, found = summarised(tmp_path)
    assert found is not None
    path, data = beside(record), beside(record).read_bytes()
    for place in (0, 5, 20, 40, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        assert summary_of(record) is None
    path.write_bytes(data[:-10])
    assert summary_of(record) is None
    other = tmp_path / "other"
    other.mkdir()
    summarised(other, seed=2)
    path.write_bytes((other / "run.mcap.summary").read_bytes())
    assert summary_of(record) is None
    path.write_bytes(data)
    assert summary_of(record) == found
    with record.path.open("ab") as file:
        file.write(b"more")
    assert summary_of(Record(record.path)) is None


def test_what_is_no_summary_is_refused_in_a_sentence():
    content = msgspec.msgpack.encode(("0.0", None))
    older = b"mdm.summary 1\n" + zlib.crc32(content).to_bytes(4, "little") + content
    for data in (b"", b"anything", older):
        with refused(Error):
            decoded(data)


@pytest.mark.filterwarnings("ignore")
def test_a_summary_that_lacks_something_is_refused_in_a_sentence(tmp_path):
    record, _ = summarised(tmp_path)
    with refused(Error):
        RecordedRun(record, summary=Summary((), {"": {}}, {}))


@pytest.mark.filterwarnings("ignore")
def test_a_summary_of_another_edition_is_left_and_the_record_is_read(tmp_path):
    record, found = summarised(tmp_path)
    other = Summary(found.of, {"": {"other": packed(Track())}}, {})
    moments = [0.0, 0.1]
    read = recorded_run(record, replay=False)
    assert shown(recorded_run(record, replay=False, summary=other), moments) == shown(read, moments)


def test_a_track_is_unpacked_where_it_is_looked_at():
    track = Track()
    for time in range(1000):
        track.add(7 * time, PoseUpdate(7 * time, time / 3, 0.0))
    other = Track()
    unpack(packed(track), other, PoseUpdate)
    assert list(other.times) == track.times
    for time in (-1, 0, 6, 7, 3500, 10**6):
        assert other.at(time) == track.at(time)
    assert (other.entries[-1], other.entries[60:70]) == (track.entries[-1], track.entries[60:70])
    with pytest.raises(IndexError):
        other.entries[1000]


@pytest.mark.parametrize("most", [1, 3, 10, 1000])
def test_parts_of_a_lane_have_each_of_its_events_once(most):
    chance = random.Random(most)
    times = sorted(chance.randrange(1000) for _ in range(60))
    first, last = 200, 700
    parts = list(parts_of(times, first, last, most))
    places = [place for one, two in parts for place in range(one, two)]
    within = [place for place, time in enumerate(times) if first <= time <= last]
    assert places == [within[0] - 1, *within]
    assert len(parts) <= most + 1 or len(within) <= most


@pytest.mark.filterwarnings("ignore")
def test_lanes_that_are_thinned_say_how_much_stands_together_and_are_refined(robot):
    run = recorded_run(robot)
    paths, predicates = ["top", "top/walk"], [each.name for each in run.scene().predicates]
    whole, thin = (run.lanes(0, run.last, paths, predicates, most) for most in (2000, 4))
    assert all(each.count == 1 for each in whole)

    def counted(lanes):
        found = Counter()
        for each in lanes:
            ends = each.kind != "life" or each.status != "running"
            found[each.kind, each.source] += each.count * (ends and each.kind != "predicate")
        return found

    assert counted(whole)["decision", "top/walk"] > 20
    assert counted(thin) == counted(whole)
    near = [each for each in thin if each.kind == "predicate" and each.name == "Near"]
    assert "several" in {each.status for each in near}
    assert all(each.count > 1 for each in near if each.status == "several")
    changes = [each for each in whole if each.kind == "predicate" and each.name == "Near"]
    assert {near[0].time, near[-1].time} == {changes[0].time, changes[-1].time}
    part = run.lanes(10.0, 11.0, paths, predicates, 4)
    assert [each for each in part if each.kind == "decision" and each.time >= 10.0] == [
        each for each in whole if each.kind == "decision" and 10.0 <= each.time <= 11.0
    ]


def test_a_life_that_goes_on_behind_what_is_looked_at_has_its_end(robot):
    run = recorded_run(robot, replay=False)
    whole = [each for each in run.lanes(0, run.last, ["top"], [], 2000) if each.kind == "life"]
    begun, ended = next(
        (one, two) for one in whole for two in whole if one.life == two.life and two.time - one.time > 1
    )
    middle = (begun.time + ended.time) / 2
    assert {begun, ended} <= set(run.lanes(middle, middle + 0.01, ["top"], [], 2000))


@pytest.mark.slow
def test_a_long_run_has_its_summary_within_its_record(tmp_path, monkeypatch):
    async def main(runtime):
        manager = mdm.PredicateManager("predicates")
        sensor = manager.sensor("On", initial=False)
        policy = mdm.policies.DeterministicPolicy([0, 1])
        robot = mdm.Ensemble(
            "robot",
            states=[mdm.StateFactor("on", ["On"])],
            policy=policy,
            actions={0: lambda: None, 1: lambda: None},
            predicates=manager,
        )
        await runtime.start(robot)
        for step in range(5_200):
            sensor.set(step % 2 == 1)
            await asyncio.sleep(0.1)

    run_virtual(main, record=tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    assert record.counts.total() > 20_000
    assert summary_of(record) is not None
    assert not beside(record).exists()
    moments = [0.0, 77.7, 300.05, 519.0]
    brief = shown(recorded_run(record.path, replay=False), moments)
    monkeypatch.setattr(page, "summary_of", lambda _: None)
    assert shown(recorded_run(record.path, replay=False), moments) == brief
