"""Shielded policies as policies: decisions, scores, snapshots, files."""

import numpy as np
import pytest

import mdm
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.policies import (
    BudgetedTable,
    DeterministicPolicy,
    QTable,
    RandomPolicy,
    ShieldedTable,
    StagedPolicy,
    StochasticPolicy,
)

MODEL = MDP(
    [
        [[0.5, 0.5, 0], [0, 1, 0], [0, 0, 1]],
        [[0.9, 0, 0.1], [0, 1, 0], [0, 0, 1]],
        [[0.0, 0, 1.0], [0, 1, 0], [0, 0, 1]],
    ],
    [[2.0, -3.0, 1.0], [0, 0, 0], [0, 0, 0]],
    discount=0.9,
    states=["hall", "stairs", "dock"],
    actions=["Rush", "Wait", "Go"],
    initial_belief=[1, 0, 0],
)
ORIGINALS = [
    DeterministicPolicy([0, 1, 2], 3),
    QTable([[3.0, 1.0, 2.0], [0, 0, 0], [0, 0, 1]]),
    StochasticPolicy([[0.5, 1, 1], [0.2, 0, 0], [0.3, 0, 0]], seed=3),
    StagedPolicy([[[3.0, 2.0, 1.0], [0, 0, 0], [0, 0, 0]], [[3.0, 1.0, 2.0], [0, 0, 0], [0, 0, 0]]]),
]


@pytest.mark.parametrize("original", ORIGINALS, ids=lambda each: each.kind)
@pytest.mark.parametrize("probability", [0.0, 0.3])
def test_files_keep_a_shielded_policy(original, probability, tmp_path):
    safe = mdm.shield(original, MODEL, avoid="stairs", keep="reach dock", probability=probability)
    mdm.save_policy(safe, tmp_path / "safe.npz", MODEL)
    read = mdm.load_policy(tmp_path / "safe.npz", MODEL, seed=3)
    assert type(read) is type(safe)
    assert (read.avoid, read.keep, read.probability) == ("stairs", "reach dock", probability)
    assert type(read.policy) is type(original)
    assert read.facts() == safe.facts()
    one, two = (mdm.Controller(each, MODEL, seed=3 if hasattr(original, "seed") else None) for each in (safe, read))
    for state in [0, 0, 1, 2] * 5:
        assert one.see(state) == two.see(state)


def test_a_shielded_policy_from_a_file_takes_names_and_says_what_it_avoids(tmp_path):
    mdm.save_policy(mdm.shield(ORIGINALS[0], MODEL, avoid="stairs"), tmp_path / "safe.npz", MODEL)
    read = mdm.load_policy(tmp_path / "safe.npz", MODEL)
    assert (read.action("hall"), read.wanted("hall")) == (read.action(0), 0)
    assert repr(read) == "<ShieldedTable of <DeterministicPolicy: 3 states, 3 actions>: avoids stairs>"


def test_other_formats_refuse_it(tmp_path):
    safe = mdm.shield([0, 1, 2], MODEL, avoid="stairs")
    with pytest.raises(ModelError, match=r"ShieldedTable cannot be written as 'safe.policy': its files end in .npz"):
        mdm.save_policy(safe, tmp_path / "safe.policy")
    own = mdm.shield(RandomPolicy(3, 3, input="state"), MODEL, avoid="stairs")
    with pytest.raises(ModelError, match="ShieldedTable policies cannot be written"):
        mdm.save_policy(own, tmp_path / "safe.npz")


def test_it_tells_what_the_original_wanted():
    safe = mdm.shield([0, 1, 2], MODEL, avoid="stairs")
    assert (safe.action(0), safe.wanted(0), safe.wanted(2)) == (2, 0, None)
    assert safe.table == [2, 1, 2]
    assert safe.allowed(0).tolist() == [False, True, True]
    safe = mdm.shield(ORIGINALS[1], MODEL, avoid="stairs")
    assert safe.scores(0).numbers.tolist() == [-np.inf, 1, 2]
    assert safe.mismatch(mdm.problems.tiger()) is not None


def test_draws_of_forbidden_actions_become_the_most_probable_allowed_one():
    safe = mdm.shield(ORIGINALS[2], MODEL, avoid="stairs")
    assert safe.weights()[:, 0].tolist() == pytest.approx([0, 0.2, 0.8])
    assert safe.scores(0).numbers.tolist() == pytest.approx([0, 0.2, 0.8])
    seeds = [[mdm.Controller(safe, MODEL, seed=seed).see(0).action for _ in range(2)] for seed in range(40)]
    assert {action for pair in seeds for action in pair} == {1, 2}
    assert all(one == two for one, two in seeds)
    share = np.mean([mdm.Controller(safe, MODEL, seed=seed).see(0).action == 2 for seed in range(400)])
    assert 0.7 < share < 0.9


def test_a_budget_is_spent_saved_and_restored():
    safe = mdm.shield([0, 1, 2], MODEL, avoid="stairs", probability=0.6)
    controller = mdm.Controller(safe, MODEL)
    assert controller.see("hall").action_name == "Rush"
    assert controller.information.current.budget == pytest.approx(0.6)
    assert controller.see("hall").action_name == "Go"
    assert controller.information.current.budget == pytest.approx(0.2)
    kept = controller.snapshot()
    other = mdm.Controller(safe, MODEL)
    other.restore(kept)
    assert other.information.current == controller.information.current
    assert other.see("hall") == controller.see("hall")
    with pytest.raises(ModelError, match="no budget"):
        other.information.restore([0, 7.0])
    assert safe.wanted(controller.information.current) == 0
    assert isinstance(safe, BudgetedTable)
    assert not isinstance(safe, ShieldedTable)


@pytest.mark.parametrize("original", ORIGINALS, ids=lambda each: each.kind)
@pytest.mark.parametrize("keep", [None, "reach dock"])
def test_a_batch_decides_as_single_episodes(original, keep):
    """Of deterministic policies the same budgets and actions; of the one that draws, with the same numbers."""
    safe = mdm.shield(original, MODEL, avoid="stairs", keep=keep, probability=0.3)
    runs = np.random.default_rng(2).integers(0, 3, size=(20, 2))
    numbers = np.random.default_rng(3).random((2, 20))
    batch = safe.batch(MODEL)
    zeros = np.zeros(20, dtype=int)
    first = batch.begin(zeros, numbers[0])
    batch.keep(np.arange(20) >= 5)
    second = batch.next(np.arange(15), runs[5:, 0], first[5:], zeros[5:], numbers[1, 5:])
    for place in range(15):
        information = safe.information(MODEL)
        for step, state in enumerate((0, int(runs[5 + place, 0]))):
            information.update(None if step == 0 else int(first[5 + place]), state)
            if hasattr(information._inner, "_number"):
                information._inner._number = numbers[step, 5 + place]
            assert safe.action(information.current) == (first, second[-15:])[step][place + (5 if step == 0 else 0)]
