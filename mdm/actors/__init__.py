"""The layers as actors: predicate manager, state, observation, control and action layer, and the ensemble."""

from mdm.actors.abstraction.factors import ObservationFactor, StateFactor
from mdm.actors.abstraction.layers import ObservationLayer, StateLayer
from mdm.actors.actions.action_layer import ActionLayer, ActionStatistics
from mdm.actors.actions.binding import AbandonedError, Binding, bind
from mdm.actors.actions.subprocesses import run_subprocess
from mdm.actors.control.control_layer import ControlLayer, ControlStatistics
from mdm.actors.control.planner import Planner, PlannerStatistics
from mdm.actors.ensemble import Ensemble, EnsembleStatistics, EnsembleStatus
from mdm.actors.options import BindingOptions, ControlOptions, Drive, DriveOptions, FixedRate, OnEvent, SafetyOptions
from mdm.actors.predicates.predicate_manager import PredicateManager
from mdm.actors.predicates.sources import EventSource, Sensor

__all__ = [
    "AbandonedError",
    "ActionLayer",
    "ActionStatistics",
    "Binding",
    "BindingOptions",
    "ControlLayer",
    "ControlOptions",
    "ControlStatistics",
    "Drive",
    "DriveOptions",
    "Ensemble",
    "EnsembleStatistics",
    "EnsembleStatus",
    "EventSource",
    "FixedRate",
    "ObservationFactor",
    "ObservationLayer",
    "OnEvent",
    "Planner",
    "PlannerStatistics",
    "PredicateManager",
    "SafetyOptions",
    "Sensor",
    "StateFactor",
    "StateLayer",
    "bind",
    "run_subprocess",
]
