"""Policies: functions from information states to actions, one module per kind."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.policies.alpha_vectors import AlphaVectors, MaskedAlphaVectors, MixedAlphaVectors
from mdm.policies.baselines import ConstantPolicy, RandomPolicy
from mdm.policies.finite_state_controller import FiniteStateController, JointController
from mdm.policies.policy import BeliefPolicy, Deliberating, Policy, Scores, StatePolicy, mismatch
from mdm.policies.shielded import BudgetedTable, ShieldedTable
from mdm.policies.table import DeterministicPolicy, QTable, StagedPolicy, StochasticPolicy

if TYPE_CHECKING:
    from mdm.policies.policy import Packable

__all__ = [
    "PACKABLE",
    "AlphaVectors",
    "BeliefPolicy",
    "BudgetedTable",
    "ConstantPolicy",
    "Deliberating",
    "DeterministicPolicy",
    "FiniteStateController",
    "JointController",
    "MaskedAlphaVectors",
    "MixedAlphaVectors",
    "Policy",
    "QTable",
    "RandomPolicy",
    "Scores",
    "ShieldedTable",
    "StagedPolicy",
    "StatePolicy",
    "StochasticPolicy",
    "mismatch",
]

PACKABLE: dict[str, type[Packable]] = {
    kind.kind: kind
    for kind in (
        AlphaVectors,
        BudgetedTable,
        DeterministicPolicy,
        FiniteStateController,
        JointController,
        MaskedAlphaVectors,
        MixedAlphaVectors,
        QTable,
        ShieldedTable,
        StagedPolicy,
        StochasticPolicy,
    )
}
"""The kinds of policies that files can hold, by their names in them."""
