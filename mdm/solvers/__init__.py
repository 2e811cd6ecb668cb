"""Solvers: models in, policies out, with bounds that certify them."""

from mdm.solvers.evaluation import controller_values, exact_values, state_values
from mdm.solvers.solution import Progress, Solution
from mdm.solvers.solve import SOLVERS, solve
from mdm.solvers.watch import Watch

__all__ = [
    "SOLVERS",
    "Progress",
    "Solution",
    "Watch",
    "controller_values",
    "exact_values",
    "solve",
    "state_values",
]
