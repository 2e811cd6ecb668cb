"""Worlds that a model drives: closing the loop without a robot."""

from mdm.simulation.batch import Evaluation, evaluate
from mdm.simulation.sampler import Sampler
from mdm.simulation.simulate import SimulationResult, simulate
from mdm.simulation.world import World

__all__ = ["Evaluation", "Sampler", "SimulationResult", "World", "evaluate", "simulate"]
