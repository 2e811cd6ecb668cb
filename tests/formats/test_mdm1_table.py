"""Tables over states: which kind an array is, and what is said where none fits."""

from __future__ import annotations

import pytest
from loading import written
from policy_files import model_of
from sentences import refused

from mdm import FormatError, load_policy
from mdm.policies import QTable, StochasticPolicy


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("[2](0,1)", "q", "a vector of actions, not kind='q'"),
        ("[2,2]((1,0),(0,1))", "table", "a matrix, not kind='table'"),
        ("[2,2]((0.5,0.5),(0.9,0.9))", None, "say kind='q'"),
    ],
)
def test_a_kind_that_does_not_fit_says_the_way_out(tmp_path, text, kind, words):
    with pytest.raises(FormatError) as caught:
        load_policy(written(tmp_path, text), kind=kind)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sizes", "kind"),
    [
        ("[2,3]((0.5,0,1),(0.5,1,0))", None, StochasticPolicy),
        ("[2,3]((0.5,0,1),(0.5,1,7))", None, QTable),
        ("[2,2]((0.5,0),(0.5,1))", None, StochasticPolicy),
        ("[2,3]((0.5,0,1),(0.5,1,0))", (2, 3), QTable),
        ("[3,2]((0.5,0),(0.5,1),(0,0))", (2, 3), StochasticPolicy),
        ("[3,3]((1,0,0),(0,1,0),(0,0,1))", (3, 3), StochasticPolicy),
        ("[3,3]((1,0,0),(0,1,0),(0,0,2))", (3, 3), QTable),
    ],
)
def test_a_matrix_is_what_the_model_s_sizes_say_and_else_its_numbers(tmp_path, text, sizes, kind):
    model = None if sizes is None else model_of(*sizes)
    assert type(load_policy(written(tmp_path, text), model)) is kind


@pytest.mark.parametrize(("action", "words"), [("3", "but the model has actions 0 to 2"), ("-1", "an index from 0 on")])
def test_an_action_that_is_none_is_told_with_its_state(tmp_path, action, words):
    with refused(FormatError):
        load_policy(written(tmp_path, f"[2](0,{action})"), model_of())
