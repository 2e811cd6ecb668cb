"""What may be given for a model or a policy."""

from __future__ import annotations

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

import mdm
from mdm import ConfigError, FormatError, ModelError
from mdm.loading import model_of, policy_of
from mdm.policies import AlphaVectors, DeterministicPolicy, QTable
from mdm.problems import tiger


def test_a_model_or_its_path():
    model = tiger()
    assert model_of(model) is model
    for path in (TIGER, str(TIGER)):
        assert len(model_of(path).state_space) == 2


@pytest.mark.parametrize("given", [None, 7, [[1.0]], AlphaVectors([[1.0]], [0])])
def test_what_is_no_model_is_told(given):
    with pytest.raises(ConfigError, match="a model is an MDP or POMDP, or the path of a file, not ") as caught:
        model_of(given)
    assert caught.value.key == "model"


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (TIGER_VECTORS, AlphaVectors),
        ([1, 0], DeterministicPolicy),
        ((1, 0), DeterministicPolicy),
        (np.array([1, 0]), DeterministicPolicy),
        ([[0.0, 1], [2, 3]], QTable),
        (np.zeros((2, 3)), QTable),
        (np.zeros((2, 3), dtype=int), QTable),
    ],
)
def test_a_policy_its_path_or_its_numbers(given, kind):
    assert type(policy_of(given)) is kind


def test_a_policy_is_itself_and_a_table_has_its_model_s_actions():
    vectors = AlphaVectors([[1.0, 2]], [0], 3)
    assert policy_of(vectors) is vectors
    assert policy_of([1, 0], tiger()).num_actions == 3
    with pytest.raises(FormatError):
        policy_of(TIGER)


class OnlyActs:
    num_actions = 2

    def action(self, x):
        return 0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "not None"),
        (0.5, "not 0.5"),
        ([], "an array of values, states x actions, not"),
        ([0.5, 1.0], "not \\[0.5, 1.0\\]"),
        ([[1, 2], [3]], "not \\[\\[1, 2\\], \\[3\\]\\]"),
        (AlphaVectors, "the class AlphaVectors"),
        (OnlyActs(), "the policy OnlyActs has no information: derive it from StatePolicy or BeliefPolicy"),
        (list("x" * 100), "\\.\\.\\.$"),
    ],
)
def test_what_is_no_policy_is_told(given, words):
    with pytest.raises(ConfigError, match=words) as caught:
        policy_of(given)
    assert caught.value.key == "policy"


def test_numbers_that_are_no_table_are_refused():
    with pytest.raises(ModelError):
        policy_of([0, -1])


def test_the_solution_of_a_solver_stands_for_its_policy():
    solution = mdm.solve(tiger(), gap=1.0)
    assert policy_of(solution) is solution.policy
