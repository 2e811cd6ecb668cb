"""Why an action was decided: plain functions of a policy, a model and an information state."""

from mdm.explanation.belief_change import BeliefChange, Move, moved, nearest_belief
from mdm.explanation.case import Case, Update
from mdm.explanation.expectation import Chance, expected_next
from mdm.explanation.explanation import Explanation, Weighed, explain
from mdm.explanation.influence import Influence, influences, strongest
from mdm.explanation.observation_change import ObservationChange, Observed, observation_changes
from mdm.explanation.state_change import FactorChange, StateChange, state_changes
from mdm.explanation.words import brief, in_words

__all__ = [
    "BeliefChange",
    "Case",
    "Chance",
    "Explanation",
    "FactorChange",
    "Influence",
    "Move",
    "ObservationChange",
    "Observed",
    "StateChange",
    "Update",
    "Weighed",
    "brief",
    "expected_next",
    "explain",
    "in_words",
    "influences",
    "moved",
    "nearest_belief",
    "observation_changes",
    "state_changes",
    "strongest",
]
