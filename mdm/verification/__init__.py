"""Verification: how probable it is that a policy ever brings a robot somewhere, and how probable it could be."""

from mdm.models.specification import Specification
from mdm.verification.effect import Effect, effect
from mdm.verification.shield import shield
from mdm.verification.unfolding import Bounds
from mdm.verification.verification import Estimate, Exact, Verification, verify
from mdm.verification.ways import Decision, Way

__all__ = [
    "Bounds",
    "Decision",
    "Effect",
    "Estimate",
    "Exact",
    "Specification",
    "Verification",
    "Way",
    "effect",
    "shield",
    "verify",
]
