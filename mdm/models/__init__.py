"""Markov models as plain data: named spaces, MDPs, POMDPs, and the tracking of beliefs."""

from mdm.models.belief import BeliefTracker, Tracker
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP
from mdm.models.space import Factor, Space

__all__ = ["MDP", "POMDP", "BeliefTracker", "Factor", "Space", "Tracker"]
