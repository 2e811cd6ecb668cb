"""The numbers of a shield: those of `verify` and `evaluate`, before and after."""

import math

import numpy as np
import pytest

import mdm
from mdm.errors import ConfigError
from mdm.models import MDP
from mdm.policies import BudgetedTable
from mdm.verification import Estimate, Exact, effect

MOVES = [
    [[0.0, 0.5, 0.5], [0, 1, 0], [0, 0, 1]],
    [[0.9, 0, 0.1], [0, 1, 0], [0, 0, 1]],
]


def model(discount=0.9):
    return MDP(
        MOVES,
        [[2.0, -1.0], [0, 0], [0, 0]],
        discount=discount,
        states=["hall", "stairs", "dock"],
        actions=["Rush", "Creep"],
        initial_belief=[1, 0, 0],
    )


def test_numbers_of_tables_are_exact():
    safe = mdm.shield([0, 0, 0], model(), avoid="stairs", keep="reach dock")
    its = effect(safe, model())
    assert [each.value for each in its.avoid] == [0.5, 0]
    assert [each.value for each in its.keep] == pytest.approx([0.5, 1])
    assert its.value == pytest.approx((2, -1 / (1 - 0.9 * 0.9)))
    assert its.lost == pytest.approx(its.value[0] - its.value[1])
    assert its.value_error == 0


def test_without_keep_and_with_a_value_that_has_no_bound():
    moves = [MOVES[0], [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]]
    endless = MDP(moves, [[2.0, -1.0], [0, 0], [0, 0]], discount=1, states=["hall", "stairs", "dock"],
                  initial_belief=[1, 0, 0])  # fmt: skip
    its = effect(mdm.shield([1, 0, 0], endless, avoid="stairs"), endless)
    assert (its.keep, its.value, its.lost) == (None, None, None)


def test_a_budget_is_simulated_within_a_time():
    safe = mdm.shield([0, 0, 0], model(), avoid="stairs", keep="reach dock", probability=0.6)
    assert isinstance(safe, BudgetedTable)
    its = effect(safe, model(), seconds=0.0)
    assert isinstance(its.avoid[0], Exact)
    assert isinstance(its.avoid[1], Estimate)
    assert its.avoid[1].episodes < 10_000  # the first part
    its = effect(safe, model(), seconds=math.inf, seed=5)
    assert its.avoid[1].episodes == 10_000
    assert its.avoid[1].lower < 0.5 < its.avoid[1].upper < 0.6
    assert its.value == pytest.approx((2, 2))


def test_the_file_of_a_model_is_taken(tmp_path):
    mdm.save_model(model(), tmp_path / "hall.npz")
    safe = mdm.shield([0, 0, 0], tmp_path / "hall.npz", avoid="stairs")
    assert effect(safe, tmp_path / "hall.npz").avoid[1].value == 0
    assert np.isfinite(effect(safe, model()).value).all()


def test_a_budget_is_not_simulated_where_the_policy_stays_for_ever():
    """Wait stays at the edge for ever, from where Go would still lead to X: the policy never takes it there."""
    moves = [np.eye(3), [[0, 0.5, 0.5], [0, 1, 0], [0, 0, 1]]]
    names = {"states": ["home", "edge", "end"], "actions": ["Wait", "Go"]}
    waits = MDP(moves, [[0, 1], [0, 0], [0, 0]], discount=0.9, initial_belief=[1, 0, 0], **names)
    safe = mdm.shield([1, 0, 0], waits, avoid="edge and action = Go", probability=0.1)
    after = effect(safe, waits).avoid[1]
    assert (after.lower, after.undecided) == (0, 0)


def test_only_a_shield_has_an_effect():
    with pytest.raises(ConfigError, match="the effect is that of a shield, and a RandomPolicy has none"):
        effect(mdm.policies.RandomPolicy(3, 2, input="state"), model())
