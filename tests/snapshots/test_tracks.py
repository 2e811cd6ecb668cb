"""What is known of a subject at each time, against a search through all of it."""

from __future__ import annotations

from hypothesis import given, strategies as st

from mdm.messages import ActionLife, Decision
from mdm.snapshots.tracks import EnsembleTracks, Track


@given(st.lists(st.integers(0, 30), max_size=20).map(sorted), st.integers(-1, 31), st.integers(1, 5))
def test_a_track_has_the_last_entry_by_each_time(times, time, most):
    track = Track()
    for number, each in enumerate(times):
        track.add(each, number)
    past = [number for number, each in enumerate(times) if each <= time]
    assert track.at(time) == (past[-1] if past else None)
    assert track.entries[track.last(time, most)] == past[-most:]


def test_an_ended_life_lasted_from_its_beginning_and_a_decision_is_kept_without_its_belief():
    tracks = EnsembleTracks("robot")
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
    assert [each.belief for each in tracks.decisions.entries] == [None] * 3
    assert tracks.changes.entries == ["a", "b"]
    assert tracks.repeats.times == [1]
