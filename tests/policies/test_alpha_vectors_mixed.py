"""Alpha vectors for a state of which a part is observed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import ModelError
from mdm.beliefs import Support
from mdm.policies import AlphaVectors, MixedAlphaVectors

# Two observed values, three hidden states; action 2 is known for the second observed value only.
POLICY = MixedAlphaVectors([[8, 7, 7], [9, 0, 0], [5, 0, 10], [6, 6, 6]], [1, 0, 0, 2], [0, 0, 1, 1])


def belief(*parts):
    return np.array(parts, dtype=float).ravel()


def test_what_is_observed_chooses_the_vectors():
    assert (POLICY.num_states, POLICY.num_actions) == (6, 3)
    assert POLICY.action(belief([0, 1, 0], [0, 0, 0])) == 1
    assert POLICY.action(belief([1, 0, 0], [0, 0, 0])) == 0
    assert POLICY.action(belief([0, 0, 0], [0, 0, 1])) == 0
    assert POLICY.action(belief([0, 0, 0], [0.5, 0.5, 0])) == 2
    assert POLICY.value(belief([0, 0, 0], [0.5, 0.5, 0])) == 6
    assert POLICY.q_values(belief([0, 0, 0], [0.5, 0.5, 0])).tolist() == [2.5, -np.inf, 6]


def test_where_it_is_not_known_the_more_probable_wins():
    assert POLICY.action(belief([0, 0.6, 0], [0, 0.4, 0])) == 1
    assert POLICY.action(belief([0, 0.4, 0], [0, 0.6, 0])) == 2
    assert POLICY.action(belief([0, 0.5, 0], [0, 0.5, 0])) == 1
    assert POLICY.value(belief([0, 0.4, 0], [0, 0.6, 0])) == pytest.approx(0.4 * 7 + 0.6 * 6)
    assert POLICY.q_values(belief([0, 0.4, 0], [0, 0.6, 0])).tolist() == [0, -np.inf, -np.inf]


def test_an_observed_value_without_vectors():
    policy = MixedAlphaVectors([[1, 2]], [0], [1], states=[[0, 1], [2, 3], [4, 5]])
    assert policy.sets[0] is None
    assert policy.action(np.array([0.4, 0.1, 0.5, 0, 0, 0])) == 0
    assert policy.value(np.array([0.5, 0, 0.5, 0, 0, 0])) == -np.inf
    assert policy.q_values(np.array([0.5, 0, 0.5, 0, 0, 0])).tolist() == [-np.inf]
    with refused(ModelError):
        policy.action(np.array([1.0, 0, 0, 0, 0, 0]))


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 3), st.integers(1, 6))
def test_it_is_the_value_function_over_whole_states(seed, num_observed, num_hidden, count):
    random = np.random.default_rng(seed)
    vectors = random.normal(size=(count + num_observed, num_hidden))
    actions = random.integers(3, size=len(vectors)).tolist()
    observed = [*range(num_observed), *random.integers(num_observed, size=count).tolist()]
    states = random.permutation(num_observed * num_hidden).reshape(num_observed, num_hidden)
    policy = MixedAlphaVectors(vectors, actions, observed, 3, states=states)
    for x in range(num_observed):
        part = random.dirichlet(np.ones(num_hidden))
        whole = np.zeros(states.size)
        whole[states[x]] = part
        own = [index for index, of in enumerate(observed) if of == x]
        plain = AlphaVectors(vectors[own], [actions[index] for index in own], 3)
        assert policy.action(whole) == plain.action(part)
        assert policy.value(whole) == pytest.approx(plain.value(part))
        np.testing.assert_allclose(policy.q_values(whole), plain.q_values(part))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MixedAlphaVectors([[1, 2]], [0], []), "needs the index of an observed value"),
        (lambda: MixedAlphaVectors([[1, 2]], [0], [-1]), "needs the index of an observed value"),
        (lambda: MixedAlphaVectors([], [], []), "vectors x states"),
        (lambda: MixedAlphaVectors([[1, 2]], [0, 1], [0, 0]), "1 alpha vectors, but 2 actions"),
        (lambda: MixedAlphaVectors([[1, np.nan]], [0], [0]), "not finite"),
        (lambda: MixedAlphaVectors([[1, 2]], [0], [0], states=[[0, 1, 2]]), "there are 3 hidden states"),
        (lambda: MixedAlphaVectors([[1, 2]], [0], [2], states=[[0, 1], [2, 3]]), "no observed value 2"),
        (lambda: MixedAlphaVectors([[1, 2]], [0], [0], states=[[0, 0]]), "exactly once"),
        (lambda: MixedAlphaVectors([[1, 2]], [0], [0], states=[0, 1]), "observed x hidden"),
        (lambda: POLICY.action(np.ones(5)), "beliefs of 6 numbers"),
        (lambda: POLICY.value(np.ones(5)), "beliefs of 6 numbers"),
    ],
)
def test_what_is_wrong_is_said(make, words):
    with pytest.raises(ModelError) as caught:
        make()
    assert words in str(caught.value)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 3))
def test_the_support_of_a_belief_says_as_much_as_the_belief(seed, num_observed, num_hidden):
    random = np.random.default_rng(seed)
    size = num_observed * num_hidden
    states = random.permutation(size).reshape(num_observed, num_hidden)
    vectors = random.normal(size=(num_observed * 2, num_hidden))
    actions = random.integers(3, size=len(vectors)).tolist()
    policy = MixedAlphaVectors(vectors, actions, [*range(num_observed)] * 2, 3, states=states)
    chosen = random.permutation(size)[: random.integers(1, size + 1)]
    support = Support(chosen, random.dirichlet(np.ones(len(chosen))))
    whole = support.dense(size)
    assert policy.action(support) == policy.action(whole)
    assert policy.value(support) == pytest.approx(policy.value(whole))
    np.testing.assert_allclose(policy.q_values(support), policy.q_values(whole))


def test_a_support_among_other_states_is_refused():
    for states in ([6], [-1]):
        with refused(ModelError):
            POLICY.action(Support(np.array(states), np.ones(1)))
