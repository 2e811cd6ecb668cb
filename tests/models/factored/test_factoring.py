"""Flat models as networks: flattened again, they are the same."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from random_models import assert_same, factored_models, flat_models
from sentences import refused

from mdm import ModelError
from mdm.errors import ModelWarning
from mdm.models import MDP, POMDP, FactoredMDP, FactoredPOMDP
from mdm.models.factored.factoring import as_network


def again(model):
    kind = FactoredMDP if model.kind == "MDP" else FactoredPOMDP
    return kind(as_network(model), discount=model.discount, sparse=model.is_sparse)


@given(model=flat_models(events=True))
def test_flattened_again_a_model_is_the_same(model):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        assert_same(model, again(model), within=1e-9, finer=True)


@given(model=flat_models(events=True))
def test_each_factor_depends_on_those_before_it(model):
    network = as_network(model)
    assert (network.states, network.actions) == (model.state_space, model.action_space)
    assert network.observations == (model.observation_space if model.kind == "POMDP" else None)
    for role, order in network.orders.items():
        assert order == tuple(range(len(network.factors(role))))


@given(model=factored_models(events=True))
def test_a_factored_model_has_a_network_already(model):
    assert as_network(model) is model.network


@pytest.mark.parametrize("nonsense", [np.nan, np.inf, -3.0, 7.0])
def test_what_is_told_of_impossible_transitions_means_nothing(nonsense):
    told = np.full((1, 2, 2, 2), 0.5)
    told[0, :, 0, 1] = nonsense
    model = POMDP([np.eye(2)], told, np.zeros((2, 1)), discount=0.9, event_observations=True)
    assert_same(model, again(model))
    assert model.joint_matrix(0, 0).tolist() == [[0.5, 0], [0, 0.5]]


def test_what_would_be_too_large_is_refused_at_once():
    size = 5000
    model = MDP([np.eye(1)], np.zeros((1, 1)), discount=0.9)
    as_network(model)
    from scipy.sparse import eye_array

    large = MDP([eye_array(size, format="csr")], np.zeros((size, 1)), discount=0.9)
    with refused(ModelError):
        as_network(large)


def test_how_large_counts_the_state_before_only_where_observations_are_events(monkeypatch):
    monkeypatch.setattr("mdm.models.factored.factoring._LARGEST", 2 * 3 * 5)
    options = {"discount": 0.9, "observation_names": 5}
    states = POMDP(np.tile(np.eye(3), (2, 1, 1)), np.full((2, 3, 5), 0.2), np.zeros((3, 2)), **options)
    assert len(as_network(states).observation) == 1
    events = POMDP(
        np.tile(np.eye(3), (2, 1, 1)),
        np.full((2, 5, 3, 3), 0.2),
        np.zeros((3, 2)),
        event_observations=True,
        **options,
    )
    with refused(ModelError):
        as_network(events)
