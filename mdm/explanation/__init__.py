"""Why an action was decided: plain functions of a policy, a model and an information state."""

from mdm.explanation.belief_change import BeliefChange, Move, moved, nearest_belief
from mdm.explanation.case import Case, Update
from mdm.explanation.changes import (
    FactorChange,
    ObservationChange,
    Observed,
    StateChange,
    observation_changes,
    state_changes,
)
from mdm.explanation.expectation import Chance, expected_next
from mdm.explanation.explanation import Explanation, Weighed, brief, explain, in_words
from mdm.explanation.influence import Influence, influences, strongest

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
