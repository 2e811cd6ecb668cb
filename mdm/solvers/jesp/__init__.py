"""JESP: joint plans for teams whose members see no more than their own observations (Dec-POMDPs)."""

from mdm.solvers.jesp.alternation import jesp

__all__ = ["jesp"]
