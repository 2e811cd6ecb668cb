"""Beliefs over factored models that are never flattened, against those over their matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from random_models import factored_models

from mdm.beliefs import BeliefTracker, choice as belief_choice
from mdm.beliefs.filter import Support
from mdm.beliefs.support import NetworkFilter
from mdm.models import POMDP, Factor, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork
from mdm.models.factored import model as factored_model
from mdm.models.factored.flattening import first_states


@given(factored_models(events=True), st.integers(0, 2**32 - 1))
def test_it_moves_beliefs_as_matrices_do(model, seed):
    assume(isinstance(model, POMDP))
    random = np.random.default_rng(seed)
    filter_ = NetworkFilter(model.network)
    filter_.load(Support(*first_states(model.network)))
    assert filter_.dense() == pytest.approx(model.initial_belief, abs=1e-12)
    belief = np.array(model.initial_belief)
    for _ in range(4):
        a = int(random.integers(len(model.action_space)))
        symbols = random.choice(len(model.observation_space), size=random.integers(0, 3)).tolist()
        if symbols:
            joint = sum(np.asarray(_dense(model.joint_matrix(a, o))) for o in set(symbols))
        else:
            joint = np.asarray(_dense(model.transition_matrix(a)))
        expected = belief @ joint
        chance = expected.sum()
        got = filter_.step_any(a, symbols) if symbols else filter_.predict(a)
        assert got == pytest.approx(chance, abs=1e-12)
        if chance > 1e-9:
            belief = expected / chance
        assert filter_.dense() == pytest.approx(belief, abs=1e-9)


def _dense(matrix):
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def lamps(count):
    """Return a model of so many lamps that each go out or stay, of which the first is seen."""
    states = Space(Factor(f"lamp{k}", ["off", "on"]) for k in range(count))
    transitions = [
        Table([Node("state", k), Node("next_state", k)], [[1.0, 0.0], [0.5 if k == 1 else 0.0, 0.5 if k == 1 else 1.0]])
        for k in range(count)
    ]
    return FactoredPOMDP(
        TwoSliceNetwork(
            states,
            Space.single("agent", ["wait"]),
            Space.single("agent", ["dark", "light"]),
            initial=[Table([Node("state", k)], [0.0, 1.0]) for k in range(count)],
            transitions=transitions,
            observation=[Table([Node("next_state", 1), Node("observation", 0)], [[0.8, 0.2], [0.3, 0.7]])],
            utilities=[],
            fully_observed=[True] + [False] * (count - 1),
        ),
        discount=0.9,
    )


def test_a_model_of_a_thousand_billion_states_is_tracked():
    model = lamps(40)
    tracker = BeliefTracker(model)
    assert len(model.state_space) == 2**40
    assert tracker.is_sparse
    assert tracker.update(0, 0) == pytest.approx(0.5 * 0.8 + 0.5 * 0.3)
    states, probabilities = tracker.support
    chance = dict(zip(states.tolist(), probabilities.tolist(), strict=True))
    on, off = 2**40 - 1, 2**40 - 1 - 2**38
    assert chance == pytest.approx({on: 0.15 / 0.55, off: 0.4 / 0.55})
    tracker.reset()
    assert tracker.support.states.tolist() == [on]


def test_what_is_seen_of_such_a_model_is_a_factor_of_its_observations():
    seen = lamps(40).revealed()
    tracker = BeliefTracker(seen)
    assert tracker.update(0, (0, 1)) == 0.0  # the first lamp is on and stays on
    assert tracker.update(0, (1, 1)) == pytest.approx(0.45)
    assert tracker.update(0, (None, 0)) > 0


def test_small_models_are_flattened(monkeypatch):
    model = lamps(3)
    assert not isinstance(belief_choice.chosen_filter(model), NetworkFilter)
    monkeypatch.setattr(factored_model, "_ROWS", 7)
    assert isinstance(belief_choice.chosen_filter(model), NetworkFilter)


@given(factored_models(events=True), st.integers(0, 2**32 - 1))
def test_a_sparing_tracker_believes_what_one_of_matrices_does(model, seed):
    """Also where components of observations are missing, and where nothing is observed."""
    assume(isinstance(model, POMDP))
    random = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(factored_model, "_SMALL", 0)
        spare = model.sparingly().step_by_step()
        assert spare.stays_factored
        tracker = BeliefTracker(spare)
    assert isinstance(tracker._filter, NetworkFilter)
    flat = BeliefTracker(model.flatten().step_by_step())
    sizes = model.observation_space.shape
    for _ in range(5):
        action = int(random.integers(len(model.action_space)))
        seen = [None if random.random() < 0.4 else int(random.integers(size)) for size in sizes]
        observation = None if random.random() < 0.2 else seen
        chance = tracker.update(action, observation)
        assert chance == pytest.approx(flat.update(action, observation), abs=1e-12)
        np.testing.assert_allclose(tracker.belief, flat.belief, atol=1e-12)
        values = random.normal(size=len(model.state_space))
        assert tracker.expected(values) == pytest.approx(flat.expected(values), abs=1e-11)


def test_what_may_be_missed_is_summed_over_by_matrices(monkeypatch):
    """Steps without an observation lead from any state to any: they are not computed on the network."""
    monkeypatch.setattr(factored_model, "_SMALL", 0)
    model = lamps(3)
    assert model.sparingly().stays_factored
    assert not model.stays_factored
    assert not model.with_false_negatives("dark").sparingly().stays_factored
    network = model.network
    seen = [Node("state", 0), Node("observation", 0)]
    events = FactoredPOMDP(
        TwoSliceNetwork(
            network.states,
            network.actions,
            network.observations,
            initial=network.initial,
            transitions=network.transitions,
            observation=[Table(seen, [[0.5, 0.25], [0.5, 0.5]])],
        ),
        discount=0.9,
    )
    assert not events.sparingly().stays_factored
    assert events.sparingly().step_by_step().stays_factored
