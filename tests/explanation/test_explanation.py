"""Explanations as a whole: of every kind of policy, as JSON, and what each cannot tell."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_policies import KINDS

import mdm
from mdm import problems
from mdm.explanation import BeliefChange, Case, Explanation, ObservationChange, StateChange, explain
from mdm.policies import (
    AlphaVectors,
    ConstantPolicy,
    DeterministicPolicy,
    FiniteStateController,
    RandomPolicy,
    StochasticPolicy,
)
from mdm.solvers.online import TreeSearch

TIGER = AlphaVectors([[0, 0], [10, -90], [-90, 10]], [0, 2, 1])


def test_of_the_tiger():
    controller = mdm.Controller(TIGER, problems.tiger())
    controller.start()
    controller.observe("hear-left")
    found = controller.observe("hear-left").explain()
    assert (found.epoch, found.action_name, found.by, found.second) == (2, "open-right", "value", "listen")
    sure = 0.85**2 / (0.85**2 + 0.15**2)
    assert found.belief[0].name == "tiger-left"
    assert found.belief[0].probability == pytest.approx(sure)
    assert found.margin == pytest.approx(10 * sure - 90 * (1 - sure))
    assert [each.name for each in found.values] == ["open-right", "listen", "open-left"]
    assert (found.moved_by.epoch, found.moved_by.observation, found.moved_by.action) == (2, "hear-left", "listen")
    (change,) = found.otherwise
    assert change.mass == pytest.approx(sure - 0.9)
    assert change.action == "listen"
    assert {each.state for each in change.moves} == {"tiger-left", "tiger-right"}
    assert found.next_states[0].probability == pytest.approx(0.5)
    assert found.cannot == ()


@pytest.mark.parametrize("name", ["tiger", "load_unload", "grid_small", "dec_tiger"])
def test_it_is_json_and_comes_back(name):
    model = getattr(problems, name)()
    model = model if model.discount < 1 else model.with_discount(0.9)
    controller = mdm.Controller(mdm.solve(model, solver="qmdp").policy, model)
    step = controller.start()
    for _ in range(3):
        found = step.explain()
        data = msgspec.json.encode(found)
        assert msgspec.json.decode(data, type=Explanation) == found
        assert str(found).startswith(f"Decision {step.epoch}: {step.action_name!r}, by alpha vectors.")
        step = controller.observe(None)


def test_of_a_state():
    model = problems.grid_world()
    policy = mdm.solve(model.with_discount(0.9)).policy
    found = mdm.Controller(policy, model).see(3).explain()
    assert found.state == model.state_space.names[3]
    assert all(isinstance(each, StateChange) for each in found.otherwise)
    assert found.ways >= len(found.otherwise) > 0
    assert found.influences == ()


def test_of_a_plan():
    plan = FiniteStateController([0, 2], [[1, 0], [1, 0]], 3)
    controller = mdm.Controller(plan, problems.tiger())
    controller.start()
    found = controller.observe(0).explain()
    assert found.nodes == (1,)
    assert (found.moved_by.epoch, found.values) == (1, ())
    assert isinstance(found.otherwise[0], ObservationChange)
    assert found.cannot == ("the policy, a finite-state controller, has no values to compare",)
    assert found.next_observations


def test_of_a_search():
    model = problems.tiger()
    controller = mdm.Controller(TreeSearch(model, expansions=30, seed=1), model)
    controller.start()
    found = controller.observe(0).explain()
    assert (found.by, found.effort) == ("bound", 30)
    assert found.values[0].upper >= found.values[0].value
    assert found.moved_by.action is None
    assert [sentence for sentence in found.cannot if "a tree search" in sentence]
    assert "by a search that expanded 30 leaves" in str(found)


def test_of_an_action_that_was_chosen_elsewhere():
    controller = mdm.Controller(TIGER, problems.tiger())
    found = controller.decide("open-left")
    told = found.explain()
    assert told.margin == pytest.approx(-40)
    assert told.otherwise == ()
    assert "chosen elsewhere" in " ".join(told.cannot)
    assert "'listen' counts 40 more" in str(told)


def test_of_policies_that_compare_nothing():
    assert mdm.Controller(DeterministicPolicy([0, 1])).see(1).explain().values == ()
    constant = mdm.Controller(ConstantPolicy(1, 3, 2), problems.tiger()).start().explain()
    assert (constant.values, constant.otherwise) == ((), ())
    assert len(constant.cannot) == 2


def test_of_draws():
    found = mdm.Controller(StochasticPolicy([[0.25, 1], [0.75, 0]], seed=1)).see(0).explain()
    assert [(each.name, each.value) for each in found.values] == [("1", 0.75), ("0", 0.25)]
    assert found.by == "chance"
    drawn = mdm.Controller(RandomPolicy(3, 2, seed=1), problems.tiger()).start().explain()
    assert [each.value for each in drawn.values] == pytest.approx([1 / 3] * 3)


@given(st.integers(0, 2**32 - 1), st.sampled_from(KINDS))
def test_any_policy_has_something_to_say(seed, make):
    random = np.random.default_rng(seed)
    policy = make(random, 4)
    if policy.input == "belief":
        at = np.full(policy.num_states, 1 / policy.num_states)
    else:
        at = 0 if policy.input == "state" else tuple(each.start for each in policy.controllers)
    try:
        action = int(policy.action(at))
    except mdm.ModelError:  # no vector holds
        return
    found = explain(Case(policy, None, None, None, None, 0, action, at))
    assert str(found)
    assert found.values or found.cannot
    assert msgspec.json.decode(msgspec.json.encode(found), type=Explanation) == found
    assert all(isinstance(each, BeliefChange) == (policy.input == "belief") for each in found.otherwise)
