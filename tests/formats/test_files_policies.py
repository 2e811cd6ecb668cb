"""Policy files: uBLAS text and MADP's value functions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import written
from places import POLICIES
from random_policies import (
    KINDS,
    alpha,
    assert_same,
    controller,
    deterministic,
    joint,
    masked,
    mixed,
    q_values,
    stochastic,
)
from sentences import refused

from mdm import FormatError, ModelError, load_policy
from mdm.formats import files as policies
from mdm.models import MDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    QTable,
    StochasticPolicy,
)


def test_kinds_are_told_by_content(tmp_path):
    vector = load_policy(written(tmp_path, "[3](0,2,1)"))
    assert isinstance(vector, DeterministicPolicy)
    assert [vector.action(state) for state in range(3)] == [0, 2, 1]
    stochastic = load_policy(written(tmp_path, "[2,3]((0.25,1,0),(0.75,0,1))"), seed=1)
    assert isinstance(stochastic, StochasticPolicy)
    assert (stochastic.num_actions, stochastic.num_states) == (2, 3)
    table = load_policy(written(tmp_path, "[3,2]((0,5),(1,0),(2,2))"))
    assert isinstance(table, QTable)
    assert [table.action(state) for state in range(3)] == [1, 0, 0]
    assert isinstance(load_policy(written(tmp_path, "[2,2]((1,0),(0,1))"), kind="q"), QTable)
    vectors = load_policy(written(tmp_path, "0 -1\n1 2\n\n1 5\n3 0\n", "v.vf"))
    assert isinstance(vectors, AlphaVectors)
    assert vectors.action(np.array([1.0, 0.0])) == 1


@pytest.mark.foreign("ISR_demo-MDP_policy of larsys/markov_decision_making")
def test_the_original_s_demo_policy(corpus):
    policy = load_policy(corpus / "policies" / "mdm-ISR_demo-MDP_policy")
    assert [policy.action(state) for state in range(12)] == [0, 0, 0, 1, 3, 1, 1, 1, 1, 2, 0, 0]


MODEL = MDP([np.eye(3)] * 2, np.zeros((3, 2)), discount=0.9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[4](0,1,2)", "4 numbers are declared, but 3"),
        ("[3](0,1,2,1)", "3 numbers are declared, but 4"),
        ("[3](0,1", "before the brackets"),
        ("[3(0,1,2)", "size in brackets"),
        ("[2,2,2]((0))", "not the size"),
        ("[3](0,-1,2)", "state 1 is -1"),
        ("[3](0,1.5,2)", "state 1 is 1.5"),
        ("[3](0,x,2)", "'x'"),
        ("[3](0,1_0,2)", "'1_0'"),
        ("[3](0,inf,2)", "state 1 is inf"),
        ("[3](0,nan,2)", "state 1 is nan"),
        ("[3](0,1e300,2)", "state 1 is 1e+300"),
        ("[3\n3](0,1,2)", "'[3 3]' is not the size"),
        ("0 -1\n1 2 1_0\n", "'1_0'"),
        ("[3](0,1,9)", "state 2 is 9, but the model has"),
        ("[2](0,1)", "for 2 states, but the model has 3"),
        ("[2,3]((0.5,0.5,0.5),(0.5,0.5,0.9))", "1.4"),
        ("[2,3]((1,2,3),(1,2))", "row 1"),
        ("[1,3]((1,2,3),(1,2,3))", "1 rows are declared, but 2"),
        ("[3](0,1,1) 7", "'7'"),
        ("0 -1\n1 2\n", "2 states"),
        ("0 -1\n1 2 3\n\n7 -1\n1 2 3\n", "no action 7"),
        ("0 -1\n1 2 3\n\n1 -1\n", "without its vector"),
        ("0 -1\n1 2 3\n\n1 -1\n1 2\n", "3 values were expected, but 2"),
        ("0 -1\n1 2 nan\n", "not finite"),
        ("0 -1\n1 2 three\n", "'three'"),
        ("hello\nworld\n", "'hello'"),
    ],
)
def test_wrong_policies_are_refused(tmp_path, text, words):
    with pytest.raises(FormatError) as caught:
        load_policy(written(tmp_path, text), MODEL)
    assert words in str(caught.value)
    assert "x.policy" in str(caught.value)


def test_an_index_that_no_array_holds_is_refused(tmp_path):
    for action in ("99999999999", "9" * 100):
        with refused(FormatError):
            load_policy(written(tmp_path, f"{action} -1\n1 2\n", "v.vf"))
        with refused(FormatError):
            load_policy(written(tmp_path, f"[1]({action})"))


@given(st.text(alphabet="[](),0123.-e \ninfa_", max_size=30))
def test_any_text_gives_a_policy_or_a_format_error(tmp_path_factory, text):
    path = written(tmp_path_factory.mktemp("u"), text)
    try:
        assert load_policy(path).num_states > 0
    except FormatError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("name", ["tiger.alpha", "tiger.pg", "mixed.policy", "masked.policy", "team.policy"])
def test_a_kind_of_table_is_asked_of_tables_only(name):
    with refused(FormatError):
        policies.load_policy(POLICIES / name, kind="q")


POLICY = AlphaVectors([[1, 2], [2, 1]], [0, 1])
SUFFIXES = {
    deterministic: ["policy"],
    stochastic: ["policy"],
    q_values: ["policy"],
    alpha: ["alpha", "vf", "policy"],
    mixed: ["policy"],
    masked: ["policy"],
    controller: ["pg"],
    joint: [],
}


CASES = [(make, suffix) for make in KINDS for suffix in ["npz", *SUFFIXES[make]]]


@pytest.mark.parametrize(("make", "suffix"), CASES)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4))
def test_what_is_written_is_read(tmp_path_factory, make, suffix, seed, count):
    policy = make(np.random.default_rng(seed), count)
    path = tmp_path_factory.mktemp("round") / f"x.{suffix}"
    policies.save_policy(policy, path)
    kind = {deterministic: "table", stochastic: "stochastic", q_values: "q"}.get(make) if suffix == "policy" else None
    again = policies.load_policy(path, kind=kind)
    if make is deterministic and suffix == "policy":
        assert again.actions == policy.actions  # how many actions there are is the model's to say
    elif make is masked and suffix == "policy" and isinstance(again, AlphaVectors):
        assert [dict(enumerate(vector)) for vector in again.vectors.tolist()] == list(policy.vectors)
    else:
        assert_same(again, policy)


@pytest.mark.parametrize("make", KINDS)
def test_the_same_policy_gives_the_same_bytes(tmp_path, make):
    for name in ("a", "b"):
        policies.save_policy(make(np.random.default_rng(3), 3), tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_draws_begin_with_the_seed(tmp_path):
    policies.save_policy(StochasticPolicy([[0.5], [0.5]]), tmp_path / "x.npz")
    first, second = (policies.load_policy(tmp_path / "x.npz", seed=7) for _ in range(2))
    draws = [first.action(0) for _ in range(20)]
    assert draws == [second.action(0) for _ in range(20)]
    assert set(draws) == {0, 1}


def test_an_archive_is_told_by_its_content(tmp_path):
    policies.save_policy(POLICY, tmp_path / "x.npz")
    (tmp_path / "x.policy").write_bytes((tmp_path / "x.npz").read_bytes())
    assert_same(policies.load_policy(tmp_path / "x.policy"), POLICY)


def test_a_kind_of_table_may_be_asked_of_an_archive(tmp_path):
    policies.save_policy(QTable([[1, 0]]), tmp_path / "x.npz")
    assert isinstance(policies.load_policy(tmp_path / "x.npz", kind="q"), QTable)
    with refused(FormatError):
        policies.load_policy(tmp_path / "x.npz", kind="stochastic")


@pytest.mark.parametrize(
    ("policy", "name", "words"),
    [
        (POLICY, "x.pg", "AlphaVectors cannot be written as 'x.pg'"),
        (DeterministicPolicy([0]), "x.alpha", "its files end in .npz, .policy"),
        (QTable([[1, 2]]), "x.vf", "QTable"),
        (FiniteStateController([0], [[0]]), "x.policy", "FiniteStateController"),
        (POLICY, "x.policy.gz", "'x.policy.gz'"),
        (POLICY, "x.pomdp", "its files end in .npz, .policy, .policyx, .alpha, .vf"),
        (POLICY, "x.png", "'x.png'"),
        (FiniteStateController([0], [[0]]), "x", "its files end in .npz, .pg"),
    ],
)
def test_a_form_that_cannot_hold_a_policy_is_refused(tmp_path, policy, name, words):
    with pytest.raises(ModelError) as caught:
        policies.save_policy(policy, tmp_path / name)
    assert words in str(caught.value)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["x.npz", "x.policy"])
def test_where_nothing_can_be_written_is_said(tmp_path, name):
    with refused(FormatError):
        policies.save_policy(POLICY, tmp_path / "none" / name)
