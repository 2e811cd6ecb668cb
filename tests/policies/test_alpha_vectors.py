from __future__ import annotations

import figures
import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.beliefs import Support
from mdm.compilation import sparing
from mdm.errors import ModelError
from mdm.policies import AlphaVectors

TABLES = [("broadcast_channel", 0.9), ("dec_tiger", 0.9), ("dec_tiger", 0.95), ("grid_small", 0.9)]


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


@pytest.mark.parametrize("fast", [pytest.param(True, marks=pytest.mark.compiled("choices")), False])
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(1, 200), st.integers(1, 200))
def test_the_support_of_a_belief_says_as_much_as_the_belief(fast, seed, count, states, weighty):
    """Also where the vectors are so many that a dense belief is searched for its support."""
    random = np.random.default_rng(seed)
    vectors = random.normal(size=(count, states))
    actions = random.integers(5, size=count).tolist()
    policy = AlphaVectors(vectors, actions, 5)  # of both kinds, compiled or not
    chosen = random.permutation(states)[:weighty]
    support = Support(chosen, random.dirichlet(np.ones(len(chosen))))
    belief = support.dense(states)
    expected = np.full(5, -np.inf)
    for vector, action in zip(vectors, actions, strict=True):
        expected[action] = max(expected[action], sum(p * vector[s] for s, p in zip(*support, strict=True)))
    for given_ in (belief, support):
        np.testing.assert_allclose(policy.q_values(given_), expected, atol=1e-12)
        assert policy.value(given_) == pytest.approx(expected.max(), abs=1e-12)
        assert expected[policy.action(given_)] == pytest.approx(expected.max(), abs=1e-12)


@pytest.mark.parametrize("count", [3, 9_000])
def test_ties_go_to_the_lowest_action_however_the_belief_is_given(count):
    policy = AlphaVectors(np.ones((count, 10)), [2, 1, *[4] * (count - 2)])
    for states in ([3], [0, 9], range(10)):
        support = Support(np.array(states), np.full(len(states), 1 / len(states)))
        assert policy.action(support) == policy.action(support.dense(10)) == 1


@pytest.mark.compiled("choices")
def test_no_choice_has_to_wait_for_the_compiler():
    from mdm.policies import alpha_kernels

    policy = AlphaVectors(np.ones((1000, 30)), [0] * 1000)
    kernels = (alpha_kernels.at_belief, alpha_kernels.at_support)
    before = [len(kernel.signatures) for kernel in kernels]
    for belief in (np.full(30, 1 / 30), tuple([1.0] + [0.0] * 29), Support(np.array([2]), np.ones(1)).dense(30)):
        policy.action(belief)
    policy.action(Support(np.array([2]), np.ones(1)))
    assert [len(kernel.signatures) for kernel in kernels] == before


@pytest.mark.parametrize(("problem", "discount"), TABLES)
def test_agrees_with_madp(problem, discount):
    """Q-values at random beliefs as MADP evaluates its own value functions."""
    policy = figures.vectors(problem, discount)
    for sample in figures.of(problem)["values"][str(discount)]["q_at"]:
        expected = np.array([-np.inf if value is None else value for value in sample["q"]])
        np.testing.assert_allclose(policy.q_values(np.array(sample["b"])), expected, rtol=1e-10)
        assert policy.action(np.array(sample["b"])) == sample["best"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[1.0, 2.0]], [0, 1]), "1 alpha vectors, but 2 actions"),
        (([1.0, 2.0], [0]), "vectors x states"),
        (([[1.0, np.nan]], [0]), "vector 0 has a number that is not finite"),
        (([[1.0], [2.0]], [0, -1]), "vector 1 is for action -1"),
        (([[1.0], [2.0]], [0, 0.5]), "vector 1 is for action 0.5; actions are whole numbers"),
        (([[1.0], [2.0, 3.0]], [0, 0]), "not an array of numbers"),
        (([[1.0], [2.0]], [0, 3], 3), "vector 1 is for action 3, but the actions are 0 to 2"),
    ],
)
def test_wrong_vectors_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        AlphaVectors(*arguments)


def test_a_belief_over_other_states_is_refused():
    policy = AlphaVectors([[1.0, 2.0]], [0])
    for method in (policy.action, policy.value, policy.q_values):
        with refused(ModelError):
            method(np.full(3, 1 / 3))
        with refused(ModelError):
            method(Support(np.array([1, 2]), np.array([0.5, 0.5])))
    large = AlphaVectors(np.ones((10_000, 2)), [0] * 10_000)
    for method in (policy.value, large.action, large.value, large.q_values):
        for states, weights in (([1, 2], [0.5, 0.5]), ([-1], [1.0]), ([0, 1], [1.0])):
            with refused(ModelError):
                method(Support(np.array(states), np.array(weights)))
    for method in (large.action, large.value, large.q_values):
        with refused(ModelError):
            method(np.full(3, 1 / 3))


def test_many_vectors_are_not_compiled_where_memory_is_short():
    """The choice is the same, by arrays and by supports."""
    random = np.random.default_rng(0)
    vectors, actions = random.normal(size=(50, 500)), random.integers(4, size=50).tolist()
    with sparing():
        spare = AlphaVectors(vectors, actions, 4)
    plain = AlphaVectors(vectors, actions, 4)
    assert spare._at_belief.__module__ == "mdm.policies.alpha_vectors"
    for _ in range(20):
        belief = random.dirichlet(np.ones(500)) * (random.random(500) < 0.2)
        belief /= belief.sum()
        (states,) = belief.nonzero()
        assert spare.action(belief) == plain.action(belief) == spare.action(Support(states, belief[states]))
        assert spare.value(belief) == pytest.approx(plain.value(belief), abs=1e-12)
