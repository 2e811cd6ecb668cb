"""What is certified is what a policy earns."""

from __future__ import annotations

import figures
import pytest

from mdm.solvers import Limits
from mdm.solvers.perseus import perseus

MADP = [("dec_tiger", 0.9, 40), ("dec_tiger", 0.95, 60), ("broadcast_channel", 0.9, 20)]


MADP += [("grid_small", 0.9, 17), pytest.param("patrol", 0.9, 32, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("problem", "discount", "rounds"), MADP)
def test_policies_are_certified_to_be_worth_what_madp_says_of_its_own(problem, discount, rounds):
    told = figures.of(problem)["values"][str(discount)]
    beliefs = {"patrol": 600, "grid_small": 400}.get(problem, 1000)
    solution = perseus(figures.model(problem, discount), beliefs=beliefs, limits=Limits(iterations=rounds))
    assert solution.lower > told["perseus"] - 1e-3
    assert solution.upper <= max(told["qmdp"]) + 1e-2
