from __future__ import annotations

import figures
import numpy as np
import pytest
from hypothesis import given, settings
from random_models import factored_models, flat_models
from sentences import refused

from mdm.errors import ModelError
from mdm.models import MDP, POMDP
from mdm.solvers import Limits
from mdm.solvers.bounds import qmdp
from mdm.solvers.mdp.policy_iteration import policy_iteration


@pytest.mark.parametrize(
    ("problem", "discount"),
    [
        ("broadcast_channel", 0.9),
        ("dec_tiger", 0.95),
        ("fire_fighting_graph", 0.9),
        ("grid_small", 0.9),
        ("patrol", 0.9),
    ],
)
def test_values_at_the_start_are_those_of_madp(problem, discount):
    told = figures.of(problem)["values"][str(discount)]["qmdp"]
    solved = figures.model(problem, discount)
    found = qmdp(solved, limits=Limits(gap=1e-6))
    exactness = 1e-4 * discount / (1 - discount) + 2e-6
    np.testing.assert_allclose(found.policy.q_values(solved.initial_belief), told, atol=exactness)
    assert found.lower == -np.inf
    assert abs(found.upper - max(told)) <= exactness


@given(model=flat_models(kinds=("POMDP",), events=True) | factored_models(events=True))
@settings(max_examples=40)
def test_vectors_are_the_values_of_the_mdp_from_above(model):
    if model.discount == 1:
        model = model.with_discount(0.95)
    if model.kind == "MDP":
        return
    flat = model.flatten()
    states = MDP(
        [flat.transition_matrix(a) for a in range(len(flat.action_space))], flat.rewards, discount=flat.discount
    )
    truth = policy_iteration(states, limits=Limits(gap=0)).policy.values.T
    for gap, limit in ((1e-4, None), (0, 2)):
        found = qmdp(model, limits=Limits(gap=gap, iterations=limit))
        assert found.policy.actions == list(range(len(flat.action_space)))
        assert (found.policy.vectors >= truth - 1e-6).all()
        assert found.upper >= (truth @ flat.initial_belief).max() - 1e-6
        if limit is None:
            assert (found.policy.vectors <= truth + gap + 1e-6).all()
            assert found.reason == "converged"


def test_without_a_discount_it_is_exact_or_no_bound():
    on = np.array([[0, 1, 0], [0, 0, 1], [0, 0, 1.0]])
    rewards = [[-2, -1], [-5, -1], [0, 0]]
    model = POMDP([np.eye(3), on], np.ones((2, 3, 1)), rewards, discount=1, initial_belief=[1, 0, 0])
    found = qmdp(model)
    np.testing.assert_allclose(found.policy.vectors, [[-4, -6, 0], [-2, -1, 0]])
    assert (found.lower, found.upper, found.reason) == (-np.inf, -2, "exact")
    assert qmdp(model, limits=Limits(iterations=1)).upper in {-2, np.inf}
    with refused(ModelError):
        qmdp(POMDP([np.eye(1)], np.ones((1, 1, 1)), [[1.0]], discount=1))
