"""The smallest change of a belief: against linear programs of another form, and beliefs that are drawn near by."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from nearest import (
    SMALL,
    check,
    drawn,
    nearest_of_all,
    nearest_of_masked,
    random_alpha,
    random_masked,
    random_mixed,
    solved,
)
from sentences import refused

from mdm import ModelError
from mdm.explanation import belief_change, moved, nearest_belief
from mdm.policies import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors, RandomPolicy

SEEDS = st.integers(0, 2**32 - 1)
# Listening is right from 0.1 to 0.9.
TIGER = AlphaVectors([[0, 0], [10, -90], [-90, 10]], [0, 1, 2])


def test_the_change_that_can_be_read_off():
    after = nearest_belief(TIGER, np.array([0.5, 0.5]))
    assert moved(np.array([0.5, 0.5]), after) == pytest.approx(0.4, abs=1e-8)
    assert sorted(after) == pytest.approx([0.1, 0.9])
    assert nearest_belief(TIGER, np.array([0.95, 0.05])) == pytest.approx([0.9, 0.1])


@pytest.mark.parametrize("name", SMALL)
def test_problems_of_the_field(name):
    random = np.random.default_rng(1)
    _, policy = solved(name)
    for _ in range(6):
        belief = drawn(random, policy.num_states)
        check(random, policy, belief, nearest_of_all(policy, belief))


@given(SEEDS)
def test_random_vectors(seed):
    random = np.random.default_rng(seed)
    policy = random_alpha(random, int(random.integers(2, 6)))
    belief = drawn(random, policy.num_states)
    check(random, policy, belief, nearest_of_all(policy, belief))


@given(SEEDS)
def test_masked_vectors_for_every_support(seed):
    random = np.random.default_rng(seed)
    policy = random_masked(random, int(random.integers(2, 5)))
    belief = drawn(random, policy.num_states)
    check(random, policy, belief, nearest_of_masked(policy, belief))


@given(SEEDS)
@example(418)  # half of the votes, which rounding had not let win
def test_vectors_of_what_is_observed(seed):
    random = np.random.default_rng(seed)
    policy = random_mixed(random, int(random.integers(2, 5)))
    belief = np.zeros(policy.num_states)
    belief[policy.states[random.integers(3)]] = drawn(random, policy.states.shape[1])
    check(random, policy, belief, tries=200)


def test_a_mask_that_next_to_nothing_breaks():
    policy = MaskedAlphaVectors([{0: 5.0, 1: 5.0}, {0: 0.0, 1: 0.0, 2: 0.0}], [0, 1])
    belief = np.array([0.5, 0.5, 0.0])
    after = nearest_belief(policy, belief)
    assert policy.action(after) == 1
    assert moved(belief, after) < 1e-9


def test_half_of_the_votes():
    policy = MixedAlphaVectors([[1, 1], [1, 1]], actions=[0, 1], observed=[0, 1])
    belief = np.array([0.5, 0.5, 0, 0])
    after = nearest_belief(policy, belief)
    assert policy.action(after) == 1
    assert moved(belief, after) == pytest.approx(0.5)


def test_a_policy_that_always_decides_the_same():
    assert nearest_belief(AlphaVectors([[1, 0], [0, 1]], [1, 1]), np.array([0.5, 0.5])) is None
    assert nearest_belief(AlphaVectors([[1, 0], [0, -1]], [1, 0]), np.array([0.5, 0.5])) is None


def test_a_vector_that_is_as_good_in_one_place_alone():
    """Action 0 is as good as action 1 in the first state and nowhere better: of equal ones the lower is chosen."""
    policy = AlphaVectors([[1.0, 0.0], [1.0, 1.0]], [0, 1])
    assert nearest_belief(policy, np.array([0.5, 0.5])).tolist() == [1.0, 0.0]


def test_what_cannot_be_computed(monkeypatch):
    with refused(ModelError):
        nearest_belief(RandomPolicy(2, 2), np.array([0.5, 0.5]))
    with refused(ModelError):
        nearest_belief(random_mixed(np.random.default_rng(0), 2), np.full(6, 1 / 6))
    monkeypatch.setattr(belief_change, "_LARGEST", 5)
    with refused(ModelError):
        nearest_belief(TIGER, np.array([0.5, 0.5]))


def test_the_measure_is_half_the_l1_distance():
    assert moved(np.array([0.5, 0.5, 0]), np.array([0.2, 0.5, 0.3])) == pytest.approx(0.3)
