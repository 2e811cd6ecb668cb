"""MADP's teams: by hand, and against its own numbers."""

from __future__ import annotations

import json
import random
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import load, written
from mutation import mutated
from places import each
from random_models import dense

from mdm import FormatError, load_model
from mdm.errors import ModelWarning
from mdm.models import POMDP


@pytest.mark.foreign(".dpomdp models of MADPToolbox/MADP")
@pytest.mark.parametrize("file", each(["GridSmall", "dectiger", "recycling", "relay4", "broadcastChannel"]))
def test_dec_pomdps_agree_with_madp(corpus, file):
    oracle = json.loads((corpus / "oracles" / f"{file}.dpomdp.json").read_text())
    model = load(corpus / "models" / "madp" / f"{file}.dpomdp")
    assert model.num_agents == oracle["nr_agents"]
    assert [list(factor.names) for factor in model.action_space.factors] == oracle["action_names"]
    assert [list(factor.names) for factor in model.observation_space.factors] == oracle["observation_names"]
    joint = [list(model.action_space.unravel(index)) for index in range(len(oracle["first_joint_actions"]))]
    assert joint == oracle["first_joint_actions"]
    np.testing.assert_allclose(model.rewards, oracle["R_full_s_a"], atol=1e-12)
    for action, (transitions, observations) in enumerate(
        zip(oracle["T_full_a_s_s1"], oracle["O_full_a_s1_o"], strict=True)
    ):
        np.testing.assert_allclose(model.transition_matrix(action), transitions, atol=1e-12)
        np.testing.assert_allclose(model.observation_matrix(action), observations, atol=1e-12)


PIECES = ["T:", "O:", "R:", "*", "#", "\n", " ", "0.9", "-", "1e999", "nan", "+", "uniform", "a"]
TEAM = """agents: 2
discount: 0.9
values: reward
states: left right
start:
uniform
actions:
go stay
2
observations:
hot cold
2
T: * :
identity
T: go * : left : right : 1
T: go * : left : left : 0
O: * :
uniform
O: stay a1 : left : hot o0 : 1
O: stay a1 : left : hot o1 : 0
O: stay a1 : left : cold * : 0
R: * : * : * : * : -1
R: go a0 : left : * : * : 5
R: 3 : right : * : * : 7
"""


def test_a_team_by_hand(tmp_path):
    model = load_model(written(tmp_path, TEAM, "team.dpomdp"))
    assert isinstance(model, POMDP)
    assert model.num_agents == 2
    assert list(model.action_space.names) == ["go a0", "go a1", "stay a0", "stay a1"]
    np.testing.assert_allclose(model.transition_matrix("go a1"), [[0, 1], [0, 1]])
    np.testing.assert_allclose(model.transition_matrix("stay a1"), np.eye(2))
    np.testing.assert_allclose(model.observation_matrix("stay a1"), [[1, 0, 0, 0], [0.25] * 4])
    np.testing.assert_allclose(model.rewards, [[5, -1, -1, -1], [-1, -1, -1, 7]])


def test_sparse_and_dense_are_the_same(tmp_path):
    path = written(tmp_path, TEAM, "team.dpomdp")
    thin, thick = load_model(path, sparse=True), load_model(path, sparse=False)
    assert thin.is_sparse
    for action in range(4):
        np.testing.assert_array_equal(dense(thin.transition_matrix(action)), thick.transition_matrix(action))


@given(seed=st.integers(0, 2**32 - 1))
def test_mutated_files_make_a_model_or_an_error(seed, tmp_path_factory):
    text = mutated(TEAM, random.Random(seed), PIECES)
    path = written(tmp_path_factory.mktemp("mutated"), text, "team.dpomdp")
    try:
        assert isinstance(load(path), POMDP)
    except FormatError as error:
        assert path.name in str(error)


UNREACHED = """agents: 2
discount: 1
values: reward
states: here there never
start:
1 0 0
actions:
2
1
observations:
2
1
T: * : * : there : 1.0
O: * : there :
0.25 0.75
R: * : * : * : * : 1
"""


def test_rows_of_observations_that_are_never_reached_are_uniform(tmp_path):
    """Such files exist in numbers; MADP takes them."""
    path = written(tmp_path, UNREACHED, "x.dpomdp")
    with pytest.warns(ModelWarning, match="4 rows of O are not given, of next states that are never reached") as caught:
        model = load_model(path)
    assert len(caught) == 1
    for action in range(2):
        np.testing.assert_array_equal(model.observation_matrix(action), [[0.5, 0.5], [0.25, 0.75], [0.5, 0.5]])


@pytest.mark.filterwarnings("ignore:.*rows of O are not given")
def test_a_row_that_is_reached_must_be_given(tmp_path):
    path = written(tmp_path, UNREACHED + "T: 1 0 : here : never : .5\nT: 1 0 : here : there : .5\n", "x.dpomdp")
    with pytest.raises(FormatError, match="O of action .*the row of 'never' sums to 0") as caught:
        load_model(path)
    assert caught.value.line == 14  # where the action's O is


@pytest.mark.filterwarnings("ignore:.*rows of O are not given")
def test_a_row_that_was_never_given_is_told_at_its_block(tmp_path):
    rest = UNREACHED.replace("T: * : * : there : 1.0\n", "T: * : here : there : 1.0\nT: * : there : there : 1.0\n")
    with pytest.raises(FormatError, match="T of action .*the row of 'never' sums to 0") as caught:
        load_model(written(tmp_path, rest, "x.dpomdp"))
    assert caught.value.line == 14


DIALECT = """agents: sensor bot
discount: 1
values: reward
states: a b
start:
uniform
actions:
wait go
wait go
observations:
none some
none some
{section}:
2
2
T: * : * : * : 0.5
O: * : * : * : 0.25
R: * : * : * : * : 1
"""


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            "partitionSizes",
            "13: 'partitionSizes:' divides states or observations among agents, in a dialect that is not",
        ),
        ("features", "13: there is no section 'features': agents, discount, values, states"),
        ("observation", "13: there is no section 'observation'; did you mean 'observations'?"),
    ],
)
def test_sections_of_dialects_are_named_with_their_line(tmp_path, section, words):
    (tmp_path / "x.dpomdp").write_text(DIALECT.format(section=section))
    with pytest.raises(FormatError, match=re.escape(words)):
        load(tmp_path / "x.dpomdp")
