"""Simulation of policies in their models: worlds for the decision loop, batches of episodes without it, and teams."""

from mdm.simulation.batch import Evaluation, ReachingEvaluation, evaluate
from mdm.simulation.communication import CommunicationEvaluation, evaluate_communication
from mdm.simulation.sampler import Sampler
from mdm.simulation.world import World, simulate

__all__ = [
    "CommunicationEvaluation",
    "Evaluation",
    "ReachingEvaluation",
    "Sampler",
    "World",
    "evaluate",
    "evaluate_communication",
    "simulate",
]
