"""Policy files: uBLAS text and MADP's value functions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from places import CORPUS

from mdm import FormatError, load_policy, load_rewards
from mdm.formats.tables import ublas
from mdm.models import MDP
from mdm.policies import AlphaVectors, DeterministicPolicy, QTable, StochasticPolicy


def write(folder, text, name="x.policy"):
    path = folder / name
    path.write_text(text)
    return path


def printed(array):
    """Print an array as uBLAS does."""
    if array.ndim == 1:
        return f"[{len(array)}]({','.join(map(repr, array.tolist()))})"
    rows = ",".join(f"({','.join(map(repr, row))})" for row in array.tolist())
    return f"[{array.shape[0]},{array.shape[1]}]({rows})"


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(0, 4), st.sampled_from(["", " ", "\n"]))
def test_what_is_printed_is_read(tmp_path_factory, seed, rows, columns, blank):
    random = np.random.default_rng(seed)
    array = random.normal(size=(rows, columns) if columns else rows)
    text = printed(array).replace(",", f"{blank},{blank}").replace("(", f"({blank}").replace("]", f"]{blank}")
    np.testing.assert_array_equal(ublas.read(write(tmp_path_factory.mktemp("u"), text)), array)


@given(st.text(alphabet="[](),0123.-e \n", max_size=30))
def test_any_text_gives_an_array_or_a_format_error(tmp_path_factory, text):
    path = write(tmp_path_factory.mktemp("u"), text)
    try:
        assert ublas.read(path).size > 0
    except FormatError as error:
        assert str(path) in str(error)


def test_kinds_are_told_by_content(tmp_path):
    vector = load_policy(write(tmp_path, "[3](0,2,1)"))
    assert isinstance(vector, DeterministicPolicy)
    assert [vector.action(state) for state in range(3)] == [0, 2, 1]
    stochastic = load_policy(write(tmp_path, "[2,3]((0.25,1,0),(0.75,0,1))"), seed=1)
    assert isinstance(stochastic, StochasticPolicy)
    assert (stochastic.num_actions, stochastic.num_states) == (2, 3)
    table = load_policy(write(tmp_path, "[3,2]((0,5),(1,0),(2,2))"))
    assert isinstance(table, QTable)
    assert [table.action(state) for state in range(3)] == [1, 0, 0]
    assert isinstance(load_policy(write(tmp_path, "[2,2]((1,0),(0,1))"), kind="q"), QTable)
    vectors = load_policy(write(tmp_path, "0 -1\n1 2\n\n1 5\n3 0\n", "v.vf"))
    assert isinstance(vectors, AlphaVectors)
    assert vectors.action(np.array([1.0, 0.0])) == 1


def test_the_original_s_demo_policy(corpus):
    policy = load_policy(corpus / "policies" / "mdm-ISR_demo-MDP_policy")
    assert [policy.action(state) for state in range(12)] == [0, 0, 0, 1, 3, 1, 1, 1, 1, 2, 0, 0]


def test_files_with_quirks(corpus):
    edge = corpus / "edge" / "policy"
    expected = {
        Path(file).name: entry["expect"]
        for file, entry in json.loads((corpus / "edge" / "expected.json").read_text()).items()
        if file.startswith("policy/")
    }
    np.testing.assert_array_equal(load_rewards(edge / "ublas_reward.txt"), expected["ublas_reward.txt"]["R"])
    stochastic = load_policy(edge / "ublas_matrix_stochastic.txt")
    rows = expected["ublas_matrix_stochastic.txt"]["pi_state_action"]
    np.testing.assert_allclose(stochastic.probabilities.T, rows)
    for name in ("ublas_vector.txt", "ublas_vector_spaces.txt", "ublas_vector_trailing_comma.txt"):
        assert isinstance(load_policy(edge / name), DeterministicPolicy)
    for name in ("madp_vf.txt", "madp_vf_beta_no_eol.txt"):
        known = [(action, vector) for action, _, vector in expected[name]["vectors"] if action is not None]
        policy = load_policy(edge / name)
        assert [(a, v.tolist()) for a, v in zip(policy.actions, policy.vectors, strict=True)] == sorted(known)


MODEL = MDP([np.eye(3)] * 2, np.zeros((3, 2)), discount=0.9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[4](0,1,2)", "4 numbers, but 3"),
        ("[3](0,1,2,1)", "3 numbers, but 4"),
        ("[3](0,1", "before the brackets"),
        ("[3(0,1,2)", "size in brackets"),
        ("[2,2,2]((0))", "no size"),
        ("[3](0,-1,2)", "state 1 is -1"),
        ("[3](0,1.5,2)", "state 1 is 1.5"),
        ("[3](0,x,2)", "'x'"),
        ("[3](0,1_0,2)", "'1_0'"),
        ("[3](0,inf,2)", "state 1 is inf"),
        ("[3](0,nan,2)", "state 1 is nan"),
        ("[3](0,1e300,2)", "state 1 is 1e+300"),
        ("[3\n3](0,1,2)", "'[3 3]' is no size"),
        ("0 -1\n1 2 1_0\n", "'1_0'"),
        ("[3](0,1,9)", "state 2 is 9, but the model's 2"),
        ("[2](0,1)", "2 states and 2 actions, but the model has 3 and 2"),
        ("[2,3]((0.5,0.5,0.5),(0.5,0.5,0.9))", "1.4"),
        ("[2,3]((1,2,3),(1,2))", "row 1"),
        ("[1,3]((1,2,3),(1,2,3))", "1 rows, but 2"),
        ("[3](0,1,1) 7", "'7'"),
        ("0 -1\n1 2\n", "2 states"),
        ("0 -1\n1 2 3\n\n7 -1\n1 2 3\n", "no action 7"),
        ("0 -1\n1 2 3\n\n1 -1\n", "its vector is missing"),
        ("0 -1\n1 2 3\n\n1 -1\n1 2\n", "3 values were expected, but 2"),
        ("0 -1\n1 2 nan\n", "not finite"),
        ("0 -1\n1 2 three\n", "'three'"),
        ("hello\nworld\n", "'hello'"),
    ],
)
def test_wrong_policies_are_refused(tmp_path, text, words):
    with pytest.raises(FormatError) as caught:
        load_policy(write(tmp_path, text), MODEL)
    assert words in str(caught.value)
    assert "x.policy" in str(caught.value)


def test_an_index_that_no_array_holds_is_refused(tmp_path):
    for action in ("99999999999", "9" * 100):
        with pytest.raises(FormatError, match="is no action's index"):
            load_policy(write(tmp_path, f"{action} -1\n1 2\n", "v.vf"))
        with pytest.raises(FormatError, match="state 0 is"):
            load_policy(write(tmp_path, f"[1]({action})"))


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("[2](0,1)", "q", "a vector, an action per state, but kind='q'"),
        ("[2,2]((1,0),(0,1))", "table", "a matrix, but kind='table'"),
        ("[2,2]((0.5,0.5),(0.9,0.9))", None, "say kind='q'"),
    ],
)
def test_a_kind_that_does_not_fit_says_the_way_out(tmp_path, text, kind, words):
    with pytest.raises(FormatError) as caught:
        load_policy(write(tmp_path, text), kind=kind)
    assert words in str(caught.value)


@given(st.text(alphabet="[](),0123.-e \ninfa_", max_size=30))
def test_any_text_gives_a_policy_or_a_format_error(tmp_path_factory, text):
    path = write(tmp_path_factory.mktemp("u"), text)
    try:
        assert load_policy(path).num_states > 0
    except FormatError as error:
        assert "\n" not in str(error)


MALFORMED = CORPUS / "malformed"
NAMES = ("*.txt", "negative-action.policy", "unclosed-vector.policy", "count-does-not-match.policy")
BROKEN = sorted({path.name for pattern in NAMES for path in MALFORMED.glob(pattern)} - {"u11_action_out_of_range.txt"})


@pytest.mark.parametrize("name", BROKEN)
def test_the_corpus_of_broken_policies(corpus, name):
    with pytest.raises(FormatError, match=name):
        load_policy(corpus / "malformed" / name)
