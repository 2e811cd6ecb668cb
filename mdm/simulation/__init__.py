"""Worlds that a model drives: closing the loop without a robot."""

from mdm.simulation.batch import Evaluation, evaluate
from mdm.simulation.sampler import Sampler
from mdm.simulation.simulate import simulate
from mdm.simulation.world import World

__all__ = ["Evaluation", "Sampler", "World", "evaluate", "simulate"]
