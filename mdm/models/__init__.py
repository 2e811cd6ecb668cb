"""Markov models as plain data: named spaces, MDPs and POMDPs, flat or factored."""

from mdm.models.durations import Durations, in_time
from mdm.models.factored import (
    FactoredMDP,
    FactoredPOMDP,
    MixedPOMDP,
    Node,
    Potential,
    Table,
    Tree,
    TwoSliceNetwork,
)
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP
from mdm.models.space import Factor, Space

__all__ = [
    "MDP",
    "POMDP",
    "Durations",
    "Factor",
    "FactoredMDP",
    "FactoredPOMDP",
    "MixedPOMDP",
    "Node",
    "Potential",
    "Space",
    "Table",
    "Tree",
    "TwoSliceNetwork",
    "in_time",
]
