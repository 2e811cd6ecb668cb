"""What tests draw: the history of a solver, and a small grid with a policy."""

from __future__ import annotations

import json

import numpy as np

from mdm import save_model, save_policy
from mdm.models import MDP, Factor, Space
from mdm.policies import DeterministicPolicy


def history(path, *, solver="some"):
    """Write the history of a solver whose bounds close; return the file."""
    entries = [{"seconds": 0.1 * (i + 1), "lower": -1 / (i + 1), "upper": None if i == 0 else 1 / i} for i in range(9)]
    path.write_text(json.dumps({"solver": solver, "history": entries}))
    return path


def grid(folder):
    """Write a model of 3 rows, a door and 4 columns, and a policy for it; return both."""
    random = np.random.default_rng(1)
    space = Space([Factor("row", 3), Factor("door", ["open", "shut"]), Factor("column", 4)])
    model = MDP(
        random.dirichlet(np.ones(24), size=(2, 24)),
        random.normal(size=(24, 2)),
        discount=0.9,
        states=space,
        initial_belief=np.eye(24)[4],
    )
    policy = DeterministicPolicy(random.integers(2, size=24), 2)
    save_model(model, folder / "grid.npz")
    save_policy(policy, folder / "policy.npz", model)
    return model, policy
