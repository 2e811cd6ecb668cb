"""Cases: what a decision was made of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError, problems
from mdm.beliefs import Support
from mdm.explanation.case import Rerun, Update, belief_of, parts_of, spelt
from mdm.policies import AlphaVectors, FiniteStateController, QTable, RandomPolicy, StagedPolicy

TIGER = AlphaVectors([[0, 0], [10, -90], [-90, 10]], [0, 1, 2])
PLAN = FiniteStateController([0, 1], [[0, 1], [1, 1]], 3, values=[[1.0, 2.0], [3.0, -4.0]])


@given(st.lists(st.sampled_from([0, 1, None]), max_size=25), st.booleans())
def test_all_updates_lead_to_what_was_decided_on(seen, random):
    policy = RandomPolicy(3, 2, seed=1) if random else TIGER
    controller = mdm.Controller(policy, problems.tiger())
    steps = [controller.start(), *map(controller.observe, seen)]
    for step in steps:
        case = step.case()
        assert len(case.updates) == min(step.epoch, 10) or step.epoch < len(seen) - 10
        at = Rerun(case).at(case.updates)
        there, here = (at.by, case.at.by) if random else (at, case.at)
        assert there == pytest.approx(here, abs=1e-12)
        assert policy.action(at) == step.action


def test_what_an_impossible_observation_has_led_to():
    """In `grid_small` some observations cannot come after some others; each meaning of one is repeated."""
    model = problems.load_unload()
    policy = AlphaVectors(np.eye(14)[:2] * [[1.0], [2.0]], [0, 1], 2)
    for meaning in ("predict", "keep", "reset"):
        controller = mdm.Controller(policy, model, on_impossible=meaning)
        controller.start()
        for number in range(9):
            step = controller.observe(number * 7 % len(model.observation_space))
        assert controller.impossible
        case = step.case()
        assert Rerun(case).at(case.updates) == pytest.approx(case.at)


def test_nothing_is_known_before_a_belief_from_outside():
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    controller.observe(0)
    controller.believe([0.3, 0.7])
    step = controller.observe(1)
    assert step.case().updates == ()
    assert step.at.tolist() == [0.3, 0.7]
    later = controller.observe(1)
    assert later.case().updates == (Update(3, step.action, 1),)
    controller.reset()
    assert controller.decide().case().updates == ()


def test_nothing_is_known_after_a_jump():
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    mark, held = controller.mark(), controller.snapshot()
    controller.observe(0)
    controller.go_back(mark)
    assert controller.observe(0).case().updates == ()
    controller.restore(held)
    assert controller.observe(0).case().updates == ()


def test_the_belief_of_every_kind_of_information():
    model = problems.tiger()
    assert belief_of(mdm.Controller(TIGER, model).start([0.2, 0.8]).case()) == pytest.approx([0.2, 0.8])
    assert belief_of(mdm.Controller(QTable(np.eye(3))).see(1).case()).tolist() == [0, 1, 0]
    assert belief_of(mdm.Controller(StagedPolicy(np.ones((2, 3, 1)))).see(2).case()).tolist() == [0, 0, 1]
    assert belief_of(mdm.Controller(RandomPolicy(3, 2), model).start().case()).tolist() == [0.5, 0.5]
    case = mdm.Controller(TIGER, model).start().case()
    assert belief_of(case._replace(at=Support(np.array([1]), np.ones(1)))).tolist() == [0, 1]


def test_the_belief_of_a_plan_is_tracked_where_all_of_it_is_known():
    model = problems.tiger()
    controller = mdm.Controller(PLAN, model)
    controller.start()
    step = controller.observe(0)
    tracker = mdm.BeliefTracker(model)
    tracker.update(0, 0)
    assert belief_of(step.case()) == pytest.approx(tracker.belief)
    for _ in range(30):
        step = controller.observe(0)
    assert belief_of(step.case()) is None
    assert belief_of(mdm.Controller(PLAN).start().case()) is None


def test_components_of_observations():
    model = problems.dec_tiger().with_discount(0.9)
    controller = mdm.Controller(AlphaVectors([[0, 0]], [0], 9), model)
    controller.start()
    case = controller.observe((0, 1)).case()
    names = [factor.name for factor in model.observation_space.factors]
    assert parts_of(case, Update(1, 0, 1)) == [(names[0], "hear-left", (None, 1)), (names[1], "hear-right", (0, None))]
    assert parts_of(case, Update(1, 0, (None, 1))) == [(names[1], "hear-right", (None, None))]
    assert parts_of(case, Update(1, 0, None)) == []
    assert spelt(model.observation_space, (None, 1)) == f"{names[1]}=hear-right"
    alone = FiniteStateController([0], [[0] * 4], 9)
    joint = mdm.Controller(alone, model)
    joint.start()
    assert parts_of(joint.observe((0, 1)).case(), Update(1, 0, 1)) == [
        ("", f"{names[0]}=hear-left, {names[1]}=hear-right", None)
    ]


def test_states_without_names():
    case = mdm.Controller(QTable(np.eye(3))).see(1).case()
    assert (case.state_name(1), case.action_name(2)) == ("state 1", "2")


def test_the_last_decision_of_a_controller():
    controller = mdm.Controller(TIGER, problems.tiger())
    with refused(ModelError):
        controller.case()
    controller.start()
    step = controller.observe(0)
    assert controller.case().updates == step.case().updates
    assert controller.case().at is step.at
    table = mdm.Controller([0, 1])
    table.see(1)
    assert (table.case().at, table.case().action) == (1, 1)
    table.see(0)
    assert (table.case().at, table.case().epoch) == (0, 1)
