"""Model files: the corpus, quirks, wrong input, mutated input."""

from __future__ import annotations

import json

import numpy as np
import pytest
from loading import assert_refused_where_it_breaks, load, written
from places import CORPUS, each
from random_models import dense
from sentences import refused

from mdm import FormatError, load_model, load_policy, save_model
from mdm.errors import ModelError
from mdm.policies import QTable

SUFFIXES = (".pomdp", ".mdp", ".dpomdp")


def expectations(name):
    path = CORPUS / name
    return json.loads(path.read_text()) if path.is_file() else {}


def ours(file):
    return file.lower().removesuffix(".gz").endswith(SUFFIXES)


MODELS = {file: entry for file, entry in expectations("expected.json").items() if ours(file)}
EDGE = {file: entry["expect"] for file, entry in expectations("edge/expected.json").items() if ours(file)}
MALFORMED = {
    file: entry for file, entry in expectations("malformed/expected.json").get("cases", {}).items() if ours(file)
}


@pytest.mark.foreign("models of cassandra/pomdp-solve, trey0/zmdp, AdaCompNUS/sarsop and others")
@pytest.mark.parametrize("file", each(sorted(MODELS)))
def test_real_models(corpus, file):
    expected = MODELS[file]
    model = load(corpus / file)
    sign = -1 if expected["values"].startswith("cost") else 1
    assert len(model.state_space) == expected["states"]
    assert len(model.action_space) == expected["actions"]
    assert model.discount == (expected["discount"] or 1.0)
    if expected["initial_belief"] is not None:
        np.testing.assert_allclose(model.initial_belief, expected["initial_belief"], atol=1e-9)
    for action, state, following, value in expected["T_a_s_s1"]:
        assert dense(model.transition_matrix(action)[[state]])[0, following] == pytest.approx(value, abs=1e-5)
    for action, following, symbol, value in expected["O_a_s1_o"] or []:
        assert dense(model.observation_matrix(action)[[following]])[0, symbol] == pytest.approx(value, abs=1e-5)
    for action, state, value in expected["R_a_s"]:
        assert model.rewards[state, action] == pytest.approx(sign * value, rel=1e-5, abs=1e-9)
    for key, space in (("state_names", "state_space"), ("action_names", "action_space")):
        if expected.get(key):
            assert list(getattr(model, space).names) == expected[key]


@pytest.mark.foreign("a collection of model files with one quirk each")
@pytest.mark.parametrize("file", each(sorted(EDGE)))
def test_quirks(corpus, file):
    expected = EDGE[file]
    model = load(corpus / "edge" / file)
    sign = -1 if expected["values"].startswith("cost") else 1
    sizes = (expected.get("joint_actions", expected.get("actions")), expected["states"])
    assert (len(model.action_space), len(model.state_space)) == sizes
    rewards = expected.get("R_action_state")
    if rewards is not None:
        np.testing.assert_allclose(model.rewards.T * sign, rewards, atol=1e-9)
    if expected.get("b0") is not None:
        np.testing.assert_allclose(model.initial_belief, expected["b0"], atol=1e-9)
    for action, state, following, value in expected.get("T_entries") or []:
        assert dense(model.transition_matrix(action))[state, following] == pytest.approx(value, abs=1e-9)
    for action, following, symbol, value in expected.get("O_entries") or []:
        assert dense(model.observation_matrix(action))[following, symbol] == pytest.approx(value, abs=1e-9)
    if expected["kind"] == "dpomdp":
        assert [list(factor.names) for factor in model.action_space.factors] == expected["action_names"]
        assert [list(factor.names) for factor in model.observation_space.factors] == expected["observation_names"]


@pytest.mark.foreign("a collection of broken model files")
@pytest.mark.parametrize("file", each(sorted(MALFORMED)))
def test_broken_files_are_refused_where_they_break(corpus, file):
    assert_refused_where_it_breaks(corpus / "malformed" / file, MALFORMED[file])


def test_a_file_of_ensembles_is_no_model(tmp_path):
    path = written(tmp_path, "[ensembles.robot]\n", "robot.toml")
    for read in (load_model, load_policy):
        with refused(FormatError):
            read(path)


def test_what_is_no_model_is_not_written(tmp_path):
    with refused(ModelError):
        save_model(QTable([[0, 1]]), tmp_path / "model.npz")
    assert not list(tmp_path.iterdir())
