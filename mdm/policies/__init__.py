"""Policies: from a state or a belief to an action, or from node to node of a controller."""

from mdm.policies.alpha_vectors import AlphaVectors
from mdm.policies.constant_policy import ConstantPolicy
from mdm.policies.finite_state_controller import FiniteStateController
from mdm.policies.joint_controller import JointController
from mdm.policies.masked_alpha_vectors import MaskedAlphaVectors
from mdm.policies.mixed_alpha_vectors import MixedAlphaVectors
from mdm.policies.policy import Policy
from mdm.policies.random_policy import RandomPolicy
from mdm.policies.staged_policy import StagedPolicy
from mdm.policies.table import DeterministicPolicy, QTable, StochasticPolicy
from mdm.policies.walk import Controller, Walk

__all__ = [
    "AlphaVectors",
    "ConstantPolicy",
    "Controller",
    "DeterministicPolicy",
    "FiniteStateController",
    "JointController",
    "MaskedAlphaVectors",
    "MixedAlphaVectors",
    "Policy",
    "QTable",
    "RandomPolicy",
    "StagedPolicy",
    "StochasticPolicy",
    "Walk",
]
