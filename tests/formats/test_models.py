"""Model files: the corpus, quirks, wrong input, mutated input."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import load
from places import CORPUS, each
from random_models import dense

from mdm import FormatError, load_model
from mdm.models import MDP, POMDP

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
    expected = MALFORMED[file]
    with pytest.raises(FormatError) as caught:
        load(corpus / "malformed" / file)
    assert file in str(caught.value)
    if expected["line"] is not None:
        assert caught.value.line == expected["line"]
    for words in expected["message_mentions"]:
        assert words in str(caught.value)


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


def write(folder, text, name="small.pomdp"):
    path = folder / name
    path.write_text(text)
    return path


def test_a_pomdp_by_hand(tmp_path):
    model = load_model(write(tmp_path, SMALL))
    assert isinstance(model, POMDP)
    np.testing.assert_allclose(model.transition_matrix("swap"), [[0, 1], [1, 0]])
    np.testing.assert_allclose(model.observation_matrix("stay"), [[0.8, 0.2], [0.5, 0.5]])
    # the last statement that covers an entry counts: 10 where right is bright, which has probability a half
    np.testing.assert_allclose(model.rewards, [[-1, (10 - 1) / 2], [-1, -1]])
    np.testing.assert_allclose(model.initial_belief, [0.25, 0.75])


def test_a_team_by_hand(tmp_path):
    model = load_model(write(tmp_path, TEAM, "team.dpomdp"))
    assert isinstance(model, POMDP)
    assert model.num_agents == 2
    assert list(model.action_space.names) == ["go a0", "go a1", "stay a0", "stay a1"]
    np.testing.assert_allclose(model.transition_matrix("go a1"), [[0, 1], [0, 1]])
    np.testing.assert_allclose(model.transition_matrix("stay a1"), np.eye(2))
    np.testing.assert_allclose(model.observation_matrix("stay a1"), [[1, 0, 0, 0], [0.25] * 4])
    np.testing.assert_allclose(model.rewards, [[5, -1, -1, -1], [-1, -1, -1, 7]])


def test_an_mdp_and_costs(tmp_path):
    text = "discount: 1\nvalues: cost\nstates: 2\nactions: 1\nT: 0 uniform\nR: 0 : 0\n1 3\nR: 0 : 1 : * 2\n"
    model = load_model(write(tmp_path, text, "small.mdp"))
    assert type(model) is MDP
    np.testing.assert_allclose(model.rewards, [[-2], [-2]])
    assert model.state_space.index("s1") == model.state_space.index("1") == 1


def test_a_compressed_file_is_the_same(tmp_path):
    plain = load_model(write(tmp_path, SMALL))
    path = tmp_path / "small.pomdp.gz"
    path.write_bytes(gzip.compress(SMALL.encode()))
    np.testing.assert_array_equal(load_model(path).rewards, plain.rewards)


def test_sparse_and_dense_are_the_same(tmp_path):
    path = write(tmp_path, TEAM, "team.dpomdp")
    thin, thick = load_model(path, sparse=True), load_model(path, sparse=False)
    assert thin.is_sparse
    for action in range(4):
        np.testing.assert_array_equal(dense(thin.transition_matrix(action)), thick.transition_matrix(action))


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
        ("states: left right", "states: left left", 3, "'left' is named twice"),
    ],
)
def test_errors_name_place_and_culprit(tmp_path, old, new, line, words):
    assert old in SMALL
    with pytest.raises(FormatError) as caught:
        load_model(write(tmp_path, SMALL.replace(old, new)))
    if words == "colon":
        assert caught.value.line == 2
        assert "'values'" in str(caught.value)
    else:
        assert words in str(caught.value)
        assert line is None or caught.value.line == line


def test_all_wrong_statements_are_told_at_once(tmp_path):
    text = SMALL.replace("R: swap : left", "R: swop : left").replace("O: * uniform", "O: * unform")
    with pytest.raises(FormatError) as caught:
        load_model(write(tmp_path, text))
    assert "unform" in str(caught.value)
    assert "line 14" in str(caught.value)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), "folder"),
        (lambda path: path.write_bytes(b""), "empty"),
        (lambda path: path.write_bytes(b"\0\1\2"), "binary"),
        (lambda path: path.write_bytes(b"# nothing\n"), "empty"),
        (lambda path: path.write_bytes(gzip.compress(SMALL.encode())[:40]), "cut off"),
    ],
)
def test_what_is_no_model_file(tmp_path, make, words):
    path = tmp_path / "model.pomdp"
    make(path)
    with pytest.raises(FormatError, match=words):
        load_model(path)


@given(st.data())
def test_mutated_files_give_a_model_or_a_format_error(tmp_path_factory, data):
    team = data.draw(st.booleans())
    words = (TEAM if team else SMALL).split(" ")
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(words) - 1))
        mutation = data.draw(st.sampled_from(["drop", "double", "swap", "junk"]))
        if mutation == "drop" and len(words) > 1:
            del words[at]
        elif mutation == "double":
            words.insert(at, words[at])
        elif mutation == "swap":
            other = data.draw(st.integers(0, len(words) - 1))
            words[at], words[other] = words[other], words[at]
        else:
            words[at] = data.draw(st.text(alphabet="TOR:*#\n 0.9-e+inauforms", max_size=8))
    path = tmp_path_factory.mktemp("fuzz") / ("team.dpomdp" if team else "small.pomdp")
    path.write_text(" ".join(words))
    try:
        assert isinstance(load(path), MDP)
    except FormatError as error:
        assert path.name in str(error)


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
