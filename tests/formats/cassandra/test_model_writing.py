"""Cassandra's and MADP's formats written and read again."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from places import CORPUS, each
from random_models import NAMES, assert_same, dense, factored_models, flat_models
from sentences import refused

from mdm import FormatError, ModelError, load_model
from mdm.errors import ModelWarning
from mdm.formats.cassandra import model as cassandra
from mdm.formats.madp import dpomdp
from mdm.models import MDP, POMDP, Factor, Space


def load(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return load_model(path, **options)


def started(model, path):
    """Write a model; return it with the start that an MDP's file has: a state, or all of them alike."""
    belief = model.initial_belief
    if model.kind == "POMDP" or belief.max() == 1 or (belief == 1 / len(belief)).all():
        cassandra.write(model, path)
        return model
    with pytest.warns(ModelWarning, match="cannot hold an MDP's start distribution"):
        cassandra.write(model, path)
    return MDP(
        [model.transition_matrix(action) for action in range(len(model.action_space))],
        model.rewards,
        discount=model.discount,
        states=model.state_space,
        actions=model.action_space,
        outcome_rewards=model.outcome_rewards,
    )


@given(model=flat_models(joint=False))
def test_models_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / f"model.{model.kind.lower()}"
    assert_same(started(model, path), load(path), finer=True)


@given(model=flat_models(kinds=("POMDP",)))
def test_teams_come_back(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / "model.dpomdp"
    if len(model.observation_space.factors) != model.num_agents:
        with pytest.raises(ModelError, match="one observation factor per agent"):
            dpomdp.write(model, path)
        return
    dpomdp.write(model, path)
    again = load(path)
    assert_same(model, again, finer=True, named=len(model.state_space.factors) == 1)
    assert [factor.name for factor in again.action_space.factors] == [f.name for f in model.action_space.factors]


@given(model=flat_models(names=NAMES))
def test_odd_names_are_written_so_that_they_can_be_read(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("round")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        kept = started(model, folder / f"model.{model.kind.lower()}")
        assert_same(kept, load(folder / f"model.{model.kind.lower()}"), named=False)
        if model.kind == "POMDP" and len(model.observation_space.factors) == model.num_agents:
            dpomdp.write(model, folder / "model.dpomdp")
            assert_same(model, load(folder / "model.dpomdp"), named=False)


@given(model=factored_models())
def test_factored_models_are_written_flat(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("round") / f"model.{model.kind.lower()}.gz"
    assert_same(started(model, path), load(path), named=False, finer=True)


def test_counts_uniform_and_identity_keep_files_short(tmp_path):
    model = POMDP(
        [np.eye(3), np.full((3, 3), 1 / 3)],
        [np.eye(3)] * 2,
        np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 5.0]]),
        discount=0.5,
        states=Space.single("state", 3, prefix="s"),
        actions=["look", "jump"],
        observation_names=["x", "y", "z"],
    )
    cassandra.write(model, tmp_path / "m.pomdp")
    assert (tmp_path / "m.pomdp").read_text().splitlines() == [
        "discount: 0.5",
        "values: reward",
        "states: 3",
        "actions: look jump",
        "observations: x y z",
        "start: uniform",
        "T: look",
        "identity",
        "T: jump",
        "uniform",
        "O: * : 0 : x 1.0",
        "O: * : 1 : y 1.0",
        "O: * : 2 : z 1.0",
        "R: look : * : * : * 1.0",
        "R: jump : 2 : * : * 5.0",
    ]


def test_names_that_were_changed_are_told(tmp_path):
    model = MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9, states=["wide open", "T"], actions=["go!"])
    with pytest.warns(ModelWarning, match="3 names .*'wide open' as 'wide_open', 'T' as 'x_T', 'go!' as 'go_'"):
        cassandra.write(model, tmp_path / "m.mdp")
    assert load(tmp_path / "m.mdp").state_space.names == ("wide_open", "x_T")


def test_what_the_formats_do_not_have_is_refused(tmp_path):
    told = np.full((1, 2, 2, 2), 0.5)
    events = POMDP([np.eye(2)], told, np.zeros((2, 1)), discount=0.9, event_observations=True)
    for module, suffix in ((cassandra, "pomdp"), (dpomdp, "dpomdp")):
        with refused(ModelError):
            module.write(events, tmp_path / f"m.{suffix}")
    with refused(ModelError):
        dpomdp.write(MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9), tmp_path / "m.dpomdp")
    with refused(FormatError):
        cassandra.write(MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9), tmp_path / "missing" / "m.mdp")
    with refused(FormatError):
        cassandra.write(MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_rewards_of_outcomes_too_many_to_write_leave_the_expected_ones(tmp_path, monkeypatch):
    monkeypatch.setattr("mdm.formats.cassandra.model._LARGEST", 4)
    rewards = np.arange(8.0).reshape(1, 2, 2, 2)
    model = POMDP([np.eye(2)], [np.eye(2)], rewards, discount=0.9)
    with pytest.warns(ModelWarning, match="there are too many rewards of single outcomes"):
        cassandra.write(model, tmp_path / "m.pomdp")
    np.testing.assert_array_equal(load(tmp_path / "m.pomdp").rewards, model.rewards)


def test_what_was_there_stays_when_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "m.mdp"
    path.write_text("precious")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", fail)
    with refused(FormatError):
        cassandra.write(MDP([np.eye(2)], np.zeros((2, 1)), discount=0.9), path)
    assert [file.name for file in tmp_path.iterdir()] == ["m.mdp"]
    assert path.read_text() == "precious"


def test_team_of_counted_names(tmp_path):
    model = POMDP(
        np.stack([np.eye(1)] * 4),
        np.full((4, 1, 4), 0.25),
        np.arange(4.0)[None],
        discount=1.0,
        actions=Space(Factor(f"agent{i}", 2, prefix="a") for i in range(2)),
        observation_names=Space(Factor(f"agent{i}", 2, prefix="o") for i in range(2)),
    )
    dpomdp.write(model, tmp_path / "m.dpomdp")
    assert (tmp_path / "m.dpomdp").read_text().startswith("agents: 2\ndiscount: 1.0\n")
    assert_same(model, load(tmp_path / "m.dpomdp"), named=False)


FILES = sorted(
    path.relative_to(CORPUS).as_posix()
    for pattern in ("*.pomdp", "*.POMDP", "*.mdp", "*.MDP", "*.dpomdp", "*.dpomdp.gz", "*.pomdp.gz", "*.POMDP.gz")
    for folder in ("models", "edge")
    for path in (CORPUS / folder).rglob(pattern)
    if path.stat().st_size < 300_000
)


@pytest.mark.foreign("models of MADPToolbox/MADP, cassandra/pomdp-solve, trey0/zmdp and AdaCompNUS/sarsop")
@pytest.mark.parametrize("file", each(FILES))
def test_real_models_come_back(corpus, tmp_path, file):
    model = load(corpus / file)
    team = ".dpomdp" in file
    path = tmp_path / ("again.dpomdp" if team else f"again.{model.kind.lower()}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # names that no other reader would take
        (dpomdp if team else cassandra).write(model, path)
    again = load(path)
    assert len(again.state_space) == len(model.state_space)
    assert again.num_agents == model.num_agents
    assert again.discount == model.discount
    np.testing.assert_allclose(again.rewards, model.rewards, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.initial_belief, model.initial_belief, atol=1e-12)
    for action in range(len(model.action_space)):
        difference = dense(model.transition_matrix(action)) - dense(again.transition_matrix(action))
        assert abs(difference).max() <= 1e-12
        if model.kind == "POMDP":
            difference = dense(model.observation_matrix(action)) - dense(again.observation_matrix(action))
            assert abs(difference).max() <= 1e-12
