"""Statements of rewards, against plain arrays that are filled one after another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import sparse
from sentences import refused

from mdm import ModelError
from mdm.formats.cassandra import parameters as rewards_module
from mdm.formats.cassandra.parameters import Rewards

NUMBERS = st.integers(-3, 3).map(float)


class Filled:
    """Draws statements, and does to an array of A x S x S' x O what they say; of an MDP with one observation."""

    def __init__(self, data):
        self.data = data
        self.mdp = data.draw(st.booleans())
        self.actions, self.states, width = (data.draw(st.integers(1, 3)) for _ in range(3))
        self.width = 1 if self.mdp else width
        self.rewards = Rewards(self.actions, self.states, 0 if self.mdp else self.width)
        self.array = np.zeros((self.actions, self.states, self.states, self.width))

    def numbers(self, *shape):
        size = int(np.prod(shape))
        return np.array(self.data.draw(st.lists(NUMBERS, min_size=size, max_size=size))).reshape(shape)

    def place(self, size, form):
        """Return no place, one or several, and the index that it is."""
        if form == "all":
            return None, slice(None)
        if form == "one":
            index = self.data.draw(st.integers(0, size - 1))
            return index, index
        places = np.array(self.data.draw(st.lists(st.integers(0, size - 1), min_size=4, max_size=4)))
        return places, places

    def statement(self):
        action = self.data.draw(st.none() | st.integers(0, self.actions - 1))
        which = slice(None) if action is None else action
        sizes = (self.states, self.states, self.width)
        row = self.data.draw(st.sampled_from(["no", "no", "row", "matrix"]))
        if row == "no":
            self.listed(action, which, sizes)
            return
        named = {"row": 1 if self.mdp else 2, "matrix": 0 if self.mdp else 1}[row]
        forms = ["one" if self.data.draw(st.booleans()) else "all" for _ in range(named)]
        places = [self.place(size, form) for size, form in zip(sizes, forms, strict=False)]
        given_places = [place for place, _ in places] + [None] * (3 - named)
        value = self.numbers(*(sizes[named:2] if self.mdp else sizes[named:]))
        self.rewards.add(action, *given_places, value)
        self.array[(which, *(index for _, index in places))] = value[..., None] if self.mdp else value

    def listed(self, action, which, sizes):
        forms = [self.data.draw(st.sampled_from(["all", "one", "several"])) for _ in sizes]
        if self.mdp:
            forms[2] = "all"
        places = [self.place(size, form) for size, form in zip(sizes, forms, strict=True)]
        several = "several" in forms
        value = self.numbers(4) if several and self.data.draw(st.booleans()) else float(self.numbers(1)[0])
        self.rewards.add(action, *(place for place, _ in places), value)
        for each in range(4 if several else 1):
            index = [i[each] if isinstance(i, np.ndarray) else i for _, i in places]
            self.array[(which, *index)] = value[each] if np.ndim(value) else value


def stochastic(random, *shape):
    array = random.random(shape) * (random.random(shape) < 0.6)
    array[..., 0] += 0.01
    return array / array.sum(axis=-1, keepdims=True)


@pytest.mark.parametrize("block", [1, rewards_module._BLOCK])
@given(data=st.data())
def test_the_last_statement_that_covers_an_outcome_counts(block, data):
    filled = Filled(data)
    for _ in range(data.draw(st.integers(0, 5))):
        filled.statement()
    rewards, array, mdp = filled.rewards, filled.array, filled.mdp
    np.testing.assert_array_equal(rewards.array(array.size), array[..., 0] if mdp else array)
    assert rewards.array(array.size - 1) is None
    flat = array.reshape(*array.shape[:2], -1)
    assert rewards.finer == (flat != flat[..., :1]).any()
    for place in np.ndindex(array.shape):
        assert rewards.at(*place[:3], None if mdp else place[3]) == array[place]
    random = np.random.default_rng(0)
    moves = stochastic(random, *array.shape[:3])
    told = stochastic(random, filled.actions, filled.states, filled.width)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rewards_module, "_BLOCK", block)
        found = rewards.expected(
            [sparse.csr_array(matrix) for matrix in moves],
            None if mdp else [sparse.csr_array(matrix) for matrix in told],
        )
    expected = np.einsum("asn,asno->sa", moves, array) if mdp else np.einsum("asn,ano,asno->sa", moves, told, array)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_reward_that_depends_on_the_observation_needs_one():
    rewards = Rewards(1, 2, 2)
    rewards.add(0, None, None, None, 1.0)
    rewards.add(0, 0, None, 1, 5.0)
    assert rewards.at(0, 0, 0, 1) == 5
    assert rewards.at(0, 0, 0, 0) == 1
    with refused(ModelError):
        rewards.at(0, 0, 0, None)
