"""Value functions of alpha vectors as MADP writes them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import written
from places import POLICIES, TIGER_VECTORS
from policy_files import assert_refused, model_of, pairs
from random_policies import alpha, assert_same

from mdm import FormatError
from mdm.formats import files as policies
from mdm.formats.madp import value_function


def test_a_value_function_may_name_no_action_and_end_without_a_line_end():
    """Under a name of its own: a .vf that ends within a line was cut off."""
    policy = policies.load_policy(POLICIES / "tiger_vectors.txt", model_of())
    assert pairs(policy) == [(0, [19.37, 19.37]), (2, [28.4, -81.6])]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0 -1\n1 2\n\n3 -1\n1 2\n", 4, "no action 3"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    assert_refused(tmp_path / "x.vf", text, line, words)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_what_is_written_is_read(tmp_path_factory, seed, count):
    policy = alpha(np.random.default_rng(seed), count)
    path = tmp_path_factory.mktemp("round") / "x.vf"
    value_function.write(policy, path)
    assert_same(value_function.read(path, num_actions=policy.num_actions), policy)


def test_a_file_that_was_cut_off_is_refused(tmp_path):
    """But for one that lacks whole blocks: nothing in the format tells their number."""
    whole = TIGER_VECTORS.read_text()
    taken = []
    for length in range(1, len(whole)):
        path = written(tmp_path, whole[:length], "cut.vf")
        try:
            value_function.read(path)
        except FormatError:
            continue
        taken.append(length)
    ends = {at + 1 for at in range(len(whole)) if whole[at] == "\n"}
    assert set(taken) <= ends
