"""`mdm compare`: policies side by side, in the same luck."""

from __future__ import annotations

import numpy as np
import pytest
from places import TIGER, TIGER_VECTORS

from mdm import load_model, load_policy, save_policy
from mdm.policies import AlphaVectors, FiniteStateController


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
