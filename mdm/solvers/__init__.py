"""Solvers: models in, policies out, with bounds that certify them."""

from mdm.solvers.evaluation import controller_values, exact_values, state_values
from mdm.solvers.online import SearchResult, TreeSearch
from mdm.solvers.solution import Limits, Progress, Solution
from mdm.solvers.solve import SOLVERS, solve

__all__ = [
    "SOLVERS",
    "Limits",
    "Progress",
    "SearchResult",
    "Solution",
    "TreeSearch",
    "controller_values",
    "exact_values",
    "solve",
    "state_values",
]
