"""Value functions of alpha vectors as MADP writes them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from places import POLICIES
from policy_files import assert_refused, model_of, pairs
from random_policies import alpha, assert_same

from mdm.formats import policies
from mdm.formats.vectors import value_function


def test_a_value_function_may_name_no_action_and_end_without_a_line_end():
    policy = policies.load_policy(POLICIES / "tiger.vf", model_of())
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
