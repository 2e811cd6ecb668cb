"""Differences: which fields of two decisions differ, and how that is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from records import decision

from mdm.messages import SensorUpdate
from mdm.replay.player import Difference, unlike
from mdm.stimuli import Said, Ticked

BELIEF = np.array([0.25, 0.75])


def test_a_decision_is_like_itself():
    one = decision(3, belief=BELIEF, reward=math.nan)
    assert unlike(one, decision(3, belief=BELIEF.copy(), reward=math.nan), 0.0) == ()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("epoch", 4),
        ("cause", "tick"),
        ("state", 1),
        ("state", None),
        ("observation", 0),
        ("action", 2),
        ("reward", 0.5 + 1e-12),
        ("reward", None),
        ("belief", np.array([0.25, 0.75 + 1e-12])),
        ("belief", np.array([0.25, 0.5, 0.25])),
        ("belief", None),
    ],
)
def test_each_field_counts_to_the_last_bit(field, value):
    assert unlike(decision(3, belief=BELIEF), decision(3, **({"belief": BELIEF} | {field: value})), 0.0) == (field,)


def test_the_time_counts():
    assert unlike(decision(3, epoch=0, state=0), decision(6, epoch=0, state=0), 0.0) == ("time",)


def test_a_belief_that_the_record_does_not_keep_is_not_compared():
    assert unlike(decision(3, belief=None), decision(3, belief=BELIEF), 0.0) == ()


@pytest.mark.parametrize(("by", "found"), [(9e-10, ()), (2e-9, ("reward", "belief"))])
def test_numbers_of_another_environment_may_differ_a_little(by, found):
    other = decision(3, belief=BELIEF + np.array([by, -by]), reward=0.5 + by)
    assert unlike(decision(3, belief=BELIEF), other, 1e-9) == found


SINCE = (
    Ticked(2_000_000, "patrol/control", 2, 0, 10.0),
    Said(2_500_000, "sensed", "SensorUpdate", SensorUpdate(2_500_000, (("Near", True),), ())),
)


def test_both_values_are_told_with_the_input_before_them():
    found = Difference(
        7,
        decision(3, belief=BELIEF, name="Go"),
        decision(3, belief=np.array([0.5, 0.5]), name="Stay", action=2),
        ("action", "belief"),
        SINCE,
    )
    first, *before = found.describe(1_000_000).splitlines()
    assert first == (
        "decision 7, of 'patrol' at 0.002000 s: action 'Go', now 'Stay'; belief 0.75 of state 1, now 0.5 of state 0"
    )
    assert before[0] == "  before it: 0.001000 s, ticked actor patrol/control, number 2, rate 10.0"
    assert before[1].startswith("  before it: 0.001500 s, said channel sensed, type SensorUpdate, message ")
    assert len(before) == 2


def test_a_decision_of_one_side_alone_is_told():
    missing = Difference(7, decision(3), None, (), ())
    more = Difference(7, None, decision(3), (), ())
    assert missing.describe() == "decision 7: 'patrol' decided 'Go' at 0.003000 s, and not now"
    assert more.describe() == "decision 7: 'patrol' decides 'Go' at 0.003000 s, and did not"
