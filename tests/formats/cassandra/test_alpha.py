"""Alpha vectors, value functions, graphs, planes and tables, each from a small file and with its errors."""

from __future__ import annotations

import numpy as np
import pytest
from places import POLICIES
from policy_files import assert_refused, model_of, pairs

from mdm import ConfigError, Controller, FormatError
from mdm.errors import ModelError
from mdm.formats import files as policies
from mdm.models import POMDP
from mdm.policies import AlphaVectors


def test_alpha_vectors():
    policy = policies.load_policy(POLICIES / "tiger.alpha", model_of())
    assert isinstance(policy, AlphaVectors)
    assert pairs(policy) == [(0, [19.37, 19.37]), (1, [-81.6, 28.4]), (2, [28.4, -81.6])]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("0\n1 2\n\n1 2\n3 4\n", 4, "an action's index or name was expected, not '1 2'"),
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


NAMED = """# opens where it is sure
open-left  # the door
-99 1

listen
0 0
open-right
1 -99
"""
ACTIONS = ["listen", "open-left", "open-right"]


def doors(actions=ACTIONS):
    """Return a model whose actions have names."""
    blind = [np.full((2, 1), 1.0)] * len(actions)
    return POMDP([np.eye(2)] * len(actions), blind, np.zeros((2, len(actions))), discount=0.9, actions=actions)


def test_comments_and_names_of_actions(tmp_path):
    path = tmp_path / "named.alpha"
    path.write_text(NAMED)
    assert pairs(policies.load_policy(path, doors())) == [(0, [0, 0]), (1, [-99, 1]), (2, [1, -99])]
    assert pairs(policies.load_policy(path, doors(ACTIONS[::-1]))) == [(0, [1, -99]), (1, [-99, 1]), (2, [0, 0])]
    with pytest.raises(FormatError, match=r"named.alpha:5: .*'listen'"):
        policies.load_policy(path, doors(["hear", *ACTIONS[1:]]))


def test_names_without_the_model_count_in_their_order_and_decide_nothing(tmp_path):
    path = tmp_path / "named.alpha"
    path.write_text(NAMED)
    policy = policies.load_policy(path)
    assert isinstance(policy, AlphaVectors)
    assert (policy.named, policy.actions) == (("open-left", "listen", "open-right"), [0, 1, 2])
    with pytest.raises(ConfigError, match="its file names actions .*: load it with the model"):
        Controller(policy, doors())
    with pytest.raises(ModelError, match="the policy's file names its actions"):
        policies.save_policy(policy, tmp_path / "x.npz")


@pytest.mark.foreign("small inputs after public reports")
def test_reported_vectors_with_names(corpus):
    policy = policies.load_policy(corpus / "reported" / "named.alpha", doors())
    assert pairs(policy) == [(0, [0, 0]), (1, [-99, 1]), (2, [1, -99])]
