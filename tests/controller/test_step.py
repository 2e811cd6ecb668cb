"""Steps: they are values, and each knows its past, as far as that is kept."""

from __future__ import annotations

import copy
import tracemalloc

import pytest
from sentences import refused

import mdm
from mdm import ModelError, problems
from mdm.explanation.case import Rerun, Update
from mdm.policies import AlphaVectors

TIGER = AlphaVectors([[0, 0], [10, -90], [-90, 10]], [0, 1, 2])


def test_steps_are_equal_whoever_has_made_them():
    one, other = (mdm.Controller(TIGER, problems.tiger()) for _ in range(2))
    assert one.start() == other.start()
    step, twin = one.observe(0), other.observe(0)
    assert step == twin
    assert hash(step) == hash(twin)
    assert step != other.observe(0)
    assert step != "step"
    assert repr(step) == "Step(epoch=1, action=0, action_name='listen', reward=-1.0, probability=0.5)"
    assert copy.copy(step) == step


def test_a_step_of_nobody():
    with refused(ModelError):
        mdm.Step(0, 0, "listen", None).explain()


def test_a_step_is_explained_by_those_before_it_also_when_it_is_old():
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    old = controller.observe(0)
    before = old.case()
    for _ in range(100):
        controller.observe(1)
    assert old.case().updates == before.updates == (Update(1, 0, 0),)


def test_of_large_beliefs_less_is_kept(monkeypatch):
    monkeypatch.setattr("mdm.controller.controller._KEPT_NUMBERS", 8)
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    assert all(len(controller.observe(0).case().updates) <= 3 for _ in range(20))


def test_a_belief_that_goes_on_for_long_without_a_decision_keeps_little():
    """As that of an ensemble that is safe for hours; what led to the next decision is whole, or not known."""
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    for few in range(5):
        controller.advance(few % 2)
    step = controller.decide()
    assert [update.observation for update in step.case().updates] == [0, 1, 0, 1, 0]
    tracemalloc.start()
    for many in range(20_000):
        controller.advance(many % 2)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 400_000
    assert controller.decide().case().updates == ()
    later = controller.observe(1)
    case = later.case()
    assert len(case.updates) == 1
    assert Rerun(case).at(case.updates) == pytest.approx(later.at)
