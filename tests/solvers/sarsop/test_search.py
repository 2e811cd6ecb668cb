"""The steps of SARSOP, compiled."""

from __future__ import annotations

import pytest

from mdm.problems import rock_sample
from mdm.solvers import solve


@pytest.mark.slow
@pytest.mark.compiled("sarsop")
def test_each_step_is_compiled_once():
    """A second type of an argument would double what its first user waits for."""
    from mdm.solvers.sarsop import search

    solve(rock_sample(4, 4), "sarsop", gap=10.0)  # too large a model to be begun in plain Python
    steps = {name: step.signatures for name, step in vars(search).items() if hasattr(step, "signatures")}
    # What was found on disk has compiled no other: this shows where kernels are compiled anew.
    assert {name: len(found) for name, found in steps.items() if len(found) > 1} == {}
    assert len(steps["explore"]) == 1
