"""The ensembles of a TOML file as they are looked at: their tree, and which predicate or function each symbol has."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

from mdm.actors.abstraction.factors import combined
from mdm.cli.files.info import describe_model
from mdm.config import load_system, look_over

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.actors import Ensemble, ObservationLayer, StateLayer
    from mdm.actors.actions.binding import Binding
    from mdm.config import System
    from mdm.models import MDP

_MOST = 64
"""Symbols that are told one by one."""


def load_ensembles(
    path: str, agent: str | None = None, *, imports: bool, models: dict[Path, MDP] | None = None
) -> System:
    """Load a TOML file, of a team's file the part of an agent, in order to look at it.

    Args:
        path: The file.
        agent: The agent.
        imports: Import its functions, which runs their modules; otherwise they are looked for in the source.
        models: The models loaded before, by their files; newly loaded ones are added.
    """
    return (load_system if imports else look_over)(path, agent=agent, models=models)


def facts(system: System) -> dict[str, Any]:
    """Return the tree of ensembles and the definitions of predicates, ready for JSON."""
    ensembles = [_ensemble(ensemble) for ensemble in system.top]
    return {"kind": "ensembles", "ensembles": ensembles, "definitions": definitions(system)}


def _ensemble(ensemble: Any) -> dict[str, Any]:
    controller = ensemble.controller
    return {
        "name": ensemble.name,
        "summary": ensemble.summary(),
        "policy": getattr(controller.policy, "form", type(controller.policy).__name__),
        "states": controller.symbols.num_states,
        "actions": {
            name: None if binding.ensemble is None else _ensemble(binding.ensemble)
            for name, binding in zip(ensemble.action.names, ensemble.action.bindings, strict=True)
        },
        "model": None if controller.model is None else describe_model(controller.model),
        "wiring": wiring(ensemble),
    }


def wiring(ensemble: Ensemble) -> dict[str, Any]:
    """Return the sources of states and observations and the targets of actions, ready for JSON.

    Factors are None if code publishes the ensemble's states or observations itself. Where several make up symbols that
    the model does not divide, ``joint_states`` or ``joint_observations`` say which each of these is, if they are few.
    """
    facts: dict[str, Any] = {
        "states": _factors(ensemble.state),
        "observations": _factors(ensemble.observation),
        "actions": dict(zip(ensemble.action.names, map(_target, ensemble.action.bindings), strict=True)),
    }
    for kind, layer in (("joint_states", ensemble.state), ("joint_observations", ensemble.observation)):
        pairs = [] if layer is None else list(islice(combined(layer.factors, layer.space), _MOST + 1))
        if 0 < len(pairs) <= _MOST:
            facts[kind] = dict(pairs)
    return facts


def definitions(system: System) -> dict[str, str]:
    """Return the definition of each predicate and event that is declared or used."""
    declared = system.predicates.declared
    names = dict.fromkeys((*declared.names, *declared.used))
    return {name: declared.definition(name) for name in names if declared.knows(name) is not None}


def lines(system: System) -> list[str]:
    """Return the wiring of all ensembles as text."""
    text: list[str] = []
    for ensemble in system.ensembles.values():
        facts = wiring(ensemble)
        text += ["", ensemble.name]
        kind = "states" if ensemble.controller.takes == "state" else "observations"
        if facts[kind] is None:
            text.append(f"  {kind} <- published by code")
        for part in ("states", "observations"):
            for factor, wires in (facts[part] or {}).items():
                sources = {symbol: _source(wire) for symbol, wire in wires.items()}
                text += [f"  {part.removesuffix('s')} {factor}", *_aligned(sources, "<-", indent=4)]
            if (joint := facts.get(f"joint_{part}")) is not None:
                text += [f"  {part} of the model, by the order of the factors", *_aligned(joint, "<-", indent=4)]
        text += ["  actions", *_aligned(facts["actions"], "->", indent=4)]
    defined = definitions(system)
    if defined:
        text += ["", "predicates and events", *_aligned(defined, "<-", indent=2)]
    return text


def _factors(layer: StateLayer | ObservationLayer | None) -> dict[str, dict[str, dict[str, Any]]] | None:
    if layer is None:
        return None
    factors: dict[str, dict[str, dict[str, Any]]] = {}
    for wire in layer.wires():
        factors.setdefault(wire.factor, {})[wire.symbol] = {"from": wire.source, "idle": wire.idle}
    return factors


def _source(wire: dict[str, Any]) -> str:
    return " or ".join(filter(None, (wire["from"], "no event" if wire["idle"] else "")))


def _target(binding: Binding) -> str:
    if binding.ensemble is not None:
        return f"ensemble {binding.ensemble.name}"
    target = binding.target
    name = getattr(target, "__qualname__", type(target).__qualname__)
    return f"{getattr(target, '__module__', '?')}:{name}"


def _aligned(pairs: dict[str, str], arrow: str, *, indent: int) -> list[str]:
    width = max(map(len, pairs))
    return [f"{'':{indent}}{name:{width}} {arrow} {value}" for name, value in pairs.items()]
