"""Simulation of policies in their models: worlds for the decision loop, and batches of episodes without it."""

from mdm.simulation.batch import Evaluation, evaluate
from mdm.simulation.sampler import Sampler
from mdm.simulation.simulate import simulate
from mdm.simulation.world import World

__all__ = ["Evaluation", "Sampler", "World", "evaluate", "simulate"]
