"""What has happened to an ensemble, against a search through all of it; live pictures against those of their record."""

from __future__ import annotations

import asyncio
import logging

import msgspec
import pytest
from hypothesis import given, strategies as st
from replay.systems import System

from mdm.messages import ActionLife, Decision, Mode
from mdm.recording import Record
from mdm.snapshots import Event, LiveRun, RecordedRun
from mdm.snapshots.reducer import EnsembleReducer, Track
from mdm.snapshots.words import cause_in_words
from mdm.testing import run_virtual


@given(st.lists(st.integers(0, 30), max_size=20).map(sorted), st.integers(-1, 31), st.integers(1, 5))
def test_a_track_has_the_last_entry_by_each_time(times, time, most):
    track = Track()
    for number, each in enumerate(times):
        track.add(each, number)
    past = [number for number, each in enumerate(times) if each <= time]
    assert track.at(time) == (past[-1] if past else None)
    assert track.entries[track.last(time, most)] == past[-most:]


def test_an_entry_that_comes_late_is_the_last_one_and_of_many_the_newest_are_kept():
    track = Track()
    for time, entry in ((10, "a"), (7, "b"), (12, "c")):
        track.add(time, entry)
    assert [track.at(time) for time in (9, 10, 11, 12)] == [None, "b", "b", "c"]
    newest = Track(3)
    for number in range(50):
        newest.add(number, number)
    assert newest.entries[-3:] == [47, 48, 49]
    assert len(newest.entries) == len(newest.times) <= 6


def test_an_ended_life_lasted_from_its_beginning_and_a_decision_is_kept_without_its_belief():
    tracks = EnsembleReducer("robot", lambda *_: None)
    for time, life, status in ((10, 1, "running"), (20, 2, "running"), (3_000_000_010, 1, "failed")):
        tracks.add(ActionLife(time, "robot", life, f"a{life}", status))
    assert [each.life for each in tracks.lives.at(25)] == [1, 2]
    assert [each.life for each in tracks.lives.at(4_000_000_000)] == [2]
    (ended,) = tracks.ends.entries
    assert ended == ("a1", 3.0, "failed")
    assert not tracks.believes
    for epoch, (name, cause, belief) in enumerate((("a", "start", [1.0]), ("a", "again", None), ("b", "tick", [1.0]))):
        tracks.add(Decision(epoch, "robot", epoch, cause, None, None, belief, 0, name, None))
    assert tracks.believes
    assert [each.message.belief for each in tracks.decisions.entries] == [None] * 3
    assert tracks.changes.times == [0, 2]


def test_a_plain_function_has_a_life_of_no_time_which_says_nothing_of_how_long_actions_take():
    reducer = EnsembleReducer("robot", lambda *_: None)
    reducer.add(Mode(0, "robot", "deciding", 0, ()))
    for life in range(1, 9):
        for status in ("running", "succeeded"):
            reducer.add(ActionLife(life, "robot", life, f"beep{life % 2}", status))
    reducer.add(ActionLife(10, "robot", 10, "Go", "running"))
    assert reducer.ends.entries == []
    lives = [each for each in reducer.lane(0, 10**12, 100) if each.kind == "life"]
    assert [(each.name, each.status) for each in lives] == [("Go", "running")]
    assert {status: len(track.times) for status, track in reducer.outcomes.items()} == {"succeeded": 8}
    reducer.judge.finish(60_000_000_000)
    assert reducer.judge.named == {}


def looked_at(seed, path, seconds):
    """Run and record a random system in virtual time; return its ensembles, what was seen live, and its events."""
    system, looks, events = System(seed, behaviour=f"behaviour of {seed}"), [], []

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        runtime.lives.subscribe(lambda _: live.scene())  # each ensemble is known from its start on

        async def look():
            while True:
                of = {each.path: each for each in live._ensembles}
                frame = live.frame(of)
                decided = {path: each.reducer.decisions.entries[-1:] for path, each in of.items()}
                once = {path for path, last in decided.items() if last and last[0].stands == 1}
                looks.append((runtime.now(), dict(zip(of, frame.ensembles, strict=True)), frame.details, once))
                await asyncio.sleep(0.001 + 1e-6)  # beside the times at which most happens

        looking = asyncio.create_task(look())
        await system.run(runtime, seconds)
        looking.cancel()
        events.extend(live.ring)

    run_virtual(main, record=path)
    return {each.path: each for each in (*system.ensembles, system.steady)}, looks, events


def unequal(live, recorded, names):
    """Return the attributes that differ, by name."""
    pairs = {name: (getattr(live, name), getattr(recorded, name)) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def events_of(events, kind, until):
    """Return the events of a kind before a second, but for their numbers; an end of a spell is told once it is sure."""
    found = [each for each in events if each.kind == kind and each.time < until - 6 * (each.status == "over")]
    return sorted([msgspec.structs.replace(each, number=0) for each in found], key=msgspec.json.encode)


FEW = (*range(10), 20, 23, 36)


@pytest.mark.filterwarnings("ignore")  # asyncio logs errors that nobody awaits, as is meant here
@pytest.mark.parametrize(
    "seed", [*FEW, *(pytest.param(each, marks=pytest.mark.slow) for each in range(60) if each not in FEW)]
)
def test_a_live_picture_is_that_of_the_record_at_the_same_time(tmp_path, seed):
    logging.disable()
    try:
        ensembles, looks, events = looked_at(seed, tmp_path / "run.mcap", 0.2)
    finally:
        logging.disable(logging.NOTSET)
    record = Record(tmp_path / "run.mcap")
    first, _ = record.span
    run = RecordedRun(record, ensembles=ensembles)
    paths = [each.path for each in run.scene().ensembles]
    messages = [each.message for each in record.messages(["decisions", "lives", "modes", "idles"])]
    busy = {message.time for message in messages}
    # The ensembles of which each decision was seen by itself so far, and each observation that one took in.
    decisions, observations, compared = set(ensembles), set(ensembles), 0
    for now, frames, details, once in looks:
        decisions -= {path for path, live in frames.items() if live.decisions and path not in once}
        if now in busy:  # when more may have happened behind the look
            continue
        shown = run.frame((now - first) / 1e9, ensembles)
        for path, live in frames.items():
            recorded = shown.ensembles[paths.index(path)]
            fields = set(live.__struct_fields__) - {"waiting"}  # of which no record knows
            assert not unequal(live, recorded, fields), (now, path)
            detail = shown.details[path]
            if live.decisions:
                decided = run._ensembles[path].decisions.at(now).message
                if decided.cause == "tick" and details[path].observations[-1:] != detail.observations[-1:]:
                    observations.discard(path)  # an episode began at the tick, or the belief was told
                fields = {"state", "decided", "reward", "value", "belief"}
                fields |= {"factors"} if detail.state is not None else set()
                fields |= {"cause"} if path in once else set()
                fields |= {"observation", "observations", "tally"} if path in decisions & observations else set()
                assert details[path].cause in {detail.cause, cause_in_words(decided.cause)}
                assert not unequal(details[path], detail, fields), (now, path)
                compared += 1
    assert compared > 30
    kept = [msgspec.json.decode(each, type=Event) for each in run.after(0, 10**9)[0]]
    until = (looks[-1][0] - first) / 1e9
    for kind in ("mode", "idle", "fault", "judgement"):
        told, told_by_record = (
            [each for each in events_of(which, kind, until) if kind != "judgement" or each.source in decisions]
            for which in (events, kept)
        )
        assert told == told_by_record
