"""Written POMDPX is read as the same model; what it has no place for is refused or told."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from loading import load
from random_models import NAMES, assert_same, factored_models, flat_models
from sentences import refused

from mdm import ModelError
from mdm.errors import ModelWarning
from mdm.formats.sarsop import model as pomdpx
from mdm.models import POMDP, FactoredPOMDP
from mdm.problems import hallway, rock_sample, tag


def joins(model, path):
    """Write a model; return whether state factors and whether observations that depend on each other were joined."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pomdpx.write(model, path)
    told = [str(warning.message) for warning in caught]
    assert all("depend on" in each for each in told)
    return [any(f"{what} depend on each other; for SARSOP" in each for each in told) for what in ("factors", "ions")]


@given(model=factored_models())
def test_factored_models_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pomdpx"
    states, observations = joins(model, path)
    again = load(path)
    assert_same(model, again, named=not states and not observations)
    if not states:
        if model.kind == "POMDP":
            assert again.network.fully_observed == model.network.fully_observed
        assert [f.name for f in again.state_space.factors] == [f.name for f in model.state_space.factors]


@given(model=flat_models())
def test_flat_models_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pomdpx"
    states, observations = joins(model, path)
    again = load(path)
    assert_same(model, again, finer=True, named=not states and not observations)


@given(model=flat_models(names=NAMES, finer=False))
def test_odd_names_are_written_so_that_they_can_be_read(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.pomdpx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        pomdpx.write(model, path)
    assert_same(model, load(path), named=False)


def test_changed_names_are_told(tmp_path):
    model = POMDP([np.eye(2)], [np.eye(2)], np.zeros((2, 1)), discount=0.9, states=["a b", "c"], actions=["*"])
    with pytest.warns(ModelWarning, match="2 names not allowed in POMDPX .* 'a b' as 'a_b', '\\*' as '_\\*'"):
        pomdpx.write(model, tmp_path / "m.pomdpx")
    assert load(tmp_path / "m.pomdpx").state_space.names == ("a_b", "c")


def test_events_have_no_place_in_it(tmp_path):
    told = np.full((1, 2, 2, 2), 0.5)
    model = POMDP([np.eye(2)], told, np.zeros((2, 1)), discount=0.9, event_observations=True)
    with refused(ModelError):
        pomdpx.write(model, tmp_path / "m.pomdpx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("model", [tag(), rock_sample(7, 8), hallway()], ids=["tag", "rock sample", "hallway"])
def test_standard_problems_come_back(tmp_path, model):
    """Large tables, most of them zero, are written by their entries."""
    joins(model, tmp_path / "again.pomdpx.gz")
    again = load(tmp_path / "again.pomdpx.gz")
    if isinstance(model, FactoredPOMDP):
        assert again.network.fully_observed == model.network.fully_observed
    for action in range(len(model.action_space)):
        difference = model.transition_matrix(action) - again.transition_matrix(action)
        assert abs(difference).max() <= 1e-12
        difference = model.observation_matrix(action) - again.observation_matrix(action)
        assert abs(difference).max() <= 1e-12
    np.testing.assert_allclose(model.rewards, again.rewards)
