"""What would make decisions faster."""

from __future__ import annotations

import sys

import numpy as np

import mdm
from mdm.latency.faster import faster


def test_hints_name_what_is_absent_and_matrices_of_the_wrong_kind(monkeypatch):
    def named(model):
        ensemble = mdm.Ensemble("robot", policy=[0] * len(model.state_space), model=model, actions={0: print})
        return " ".join(faster([ensemble]))

    few, many = np.eye(3)[None], np.eye(1100)[None]
    assert "matrices" not in named(mdm.MDP(few, np.zeros((3, 1)), discount=0.9))
    assert "matrices" not in named(mdm.MDP(many, np.zeros((1100, 1)), discount=0.9, sparse=True))
    assert "sparse=True" in named(mdm.MDP(many, np.zeros((1100, 1)), discount=0.9, sparse=False))
    monkeypatch.setattr(sys.modules["mdm.latency.faster"], "find_spec", lambda _: None)
    assert "pip install uvloop" in named(mdm.MDP(few, np.zeros((3, 1)), discount=0.9))
