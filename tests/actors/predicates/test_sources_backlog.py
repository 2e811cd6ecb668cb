"""The backlog of sensors: the latest values, and their ages."""

from __future__ import annotations

from mdm.actors.predicates.sources import Backlog


def test_the_latest_value_of_each_counts():
    backlog = Backlog()
    backlog.put([("A", True), ("B", False)], 10)
    backlog.put([("A", None)], 20)
    assert backlog.values == {"A": None, "B": False}
    assert (backlog.told("A", 30), backlog.told("B", 30), backlog.told("C", 30)) == (20, 10, 30)
    backlog.clear()
    assert (backlog.values, backlog.told("A", 30)) == ({}, 30)


def test_what_is_too_old_is_forgotten_and_what_has_no_time_is_new():
    backlog = Backlog()
    backlog.put([("A", True), ("B", True), ("C", True)], 10)
    backlog.put([("D", True)], None)
    backlog.expire(20, {"A": 9, "B": 10, "D": 1, "E": 1})
    assert backlog.values == {"B": True, "C": True, "D": True}
