"""Links between variables of one role: dropped where there is independence, else joined."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from random_models import assert_same, factored_models
from sentences import refused

from mdm.errors import ModelError
from mdm.models import POMDP, Factor, FactoredMDP, FactoredPOMDP, Space
from mdm.models.factored.factoring import as_network, joined, unlinked

SEEN = Space([Factor("left", ["no", "yes"]), Factor("right", ["no", "yes", "perhaps"])])


def team(joint):
    """Return the network of a model that tells two agents of its single state."""
    return as_network(POMDP([np.eye(1)], [joint.reshape(1, -1)], [[0.0]], discount=0.9, observation_names=SEEN))


def links(network):
    return [node for potential in network.observation for node in potential.scope if node.role == "observation"]


def test_independent_observations_need_no_links():
    network = team(np.outer([0.25, 0.75], [0.5, 0.5, 0]))
    assert len(links(network)) == 3
    free = unlinked(network, "observation")
    assert [table.values.ravel().tolist() for table in free.observation] == [[0.25, 0.75], [0.5, 0.5, 0]]
    assert len(links(free)) == 2


def test_observations_that_depend_on_each_other_are_joined():
    joint = np.array([[0.5, 0, 0.125], [0, 0.25, 0.125]])
    network = team(joint)
    assert unlinked(network, "observation") is None
    one = joined(network, "observations")
    (factor,) = one.observations.factors
    assert (factor.name, factor.names[:3]) == ("left_right", ("no_no", "no_yes", "no_perhaps"))
    np.testing.assert_allclose(one.observation[0].values.ravel(), joint.ravel(), rtol=0, atol=1e-15)


def test_joined_names_that_would_be_alike_are_numbers():
    space = Space([Factor("x", ["a", "a_b"]), Factor("y", ["b_c", "c"])])
    model = POMDP([np.eye(1)], [np.eye(4)[:1]], [[0.0]], discount=0.9, observation_names=space)
    assert joined(as_network(model), "observations").observations.names == ("0", "1", "2", "3")


@given(model=factored_models())
def test_a_network_with_fewer_links_is_the_same_model(model):
    kind = FactoredMDP if model.kind == "MDP" else FactoredPOMDP
    for role in ("state", "next_state", "observation"):
        free = unlinked(model.network, role)
        if free is not None:
            assert_same(model, kind(free, discount=model.discount))


@given(model=factored_models())
def test_a_joined_network_is_the_same_model(model):
    kind = FactoredMDP if model.kind == "MDP" else FactoredPOMDP
    assert_same(model, kind(joined(model.network, "states"), discount=model.discount), named=False)
    if model.kind == "POMDP":
        one = joined(model.network, "observations")
        assert_same(model, kind(one, discount=model.discount), named=False)


def test_tables_too_large_to_join_are_refused(monkeypatch):
    network = team(np.outer([0.25, 0.75], [0.5, 0.5, 0]))
    monkeypatch.setattr("mdm.models.factored.factoring._LARGEST", 4)
    with refused(ModelError):
        unlinked(network, "observation")
