"""Joint plans: their sizes, exact values, and form as controllers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused
from teams import by_trees, team, worth

from mdm import ModelError
from mdm.solvers.jesp import Team, as_controller, plan_size, plan_value, random_plan


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.booleans())
def test_the_value_of_a_plan_is_what_recursion_says(seed, horizon, events):
    model = team(seed, events=events)
    dynamics = Team(model)
    plan = random_plan(dynamics, horizon, np.random.default_rng(seed))
    exact = worth(model, horizon, by_trees(as_controller(dynamics, plan)))
    assert plan_value(dynamics, plan) == pytest.approx(exact, abs=1e-9)


def test_a_tree_has_a_node_for_each_history():
    dynamics = Team(team(0, observations=3))
    plan = random_plan(dynamics, 3, np.random.default_rng(0))
    controller = as_controller(dynamics, plan)
    assert [own.num_nodes for own in controller.controllers] == [1 + 3 + 9] * 2
    assert plan_size(dynamics, 3) == 2 * (1 + 3 + 9)
    own, tree = controller.controllers[0], plan[0]
    node = own.start
    for step, observation in enumerate((2, 1)):
        node = own.next_node(node, observation)
        history = (2, 2 * 3 + 1)[step]
        assert own.action_at(node) == tree[step + 1][history]
    assert own.next_node(node, 0) is None  # nothing follows the last decision


def test_plans_that_are_none_or_too_large_are_refused():
    dynamics = Team(team(0))
    with refused(ModelError):
        plan_size(dynamics, 0)
    with refused(ModelError):
        plan_size(dynamics, 60)
