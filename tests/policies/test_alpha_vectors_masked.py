"""Alpha vectors that are defined on some of the states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import ModelError
from mdm.policies import AlphaVectors, MaskedAlphaVectors

POLICY = MaskedAlphaVectors([{0: 1, 1: 1, 2: 1}, {0: 5, 1: 4.5}, {2: 7}], [1, 0, 0])


@pytest.mark.parametrize(
    ("belief", "value", "action"),
    [([1, 0, 0], 5, 0), ([0.5, 0.25, 0.25], 1, 1), ([0, 0, 1], 7, 0), ([0.5, 0.5, 0], 4.75, 0)],
)
def test_only_vectors_defined_on_the_support_count(belief, value, action):
    assert POLICY.value(np.array(belief)) == value
    assert POLICY.action(np.array(belief)) == action
    assert POLICY.q_values(np.array(belief)).max() == value


def test_what_rounding_leaves_is_no_support():
    belief = np.array([0.5, 0.5, 1e-17])
    assert POLICY.action(belief) == 0
    assert POLICY.value(belief) == pytest.approx(4.75)


def test_a_value_of_zero_is_a_value():
    policy = MaskedAlphaVectors([{0: 0.0, 1: 0.0}, {0: -1.0}], [1, 0], 2)
    assert policy.action(np.array([0.5, 0.5])) == 1
    assert policy.q_values(np.array([0.5, 0.5])).tolist() == [-np.inf, 0]


def test_a_belief_that_no_vector_covers():
    policy = MaskedAlphaVectors([{0: 1.0}], [0], 2)
    assert policy.value(np.array([0.5, 0.5])) == -np.inf
    with refused(ModelError):
        policy.action(np.array([0.5, 0.5]))


def test_of_equal_vectors_the_lowest_action_wins():
    assert MaskedAlphaVectors([{0: 1}, {0: 1}], [3, 1], 2, 5).action(np.array([1.0, 0])) == 1


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 4))
def test_with_all_states_they_are_plain_alpha_vectors(seed, count, num_states):
    random = np.random.default_rng(seed)
    vectors, actions = random.normal(size=(count, num_states)), random.integers(3, size=count).tolist()
    masked = MaskedAlphaVectors([dict(enumerate(vector)) for vector in vectors.tolist()], actions, num_states, 3)
    plain = AlphaVectors(vectors, actions, 3)
    belief = random.dirichlet(np.ones(num_states))
    assert masked.action(belief) == plain.action(belief)
    np.testing.assert_allclose(masked.q_values(belief), plain.q_values(belief), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MaskedAlphaVectors([], []), "at least one"),
        (lambda: MaskedAlphaVectors([{}], [0]), "at least one state"),
        (lambda: MaskedAlphaVectors([{0: 1}], [0, 1]), "1 alpha vectors, but 2 actions"),
        (lambda: MaskedAlphaVectors([{0: 1}], [2], num_actions=2), "the actions are 0 to 1"),
        (lambda: MaskedAlphaVectors([{0: 1}], [-1]), "is for action -1"),
        (lambda: MaskedAlphaVectors([{0: 1}, {3: 1}], [0, 0], 3), "alpha vector 1 has a state outside 0 to 2"),
        (lambda: MaskedAlphaVectors([{-1: 1}], [0]), "outside 0"),
        (lambda: MaskedAlphaVectors([{0: np.inf}], [0]), "not finite"),
        (lambda: POLICY.action(np.ones(2)), "beliefs of 3 numbers"),
        (lambda: POLICY.value(np.ones((3, 1))), "not of shape (3, 1)"),
    ],
)
def test_what_is_wrong_is_said(make, words):
    with pytest.raises(ModelError) as caught:
        make()
    assert words in str(caught.value)
