"""Markov decision making for real agents: what it takes to run one.

The names here are loaded when they are first asked for. What a model, a policy or a solver is made of stands in
`mdm.models`, `mdm.beliefs`, `mdm.policies` and `mdm.solvers`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdm import beliefs, models, policies, problems, simulation, solvers, testing
    from mdm.actors import (
        ActionLayer,
        Binding,
        ControlLayer,
        Drive,
        Ensemble,
        EventSource,
        FixedRate,
        ObservationFactor,
        ObservationLayer,
        OnEvent,
        PredicateManager,
        Sensor,
        StateFactor,
        StateLayer,
        bind,
    )
    from mdm.beliefs import BeliefTracker
    from mdm.config import System, load_system
    from mdm.controller import Controller, Step
    from mdm.errors import ConfigError, Error, FormatError, ModelError, ModelWarning
    from mdm.formats import load_model, load_policy, load_rewards, save_model, save_policy
    from mdm.logic import Formula, P, parse
    from mdm.runtime import (
        Actor,
        ActorFailure,
        Channel,
        Clock,
        DeadlockError,
        Restart,
        Runtime,
        VirtualClock,
        VirtualEventLoop,
        WallClock,
        run,
    )
    from mdm.simulation import World, evaluate, simulate
    from mdm.solvers import solve

__all__ = [
    "ActionLayer",
    "Actor",
    "ActorFailure",
    "BeliefTracker",
    "Binding",
    "Channel",
    "Clock",
    "ConfigError",
    "ControlLayer",
    "Controller",
    "DeadlockError",
    "Drive",
    "Ensemble",
    "Error",
    "EventSource",
    "FixedRate",
    "FormatError",
    "Formula",
    "ModelError",
    "ModelWarning",
    "ObservationFactor",
    "ObservationLayer",
    "OnEvent",
    "P",
    "PredicateManager",
    "Restart",
    "Runtime",
    "Sensor",
    "StateFactor",
    "StateLayer",
    "Step",
    "System",
    "VirtualClock",
    "VirtualEventLoop",
    "WallClock",
    "World",
    "beliefs",
    "bind",
    "evaluate",
    "load_model",
    "load_policy",
    "load_rewards",
    "load_system",
    "models",
    "parse",
    "policies",
    "problems",
    "run",
    "save_model",
    "save_policy",
    "simulate",
    "simulation",
    "solve",
    "solvers",
    "testing",
]

_PACKAGES = ("beliefs", "models", "policies", "problems", "simulation", "solvers", "testing")
_HOMES = {
    "actors": (
        *("ActionLayer", "Binding", "ControlLayer", "Drive", "Ensemble", "EventSource", "FixedRate"),
        *("ObservationFactor", "ObservationLayer", "OnEvent", "PredicateManager", "Sensor"),
        *("StateFactor", "StateLayer", "bind"),
    ),
    "beliefs": ("BeliefTracker",),
    "controller": ("Controller", "Step"),
    "config": ("System", "load_system"),
    "errors": ("ConfigError", "Error", "FormatError", "ModelError", "ModelWarning"),
    "formats": ("load_model", "load_policy", "load_rewards", "save_model", "save_policy"),
    "logic": ("Formula", "P", "parse"),
    "runtime": (
        *("Actor", "ActorFailure", "Channel", "Clock", "DeadlockError", "Restart", "Runtime"),
        *("VirtualClock", "VirtualEventLoop", "WallClock", "run"),
    ),
    "simulation": ("World", "evaluate", "simulate"),
    "solvers": ("solve",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for, so that a program loads no more than it uses."""
    if name in _PACKAGES:
        return importlib.import_module(f"mdm.{name}")
    if name in _HOME_OF:
        value = getattr(importlib.import_module(f"mdm.{_HOME_OF[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'mdm' has no attribute {name!r}{_elsewhere(name)}")


def __dir__() -> list[str]:
    """Return the public names."""
    return list(__all__)


def _elsewhere(name: str) -> str:
    """Return where a name that is no name of this module stands, if it is public in one of the packages."""
    if name.startswith("_"):
        return ""
    for package in _PACKAGES:
        if name in importlib.import_module(f"mdm.{package}").__all__:
            return f"; it is mdm.{package}.{name}"
    return ""
