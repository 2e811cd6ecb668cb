"""Mixed observability: models whose agent sees some factors of the state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import distributions
from sentences import refused

from mdm import ModelError
from mdm.beliefs import BeliefTracker
from mdm.models import POMDP, Factor, FactoredPOMDP, MixedPOMDP, Space
from mdm.models.factored import flattening
from mdm.models.factored.factoring import as_network
from mdm.problems import patrol, tag


def model_of(seed, sizes):
    random = np.random.default_rng(seed)
    states = Space(Factor(f"f{place}", size) for place, size in enumerate(sizes))
    count = len(states)
    flat = POMDP(
        distributions(random, 2, count, count),
        distributions(random, 2, count, 2),
        random.normal(size=(count, 2)),
        discount=0.9,
        states=states,
        initial_belief=distributions(random, count),
    )
    return FactoredPOMDP(as_network(flat), discount=0.9)


@st.composite
def mixed(draw):
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=3))
    places = draw(st.sets(st.sampled_from(range(len(sizes))), min_size=1))
    return model_of(draw(st.integers(0, 2**32 - 1)), sizes), sorted(places)


@given(mixed())
def test_an_observation_is_what_is_seen_and_what_was_observed_before(given_):
    model, places = given_
    seen = MixedPOMDP(model, places)
    shape = [model.state_space.shape[place] for place in places]
    for a in range(2):
        for s in range(len(model.state_space)):
            digits = model.state_space.unravel(s)
            x = np.ravel_multi_index([digits[place] for place in places], shape)
            expected = np.zeros((np.prod(shape), 2))
            expected[x] = model.observation_matrix(a)[s]
            assert seen.observation(a, s) == pytest.approx(expected.ravel())
    assert seen.observation_space.shape == (*shape, 2)
    assert (seen.rewards == model.rewards).all()
    again = flattening.observation_matrices(seen.network)
    for a in range(2):
        assert again[a].toarray() == pytest.approx(seen.observation_matrix(a).toarray())


@given(mixed(), st.integers(0, 2**32 - 1))
def test_beliefs_lie_in_what_is_seen(given_, seed):
    model, places = given_
    seen = MixedPOMDP(model, places)
    tracker = BeliefTracker(seen)
    random = np.random.default_rng(seed)
    o = int(random.integers(len(seen.observation_space)))
    before = tracker.belief
    if tracker.update(1, o) > 0:
        x = o // 2
        assert set(np.flatnonzero(tracker.belief)) <= set(seen.layout[x])
        by_hand = (before @ model.transition_matrix(1)) * model.observation_matrix(1)[:, o % 2] * (seen.seen_in == x)
        assert tracker.belief == pytest.approx(by_hand / by_hand.sum(), abs=1e-12)


@given(mixed())
def test_the_first_belief_is_that_of_who_sees_the_first_state(given_):
    model, places = given_
    seen = MixedPOMDP(model, places)
    assert np.sort(seen.layout.ravel()).tolist() == list(range(len(model.state_space)))
    total = np.zeros(len(model.state_space))
    for s in np.flatnonzero(model.initial_belief):
        first = seen.belief_at_start(s)
        assert first.sum() == pytest.approx(1)
        assert set(np.flatnonzero(first)) <= set(seen.layout[seen.seen_in[s]])
        total += model.initial_belief[s] * first
    assert total == pytest.approx(model.initial_belief)
    assert (model.belief_at_start(0) == model.initial_belief).all()


def test_what_goes_wrong_is_told():
    model = model_of(1, [2, 2])
    with refused(ModelError):
        MixedPOMDP(model, [2])
    with refused(ModelError):
        MixedPOMDP(model, [1, 0, 1])
    with refused(ModelError):
        MixedPOMDP(model, [0]).belief_at_start(-1)
    never = np.flatnonzero(MixedPOMDP(model, [0, 1]).initial_belief == 0)
    for s in never:
        with refused(ModelError):
            MixedPOMDP(model, [0, 1]).belief_at_start(s)
    flat = POMDP(np.full((1, 2, 2), 0.5), np.ones((1, 1, 2, 2)), np.ones((2, 1)), discount=0.5, event_observations=True)
    events = FactoredPOMDP(as_network(flat), discount=0.5)
    with refused(ModelError):
        MixedPOMDP(events, [0])


def test_fully_observed_factors_are_revealed():
    model = tag()
    seen = model.revealed()
    assert isinstance(seen, MixedPOMDP)
    assert seen.layout.shape == (29, 30)
    assert seen.observation_space.factors[0].name == model.state_space.factors[0].name
    hidden = patrol()
    assert hidden.revealed() is hidden
