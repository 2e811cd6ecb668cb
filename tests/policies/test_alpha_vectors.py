from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm import load_policy
from mdm.errors import ModelError
from mdm.policies import AlphaVectors

TABLES = ["GridSmall.dpomdp_0.9", "broadcastChannel.dpomdp_0.9", "dectiger.dpomdp_0.9", "dectiger.dpomdp_0.95"]


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 4), st.integers(1, 3))
def test_the_maximal_vector_decides_and_ties_go_to_the_lowest_action(seed, count, states, num_actions):
    random = np.random.default_rng(seed)
    vectors = random.integers(-2, 3, size=(count, states)).astype(float)
    actions = random.integers(num_actions, size=count).tolist()
    policy = AlphaVectors(vectors, actions, num_actions)
    belief = random.dirichlet(np.ones(states))
    belief = np.eye(states)[0] if seed % 2 else belief
    by_action = [
        max(
            (float(sum(v * b for v, b in zip(vector, belief, strict=True))) for vector, a in pairs if a == action),
            default=-np.inf,
        )
        for action in range(num_actions)
        for pairs in [list(zip(vectors, actions, strict=True))]
    ]
    np.testing.assert_allclose(policy.q_values(belief), by_action)
    assert policy.value(belief) == pytest.approx(max(by_action))
    assert by_action[policy.action(belief)] == pytest.approx(max(by_action))
    if seed % 2:  # at a corner sums are exact, so that ties are real
        assert policy.action(belief) == by_action.index(max(by_action))


@pytest.mark.parametrize("name", TABLES)
def test_agrees_with_madp(corpus, name):
    """Q-values at random beliefs as MADP evaluates its own value functions."""
    oracle = json.loads((corpus / "values" / f"{name}.json").read_text())
    policy = load_policy(corpus / "values" / f"{name}.vf")
    for sample in oracle["qav_oracle"]:
        belief = np.array(sample["b"])
        expected = np.array(sample["q"])[: policy.num_actions]
        never = expected < -1e300
        values = policy.q_values(belief)
        np.testing.assert_allclose(values[~never], expected[~never], rtol=1e-12)
        assert (values[never] == -np.inf).all()
        assert policy.action(belief) == sample["argmax_first"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[1.0, 2.0]], [0, 1]), "1 alpha vectors, but 2 actions"),
        (([1.0, 2.0], [0]), "vectors x states"),
        (([[1.0, np.nan]], [0]), "vector 0 has a number that is not finite"),
        (([[1.0], [2.0]], [0, -1]), "vector 1 is for action -1"),
        (([[1.0], [2.0]], [0, 0.5]), "vector 1 is for action 0.5; actions are whole numbers"),
        (([[1.0], [2.0, 3.0]], [0, 0]), "no array of numbers"),
        (([[1.0], [2.0]], [0, 3], 3), "vector 1 is for action 3, but the actions are 0 to 2"),
    ],
)
def test_wrong_vectors_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        AlphaVectors(*arguments)


def test_a_belief_over_other_states_is_refused():
    policy = AlphaVectors([[1.0, 2.0]], [0])
    for method in (policy.action, policy.value, policy.q_values):
        with pytest.raises(ModelError, match=r"beliefs of 2 numbers, not of shape \(3,\)"):
            method(np.full(3, 1 / 3))
