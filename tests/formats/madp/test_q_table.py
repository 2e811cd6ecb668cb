"""Q-tables of plain rows, and what tells them from other columns of numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import written
from places import POLICIES
from policy_files import assert_refused
from random_policies import q_values
from sentences import refused

from mdm import FormatError
from mdm.formats import files as policies
from mdm.formats.madp import q_table
from mdm.models import MDP
from mdm.policies import (
    AlphaVectors,
    QTable,
)


def test_a_q_table_of_plain_rows():
    policy = policies.load_policy(POLICIES / "q_table.txt")
    assert isinstance(policy, QTable)
    assert policy.values.tolist() == [[0, 1.5, -2], [3, 0.5, 1]]


def test_two_columns_without_blank_lines_are_a_table(tmp_path):
    (tmp_path / "q").write_text("0 1\n2 3\n4 5\n")
    assert policies.load_policy(tmp_path / "q").values.tolist() == [[0, 1], [2, 3], [4, 5]]
    (tmp_path / "q").write_text("0 -1\n2 3\n")
    assert isinstance(policies.load_policy(tmp_path / "q"), AlphaVectors)
    assert policies.load_policy(tmp_path / "q", kind="q").values.tolist() == [[0, -1], [2, 3]]


def test_a_kind_that_plain_rows_are_not(tmp_path):
    with refused(FormatError):
        policies.load_policy(POLICIES / "q_table.txt", kind="table")


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0 1 2\n0 1 x\n", 2, "'x'"),
        ("0 1 2\n0 1\n", 2, "3 values were expected, but 2"),
        ("0 1 2\n0 1 nan\n", None, "action 2 in state 1 is NaN"),
        ("0 1 2\n", None, "for 1 states, but the model has"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    assert_refused(tmp_path / "q.txt", text, line, words)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_what_is_written_is_read(tmp_path_factory, seed, count):
    table = q_values(np.random.default_rng(seed), count)
    path = tmp_path_factory.mktemp("round") / "q"
    q_table.write(table, path)
    np.testing.assert_array_equal(q_table.read(path), table.values)


LINES = "2 1.5 2.5 0\n0 3.25 4 0\n1 0 0.5 0\n2 3 4 5\n"


def test_alpha_vectors_in_lines_are_no_table(tmp_path):
    """Whatever the model: their content tells them, so that all verbs agree."""
    path = written(tmp_path, LINES, "out.policy")
    policy = policies.load_policy(path)
    assert (policy.form, policy.num_states, policy.num_actions) == ("alpha vectors", 3, 3)
    assert policy.actions == [0, 1, 2, 2]
    assert policy.vectors.tolist() == [[3.25, 4, 0], [0, 0.5, 0], [1.5, 2.5, 0], [3, 4, 5]]
    fitting = MDP([np.eye(3)] * 3, np.zeros((3, 3)), discount=0.9)
    assert policies.load_policy(path, fitting).form == "alpha vectors"
    square = MDP([np.eye(4)] * 4, np.zeros((4, 4)), discount=0.9)
    with refused(FormatError):
        policies.load_policy(path, square)
    assert policies.load_policy(path, square, kind="q").values[3].tolist() == [2, 3, 4, 5]


@pytest.mark.parametrize(
    "text",
    [
        "0 1.5 2\n0 2.5 3\n",
        "0 1 2\n1 2 3\n",
        "0 1.5 2\n1.0 2.5 3\n",
        "0 1.5\n1 2.5\n2 3.5\n",
        "1 2 3\n0 1 2\n5 4 1.5\n",
    ],
)
def test_other_lines_of_numbers_are_a_table(tmp_path, text):
    assert policies.load_policy(written(tmp_path, text, "q.txt")).form == "values of actions per state"


@pytest.mark.foreign("small inputs after public reports")
def test_reported_vectors_in_lines(corpus):
    policy = policies.load_policy(corpus / "reported" / "lines.policy")
    assert (policy.form, policy.num_states, policy.actions) == ("alpha vectors", 4, [0, 0, 1, 1, 2])
