"""Beliefs over the states of a POMDP: the tracker, the filters it chooses from, and batches of beliefs."""

from mdm.beliefs.filter import Support
from mdm.beliefs.tracker import BeliefTracker, Tracker

__all__ = ["BeliefTracker", "Support", "Tracker"]
