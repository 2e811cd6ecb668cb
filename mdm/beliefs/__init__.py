"""Information states: states, beliefs over the states of a POMDP, and their tracking."""

from mdm.beliefs.filter import Support
from mdm.beliefs.information import Drawn, DrawnInformation, Information, KnownState
from mdm.beliefs.tracker import BeliefTracker

__all__ = ["BeliefTracker", "Drawn", "DrawnInformation", "Information", "KnownState", "Support"]
