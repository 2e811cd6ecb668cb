"""SARSOP: a package, for its parts are many: the model's layout, first bounds, the graph of beliefs, the search."""

from mdm.solvers.sarsop.solver import sarsop

__all__ = ["sarsop"]
