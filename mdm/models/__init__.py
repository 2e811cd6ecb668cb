"""Markov models as plain data: named spaces, MDPs, POMDPs, and the tracking of beliefs."""

from mdm.models.belief import BeliefTracker, Tracker
from mdm.models.belief_filter import Support
from mdm.models.factored import FactoredMDP, FactoredPOMDP
from mdm.models.mdp import MDP
from mdm.models.mixed import MixedPOMDP
from mdm.models.pomdp import POMDP
from mdm.models.potential import Node, Potential, Table, Tree
from mdm.models.space import Factor, Space
from mdm.models.two_slice import TwoSliceNetwork

__all__ = [
    "MDP",
    "POMDP",
    "BeliefTracker",
    "Factor",
    "FactoredMDP",
    "FactoredPOMDP",
    "MixedPOMDP",
    "Node",
    "Potential",
    "Space",
    "Support",
    "Table",
    "Tracker",
    "Tree",
    "TwoSliceNetwork",
]
