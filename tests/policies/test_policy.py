"""What every kind of policy says of itself: its arrays and sizes, whether it fits a model, how it prints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from policy_files import model_of
from random_policies import KINDS, assert_same, floats

from mdm import ModelError
from mdm.models import MDP, POMDP, Factor, Space
from mdm.policies import (
    PACKABLE,
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    QTable,
    StagedPolicy,
    mismatch,
)


def pack(policy):
    return policy.kind, *policy.packed()


def unpack(kind, sizes, arrays, seed=None):
    return PACKABLE[kind].unpacked(sizes, arrays, seed)


def staged(random, count):
    return StagedPolicy(floats(random, 2, count, 3))


@pytest.mark.parametrize("make", [*KINDS, staged])
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4))
def test_every_kind_comes_back(make, seed, count):
    policy = make(np.random.default_rng(seed), count)
    again = unpack(*pack(policy))
    assert type(again) is type(policy)
    assert_same(again, policy)


@pytest.mark.parametrize("make", [*KINDS, staged])
def test_no_array_and_no_size_can_be_missing(make):
    kind, sizes, arrays = pack(make(np.random.default_rng(2), 3))
    optional = {name for name in arrays if kind in {"controller", "joint"} and name.endswith("values")}
    for name in arrays.keys() - optional:
        with pytest.raises(KeyError, match=name):
            unpack(kind, sizes, {other: array for other, array in arrays.items() if other != name})
    for name in sizes:
        with pytest.raises(KeyError, match=name):
            unpack(kind, {other: size for other, size in sizes.items() if other != name}, arrays)


def test_a_stochastic_policy_draws_by_the_seed_that_it_is_unpacked_with():
    def draws(seed):
        policy = unpack("stochastic", {}, {"probabilities": np.array([[0.5], [0.5]])}, seed)
        return [policy.action(0) for _ in range(30)]

    assert draws(1) == draws(1)
    assert draws(1) != draws(2)


@pytest.mark.parametrize(
    ("kind", "sizes", "arrays", "words"),
    [
        ("deterministic", {"actions": 2}, {"actions": [[0]]}, "one-dimensional, of whole numbers"),
        ("deterministic", {"actions": 2}, {"actions": [0.5]}, "one-dimensional, of whole numbers"),
        ("controller", {"actions": 1, "start": 0}, {"actions": [0], "successors": [0]}, "a nodes x observations array"),
        ("joint", {"agents": 0}, {}, "agent"),
    ],
)
def test_what_is_no_policy_is_refused(kind, sizes, arrays, words):
    with pytest.raises(ModelError, match=words):
        unpack(kind, sizes, {name: np.array(array) for name, array in arrays.items()})


MDP_OF_2 = MDP([np.eye(2)] * 3, np.zeros((2, 3)), discount=0.9)


def team(*observations):
    """Return a model of two agents of 2 and 3 actions, who share the observations given."""
    observed = Space([Factor(f"seen{place}", size) for place, size in enumerate(observations)])
    told = np.full((6, 2, len(observed)), 1 / len(observed))
    actions = Space([Factor("first", 2), Factor("second", 3)])
    return POMDP([np.eye(2)] * 6, told, np.zeros((2, 6)), discount=0.9, actions=actions, observation_names=observed)


def controller(actions, observations, **options):
    return FiniteStateController([0], [[0] * observations], actions, **options)


@pytest.mark.parametrize(
    ("policy", "model"),
    [
        (DeterministicPolicy([0, 2], 3), MDP_OF_2),
        (QTable([[0.0, 1, 2]] * 2), model_of()),
        (AlphaVectors([[1, 2]], [0], 3), model_of()),
        (controller(3, 2), model_of()),
        (controller(3, 2, values=[[1, 2]]), model_of()),
        (JointController([controller(2, 2), controller(3, 4)]), team(2, 4)),
    ],
)
def test_what_fits(policy, model):
    assert mismatch(policy, model) is None


@pytest.mark.parametrize(
    ("policy", "model", "words"),
    [
        (DeterministicPolicy([0, 2, 1], 3), MDP_OF_2, "for 3 states, but the model has 2"),
        (DeterministicPolicy([0, 1], 2), MDP_OF_2, "for 2 actions, but the model has 3"),
        (AlphaVectors([[1, 2, 3]], [0], 3), model_of(), "for 3 states, but the model has 2"),
        (controller(3, 2), MDP_OF_2, "needs observations, but the model has none"),
        (controller(2, 2), model_of(), "the policy is for 2 actions, but the model has 3"),
        (controller(2, 4), model_of(), "for 2 actions and 4 observations, but the model has 3 and 2"),
        (controller(3, 4), model_of(), "the policy is for 4 observations, but the model has 2"),
        (controller(3, 2, values=[[1, 2, 3]]), model_of(), "values are for 3 states, but the model has 2"),
        (JointController([controller(6, 8)]), team(2, 4), "for 1 agents, but the model has 2"),
        (JointController([controller(2, 8), controller(3, 8)]), team(8), "need a factor for each of its 2 agents"),
        (
            JointController([controller(2, 2), controller(3, 2)]),
            team(2, 4),
            "agent 1: the policy is for 2 observations, but the model has 4",
        ),
    ],
)
def test_what_does_not_fit_is_said(policy, model, words):
    found = mismatch(policy, model)
    assert found is not None
    assert words in found


def test_a_policy_prints_short():
    assert repr(QTable([[0, 1], [1, 0]])) == "<QTable: 2 states, 2 actions>"
    assert repr(AlphaVectors([[0, 1]], [2])) == "<AlphaVectors: 2 states, 3 actions, 1 vectors>"
