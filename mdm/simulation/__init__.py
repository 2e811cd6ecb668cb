"""Simulation of policies in their models: worlds for the decision loop, batches of episodes without it, and teams."""

from mdm.simulation.batch import Comparison, Evaluation, ReachingEvaluation, compare, evaluate
from mdm.simulation.communication import CommunicationEvaluation, evaluate_communication
from mdm.simulation.parts import Processes, WorkerWarning
from mdm.simulation.sampler import Sampler
from mdm.simulation.world import World, simulate

__all__ = [
    "CommunicationEvaluation",
    "Comparison",
    "Evaluation",
    "Processes",
    "ReachingEvaluation",
    "Sampler",
    "WorkerWarning",
    "World",
    "compare",
    "evaluate",
    "evaluate_communication",
    "simulate",
]
