"""The ring of events, against a list that forgets nothing."""

from __future__ import annotations

import msgspec
from hypothesis import given, strategies as st

from mdm.snapshots.events import KINDS, Event, Ring


@given(st.lists(st.sampled_from(KINDS), max_size=80), st.lists(st.integers(1, 7), min_size=1))
def test_a_reader_with_a_cursor_gets_each_event_once_in_order(kinds, sizes):
    ring, expected = Ring(), []
    got, cursor = [], 0
    steps = iter(sizes * 100)
    for number, kind in enumerate(kinds, 1):
        ring.add(float(number), kind, "robot", "name")
        expected.append((number, kind))
        if number % 3 == 0:
            events, cursor = ring.after(cursor, next(steps))
            got += events
    while True:
        events, cursor = ring.after(cursor, next(steps))
        if not events:
            break
        got += events
    decoded = [msgspec.json.decode(each, type=Event) for each in got]
    assert [(event.number, event.kind) for event in decoded] == expected


def test_many_decisions_leave_the_faults_before_them():
    ring = Ring()
    ring.add(0.0, "fault", "robot", "stale", detail="nothing was told")
    for number in range(30_000):
        ring.add(float(number), "decision", "robot", "go")
    kept = list(ring)
    assert kept[0].kind == "fault"
    assert len(kept) == 20_001
    events, cursor = ring.after(29_999, 100)
    assert [msgspec.json.decode(each)["number"] for each in events] == [30_000, 30_001]
    assert cursor == 30_001
