"""Policies: from a state or a belief to an action."""

from mdm.policies.alpha_vectors import AlphaVectors
from mdm.policies.policy import Policy
from mdm.policies.table import DeterministicPolicy, QTable, StochasticPolicy

__all__ = ["AlphaVectors", "DeterministicPolicy", "Policy", "QTable", "StochasticPolicy"]
