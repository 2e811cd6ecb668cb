"""How many lines of a run people are shown, and that each other one is counted."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st

from mdm.runtime.process.pace import Pace

SECOND = 1_000_000_000
COMING = st.tuples(st.sampled_from("ab"), st.integers(0, 3), st.integers(0, SECOND))


@settings(max_examples=200)
@given(st.lists(COMING, max_size=200))
def test_no_second_has_more_than_ten_lines_and_each_line_is_written_or_counted(coming):
    pace, time, written, counted = Pace(), 0, [], 0
    for subject, line, after in coming:
        time += after
        counts = pace.counts(subject, line, time)
        if counts is not None:
            assert len([each for each in written if time - each < SECOND]) < 10
            written.append(time)
            counted += sum(counts.values())
    counted += sum(pace.rest().values()) + sum(pace.repeated.values())
    assert len(written) + counted == len(coming)


def test_the_same_again_is_counted_until_something_else_comes_or_ten_seconds_have_passed():
    pace = Pace()
    assert pace.counts("robot", "go", 0) == {}
    assert [pace.counts("robot", "go", time) for time in (1, SECOND, 10 * SECOND - 1)] == [None] * 3
    assert pace.counts("other", "go", 2) == {}
    assert pace.counts("robot", "go", 10 * SECOND) == {"again": 3}
    assert pace.counts("robot", "stay", 10 * SECOND + 1) == {}
