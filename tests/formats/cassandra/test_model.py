"""Cassandra's models: by hand, with names that are keywords, and wrong in every way."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import load, written
from mutation import mutated

from mdm import FormatError, load_model
from mdm.models import MDP, POMDP

PIECES = ["T:", "O:", "R:", "*", "#", "\n", " ", "0.9", "-", "1e999", "nan", "+", "uniform", "a"]
SMALL = """discount: 0.9
values: reward
states: left right
actions: stay swap
observations: dark bright
start: 0.25 0.75
T: stay identity
T: swap
0 1
1 0
O: * uniform
O: stay : left 0.8 0.2
R: * : * : * : * -1
R: swap : left : right : bright 10
"""


def test_a_pomdp_by_hand(tmp_path):
    model = load_model(written(tmp_path, SMALL, "small.pomdp"))
    assert isinstance(model, POMDP)
    np.testing.assert_allclose(model.transition_matrix("swap"), [[0, 1], [1, 0]])
    np.testing.assert_allclose(model.observation_matrix("stay"), [[0.8, 0.2], [0.5, 0.5]])
    # the last statement that covers an entry counts: 10 where right is bright, which has probability a half
    np.testing.assert_allclose(model.rewards, [[-1, (10 - 1) / 2], [-1, -1]])
    np.testing.assert_allclose(model.initial_belief, [0.25, 0.75])


def test_an_mdp_and_costs(tmp_path):
    text = "discount: 1\nvalues: cost\nstates: 2\nactions: 1\nT: 0 uniform\nR: 0 : 0\n1 3\nR: 0 : 1 : * 2\n"
    model = load_model(written(tmp_path, text, "small.mdp"))
    assert type(model) is MDP
    np.testing.assert_allclose(model.rewards, [[-2], [-2]])
    assert model.state_space.index("s1") == model.state_space.index("1") == 1


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("T: swap\n0 1\n1 0", "T: swap\n0 1\n1", 10, "4 numbers (2 x 2)"),
        ("R: swap : left", "R: swop : left", 14, "'swop'"),
        ("discount: 0.9", "discount: 1.9", 1, "1.9"),
        ("start: 0.25 0.75", "start: 0.25 0.25 0.5", 6, "2 numbers"),
        ("0.8 0.2", "0.8 0.3", None, "sums to 1.1"),
        ("T: stay identity\n", "", None, "no 'T' statement is given for action 'stay'"),
        ("values: reward", "values reward", 1, "colon"),
        ("values: reward", "values: reward start uniform", 2, "a ':' was expected after 'start'"),
        ("states: left right", "states: left left", 3, "'left' is named twice"),
    ],
)
def test_errors_name_place_and_culprit(tmp_path, old, new, line, words):
    assert old in SMALL
    with pytest.raises(FormatError) as caught:
        load_model(written(tmp_path, SMALL.replace(old, new), "small.pomdp"))
    if words == "colon":
        assert caught.value.line == 2
        assert "'values'" in str(caught.value)
    else:
        assert words in str(caught.value)
        assert line is None or caught.value.line == line


def test_all_wrong_statements_are_told_at_once(tmp_path):
    text = SMALL.replace("R: swap : left", "R: swop : left").replace("O: * uniform", "O: * unform")
    with pytest.raises(FormatError) as caught:
        load_model(written(tmp_path, text, "small.pomdp"))
    assert "unform" in str(caught.value)
    assert "line 14" in str(caught.value)


def test_keywords_may_be_names(tmp_path):
    path = tmp_path / "names.pomdp"
    path.write_text(
        "discount: 0.9\nvalues: reward\nstates: T O\nactions: R\nobservations: start\n"
        "T: R : T : O 1\nT: R : O : T 1\nO: R\n1\n1\nR: R : T : * : * 5\n"
    )
    model = load(path)
    assert (model.state_space.names, model.observation_space.names) == (("T", "O"), ("start",))
    assert model.transition("R", "T", "O") == 1
    assert model.reward("R", "T") == 5


@given(seed=st.integers(0, 2**32 - 1))
def test_mutated_files_make_a_model_or_an_error(seed, tmp_path_factory):
    text = mutated(SMALL, random.Random(seed), PIECES)
    path = written(tmp_path_factory.mktemp("mutated"), text, "small.pomdp")
    try:
        assert isinstance(load(path), MDP)
    except FormatError as error:
        assert path.name in str(error)
