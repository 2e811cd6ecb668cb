"""`mdm compare`: policies side by side, in the same luck."""

from __future__ import annotations

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

from mdm import load_model, load_policy, save_model, save_policy
from mdm.models import MDP
from mdm.policies import AlphaVectors, DeterministicPolicy, FiniteStateController


def test_policies_meet_the_same_luck(mdm, tmp_path, facts, shifted):
    graph = tmp_path / "listen.npz"
    save_policy(FiniteStateController([0], [[0, 0]], 3), graph)
    arguments = ("compare", TIGER, TIGER_VECTORS, shifted(1), graph, "--episodes", "400", "--seed", "5")
    rows = facts(*arguments)
    assert [row["difference"] for row in rows[:2]] == [0, 0]
    assert rows[1]["claim"] == pytest.approx(rows[0]["claim"] + 1)
    assert rows[2]["exact"] == pytest.approx(-20)
    assert rows[2]["difference"] == pytest.approx(rows[2]["mean"] - rows[0]["mean"])
    assert rows[2]["mean"] == pytest.approx(-20, abs=1e-3)
    status, output, _ = mdm(*arguments)
    assert status == 0
    assert output[0].split() == ["policy", "claimed", "exact", "simulated", "difference"]
    assert [line.split()[0] for line in output[1:4]] == [str(path) for path in arguments[2:5]]
    assert "seed 5" in output[-1]
    assert "seed" in mdm("compare", TIGER, TIGER_VECTORS, "--episodes", "2")[1][-1]


def test_common_numbers_make_differences_sharp(tmp_path, facts):
    """Two policies that part only where beliefs are nearly sure differ far less than their own errors."""
    model = load_model(TIGER)
    policy = load_policy(TIGER_VECTORS, model)
    vectors = policy.vectors + np.array([[0.3 if action == 1 else 0.0] for action in policy.actions])
    save_policy(AlphaVectors(vectors, policy.actions), tmp_path / "other.npz")
    rows = facts("compare", TIGER, TIGER_VECTORS, tmp_path / "other.npz", "--seed", "1", "--episodes", "2000")
    assert rows[1]["difference_within"] <= 2 * rows[1]["standard_error"]


def test_what_records_leave_open_is_told_of_an_estimated_model(mdm, tmp_path, facts):
    """One action was tried 400 times, the other never: the difference is exact in the model, open by its records."""
    row = np.array([[0.5, 0.5], [0, 1]])
    model = MDP([row, row], [[1, 1], [0, 0]], discount=0.9, initial_belief=[1, 0])
    model.visits = np.array([[400.0, 0], [0, 0]])
    paths = [str(tmp_path / name) for name in ("model.npz", "tried.npz", "untried.npz")]
    save_model(model, paths[0])
    for action in (0, 1):
        save_policy(DeterministicPolicy([action, 0], 2), paths[1 + action])
    tried, untried = facts("compare", *paths, "--episodes", "10", "--seed", "1")
    exact = 1 / (1 - 0.9 * 0.5)
    assert tried["exact"] == untried["exact"] == pytest.approx(exact)
    low, high = tried["possible"]
    assert exact - 0.25 < low < exact < high < exact + 0.25
    low, high = untried["possible"]  # stays with a chance of Beta(1/2, 1/2), between 0.0015 and 0.9985
    assert 1 <= low < 1.1
    assert 9 < high <= 10
    assert tried["difference_possible"] == [0, 0]
    assert untried["difference_possible"][0] < -0.5 < 5 < untried["difference_possible"][1]
    output = mdm("compare", *paths, "--episodes", "10", "--seed", "1")[1]
    assert [line.split(" by the model's records: ")[0] for line in output[3:5]] == paths[1:]
    assert "difference" not in output[3]
    assert ", difference -" in output[4]
    (told,) = [line for line in mdm("evaluate", *paths[:2])[1] if line.startswith("by its records")]
    assert told.endswith("in 95 % of the models that they leave possible")


def test_without_a_discount_records_are_not_asked(tmp_path, facts):
    """A model that they leave possible may never come to rest."""
    model = MDP([[[0.5, 0.5], [0, 1]]], [[-1], [0]], discount=1, initial_belief=[1, 0])
    model.visits = np.zeros((2, 1))
    save_model(model, tmp_path / "model.npz")
    save_policy(DeterministicPolicy([0, 0], 1), tmp_path / "policy.npz")
    row = facts("evaluate", tmp_path / "model.npz", tmp_path / "policy.npz")
    assert row["exact"] == pytest.approx(-2)
    assert "possible" not in row
