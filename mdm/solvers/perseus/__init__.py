"""Perseus: point-based value iteration over beliefs that random exploration meets."""

from mdm.solvers.perseus.solver import perseus

__all__ = ["perseus"]
