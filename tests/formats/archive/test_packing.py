"""Policies as arrays and sizes: every kind comes back, and what is incomplete or no policy is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_policies import KINDS, assert_same, floats

from mdm import ModelError
from mdm.formats.archive.packing import pack, unpack
from mdm.policies import StagedPolicy


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
        ("magic", {}, {}, "'magic' is no kind of policy"),
        ("deterministic", {"actions": -1}, {}, "a size is not one of 0 to"),
        ("deterministic", {"actions": 2}, {"actions": [[0]]}, "other numbers or dimensions"),
        ("deterministic", {"actions": 2}, {"actions": [0.5]}, "other numbers or dimensions"),
        ("controller", {"actions": 1, "start": 0}, {"actions": [0], "successors": [0]}, "a nodes x observations array"),
        ("joint", {"agents": 0}, {}, "agent"),
    ],
)
def test_what_is_no_policy_is_refused(kind, sizes, arrays, words):
    with pytest.raises(ModelError, match=words):
        unpack(kind, sizes, {name: np.array(array) for name, array in arrays.items()})
