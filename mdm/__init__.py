"""Markov decision making for real agents: what it takes to run one.

The names here are loaded when they are first asked for. What a model, a policy or a solver is made of stands in
`mdm.models`, `mdm.beliefs`, `mdm.policies` and `mdm.solvers`.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # `typing` takes a while to load, in which Ctrl-C would show a traceback of the command
if TYPE_CHECKING:
    from typing import Any

    from mdm import (
        actors,
        beliefs,
        config,
        estimation,
        formats,
        gym,
        latency,
        logic,
        maps,
        messages,
        models,
        policies,
        problems,
        runtime,
        simulation,
        solvers,
        team,
        testing,
        verification,
    )
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
        run_subprocess,
    )
    from mdm.actors.drift import DriftMonitor
    from mdm.beliefs import BeliefTracker
    from mdm.config import System, load_system
    from mdm.config.sweep import sweep
    from mdm.controller import Controller, Step
    from mdm.errors import ConfigError, Error, FormatError, MapError, MapWarning, ModelError, ModelWarning
    from mdm.formats import load_model, load_policy, load_rewards, save_model, save_policy
    from mdm.logic import Formula, P, parse
    from mdm.models import MDP, POMDP
    from mdm.runtime import (
        Actor,
        ActorFailure,
        Channel,
        Clock,
        DeadlockError,
        Extension,
        Observer,
        Restart,
        Runtime,
        VirtualClock,
        VirtualEventLoop,
        WallClock,
        run,
    )
    from mdm.simulation import WorkerWarning, World, compare, evaluate
    from mdm.simulation.world import simulate
    from mdm.solvers import solve
    from mdm.team.team import Team
    from mdm.verification import verify
    from mdm.verification.shield import shield
    from mdm.version import __version__


__all__ = [
    "MDP",
    "POMDP",
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
    "DriftMonitor",
    "Drive",
    "Ensemble",
    "Error",
    "EventSource",
    "Extension",
    "FixedRate",
    "FormatError",
    "Formula",
    "MapError",
    "MapWarning",
    "ModelError",
    "ModelWarning",
    "ObservationFactor",
    "ObservationLayer",
    "Observer",
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
    "Team",
    "VirtualClock",
    "VirtualEventLoop",
    "WallClock",
    "WorkerWarning",
    "World",
    "__version__",
    "actors",
    "beliefs",
    "bind",
    "compare",
    "config",
    "estimation",
    "evaluate",
    "formats",
    "gym",
    "latency",
    "load_model",
    "load_policy",
    "load_rewards",
    "load_system",
    "logic",
    "maps",
    "messages",
    "models",
    "parse",
    "policies",
    "problems",
    "run",
    "run_subprocess",
    "runtime",
    "save_model",
    "save_policy",
    "shield",
    "simulate",
    "simulation",
    "solve",
    "solvers",
    "sweep",
    "team",
    "testing",
    "verification",
    "verify",
]

_PACKAGES = (
    *("beliefs", "maps", "models", "policies", "problems", "simulation", "solvers", "team", "testing"),
    *("actors", "config", "estimation", "formats", "gym", "latency", "logic", "messages", "runtime", "verification"),
)
_HOMES = {
    "actors": (
        *("ActionLayer", "Binding", "ControlLayer", "Drive", "Ensemble", "EventSource", "FixedRate"),
        *("ObservationFactor", "ObservationLayer", "OnEvent", "PredicateManager", "Sensor"),
        *("StateFactor", "StateLayer", "bind", "run_subprocess"),
    ),
    "actors.drift": ("DriftMonitor",),
    "beliefs": ("BeliefTracker",),
    "controller": ("Controller", "Step"),
    "config": ("System", "load_system"),
    "config.sweep": ("sweep",),
    "errors": ("ConfigError", "Error", "FormatError", "MapError", "MapWarning", "ModelError", "ModelWarning"),
    "formats": ("load_model", "load_policy", "load_rewards", "save_model", "save_policy"),
    "logic": ("Formula", "P", "parse"),
    "models": ("MDP", "POMDP"),
    "runtime": (
        *("Actor", "ActorFailure", "Channel", "Clock", "DeadlockError", "Extension", "Observer", "Restart", "Runtime"),
        *("VirtualClock", "VirtualEventLoop", "WallClock", "run"),
    ),
    "simulation": ("WorkerWarning", "World", "compare", "evaluate", "simulate"),
    "solvers": ("solve",),
    "team": ("Team",),
    "verification": ("shield", "verify"),
    "version": ("__version__",),
}
TABLES = {"ros2": "mdm.ros2.tables:Ros2Reader"}
"""The reader of each extension's table in a file, see `mdm.config.TableReader`: loaded for files that have one."""
OFFERS = {"record": "mdm.config.description:recorder_of", "page": "mdm.views.web.server:page_of"}
"""The function that makes the extension of an option of the runtime, which knows no package above it."""
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
    """Return where a name that is no name of this module stands, or which public names are like it."""
    if name.startswith("_"):
        return ""
    known = {public: f"mdm.{public}" for public in __all__}
    for package in _PACKAGES:
        for public in importlib.import_module(f"mdm.{package}").__all__:
            known.setdefault(public, f"mdm.{package}.{public}")
    if name in known:
        return f"; it is {known[name]}"
    import difflib  # noqa: PLC0415 - only a mistake needs it

    close = difflib.get_close_matches(name, known, n=2, cutoff=0.75)
    return f"; did you mean {' or '.join(known[each] for each in close)}?" if close else ""
