"""Alpha vectors, value functions, graphs, planes and tables, each from a small file and with its errors."""

from __future__ import annotations

import pytest
from places import POLICIES
from policy_files import assert_refused, model_of, pairs

from mdm.formats import policies
from mdm.policies import AlphaVectors


def test_alpha_vectors():
    policy = policies.load_policy(POLICIES / "tiger.alpha", model_of())
    assert isinstance(policy, AlphaVectors)
    assert pairs(policy) == [(0, [19.37, 19.37]), (1, [-81.6, 28.4]), (2, [28.4, -81.6])]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0\n1 2\n\n1 2\n3 4\n", 4, "an action's index was expected, not '1 2'"),
        ("0\n1 2\n\n-1\n3 4\n", 4, "not '-1'"),
        ("0\n1 2\n\n1\n", 4, "without its vector"),
        ("0\n1 2\n\n1\n3\n", 5, "2 values were expected, but 1"),
        ("0\n1 x\n", 2, "'x'"),
        ("0\n1 1e999\n", 2, "not finite"),
        ("3\n1 2\n", 1, "no action 3: the model has actions 0 to 2"),
        ("0\n1 2 3\n", None, "for 3 states, but the model has 2"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, line, words):
    assert_refused(tmp_path / "x.alpha", text, line, words)
