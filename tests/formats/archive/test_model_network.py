"""Networks in archives: factored models stay factored."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import given
from random_models import NAMES, assert_same, factored_models

from mdm import load_model
from mdm.errors import ModelWarning
from mdm.formats.archive import model as archive
from mdm.models import FactoredPOMDP
from mdm.problems import rock_sample


@given(model=factored_models(names=NAMES, events=True))
def test_factored_models_stay_factored(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.npz"
    archive.write(model, path)
    again = load_model(path)
    assert type(again) is type(model)
    assert again.state_space == model.state_space
    assert again.network.fully_observed == model.network.fully_observed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        assert_same(model, again, within=0)


def test_a_large_factored_model_comes_back(tmp_path):
    model = rock_sample(7, 8)
    archive.write(model, tmp_path / "m.npz")
    again = load_model(tmp_path / "m.npz")
    assert isinstance(again, FactoredPOMDP)
    assert again.network.fully_observed == model.network.fully_observed
    assert abs(model.transition_matrix(5) - again.transition_matrix(5)).max() == 0
    np.testing.assert_array_equal(model.rewards, again.rewards)
