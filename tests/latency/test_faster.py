"""What would make decisions faster."""

from __future__ import annotations

import sys

import numpy as np
from places import EXAMPLES

import mdm
from mdm.latency.faster import faster

MODEL, POLICY = EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf"


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


def test_how_beliefs_are_computed_is_said_by_its_cause(monkeypatch):
    def hints():
        ensemble = mdm.Ensemble("robot", policy=POLICY, model=MODEL, actions=dict.fromkeys(range(3), print))
        return [hint for hint in faster([ensemble]) if "beliefs" in hint]

    module = sys.modules["mdm.latency.faster"]
    monkeypatch.setattr(module, "may_compile", lambda: False)
    for found, way_out in ((object(), "unset MDM_COMPILE"), (None, "pip install numba")):
        monkeypatch.setattr(module, "find_spec", lambda _, found=found: found)
        assert hints() == [f"the beliefs of robot are computed by numpy: {way_out}"]
    monkeypatch.setattr(module, "may_compile", lambda: True)
    assert hints() == []
