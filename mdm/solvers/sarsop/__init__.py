"""SARSOP: the layout of a model, the graph of beliefs, the search, pruning, and the solver."""

from mdm.solvers.sarsop.solver import sarsop

__all__ = ["sarsop"]
