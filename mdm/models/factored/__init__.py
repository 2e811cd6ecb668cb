"""Factored models: two-slice networks of potentials, their flattening, and mixed observability."""

from mdm.models.factored.model import FactoredMDP, FactoredPOMDP, MixedPOMDP
from mdm.models.factored.two_slice import Node, Potential, Table, Tree, TwoSliceNetwork

__all__ = ["FactoredMDP", "FactoredPOMDP", "MixedPOMDP", "Node", "Potential", "Table", "Tree", "TwoSliceNetwork"]
