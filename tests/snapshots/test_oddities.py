"""What looks odd, against histories that are made so, and against examples that do well."""

from __future__ import annotations

import in_process
import pytest
from hypothesis import given, strategies as st
from places import EXAMPLES

from mdm.recording import Record
from mdm.snapshots import RecordedRun
from mdm.snapshots.oddities import Ended, Seen, lasting, repeated, unmoved


def test_ten_decisions_on_nothing_new_are_odd_and_nine_are_not():
    assert repeated("Wait", 9) == ""
    assert repeated("Wait", 25) == "decided Wait 25 times in the last 5 s, each time because it had just ended"


def done(action, *seconds, status="succeeded"):
    return [Ended(action, each, status) for each in seconds]


def test_an_action_lasts_by_its_own_median():
    before = done("Go", 4.0, 5.0, 60.0)  # whose median is 5
    assert lasting("Go", 24.9, before) == ""
    assert lasting("Go", 25.0, before) == "Go has lasted for 25 s; it usually takes 5.0 s"
    assert lasting("Go", 9.9, done("Go", 0.1, 0.1, 0.1)) == ""


def test_an_action_that_has_never_ended_lasts_by_those_of_the_others():
    others = done("Help", 7.0, 4.0)
    assert lasting("Go", 34.9, others) == ""
    told = lasting("Go", 270.0, others)
    assert told == "Go has lasted for 4 min 30 s and has never ended; other actions took 7.0 s at most"
    assert lasting("Go", 1e6, done("Help", 7.0)) == ""  # which is too little to judge by


def test_an_action_that_has_ended_once_or_twice_lasts_by_the_longest_of_all():
    before = done("Charge", 2.0, 2.0)
    assert lasting("Charge", 29.9, before) == ""
    assert lasting("Charge", 30.0, before) == "Charge has lasted for 30 s; it took 2.0 s at most before"
    assert lasting("Charge", 49.9, [*before, *done("Drive", 10.0)]) == ""


@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=50), st.floats(0, 1e6))
def test_an_action_that_others_end_has_no_time_of_its_own(seconds, now):
    assert lasting("Patrol", now, [*done("Patrol", *seconds, status="preempted"), *done("Help", 1.0, 2.0)]) == ""


def seen(symbols, chances):
    return [
        Seen(float(time), symbol, 1, chance)
        for time, (symbol, chance) in enumerate(zip(symbols, chances, strict=False))
    ]


def test_a_belief_that_stands_still_while_observations_differ_is_odd():
    def told(history):
        return unmoved(history, lambda symbol: f"hear-{symbol}", lambda state: f"s{state}")

    symbols = ["left"] * 17 + ["right"] * 3
    came = "hear-left 17 times, hear-right 3 times"
    assert told(seen(symbols, [0.5] * 20)) == (
        f"the belief has not moved for 19 s though observations differ ({came}): s1 at 50 %"
    )
    assert told(seen(symbols, [0.5] * 19 + [0.502])) == ""
    assert told(seen(["left"] * 20, [0.5] * 20)) == ""
    assert told(seen(symbols, [0.89] * 20)).endswith("s1 at 89 %")
    assert told(seen(symbols, [0.9] * 20)) == ""  # noise moves nobody who is that sure
    assert told(seen(symbols, [0.5] * 20)[:19]) == ""


@pytest.mark.parametrize(
    ("file", "seconds"),
    [("patrol/patrol.toml", 150), ("tiger.toml", 120), pytest.param("patrol/patrol.toml", 300, marks=pytest.mark.slow)],
)
def test_nothing_is_odd_of_an_example(file, seconds, tmp_path):
    if file.startswith("patrol"):
        pytest.importorskip("navground")
    record = tmp_path / "run.mcap"
    done = in_process.mdm("run", EXAMPLES / file, "--virtual", "--seconds", seconds, "--record", record)
    assert done.status == 0, done.errors
    run = RecordedRun(Record(record))
    assert sum(each.decisions for each in run.frame(run.last).ensembles) > 3
    odd = {(second, text) for second in range(seconds) for each in run.frame(second).ensembles for text in each.odd}
    assert odd == set()
