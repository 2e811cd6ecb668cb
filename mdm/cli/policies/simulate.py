"""``mdm simulate``: the mean discounted return of a policy in its model."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.policies.inputs import load, load_for, visibility
from mdm.cli.progress import counting
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError, take_model
from mdm.config import load_system
from mdm.config.recorded import attach_configuration, attach_file, lay_out
from mdm.errors import Error
from mdm.recording import Recorder
from mdm.simulation import simulate
from mdm.simulation.simulate import simulated

if TYPE_CHECKING:
    import argparse

    from mdm.actors import Ensemble
    from mdm.recording import Record

__all__ = ["recorded_simulation", "run"]

_REPEATED = ("file", "ensemble", "model", "policy", "discount", "false_negative", "steps", "seed")
"""The arguments by which a simulation is repeated."""


def run(arguments: argparse.Namespace) -> int:
    """Simulate; return the exit status."""
    take_model(arguments)
    _check_usage(arguments)
    options = _from_file(arguments) if arguments.file is not None else _from_model(arguments)
    with counting(arguments.interruption) as progress:
        result = simulate(
            **options,
            episodes=arguments.episodes,
            seed=arguments.seed,
            progress=progress,
            record=_recorder(arguments),
        )
    interrupted = arguments.interruption.number is not None
    if arguments.json:
        fields = ("episodes", "steps", "mean", "standard_error")
        facts = {field: getattr(result, field) for field in fields}
        print(as_json(facts | {"seed": arguments.seed, "interrupted": interrupted}))
    else:
        print(
            f"mean discounted return {result.mean:.6g} ± {result.standard_error:.3g} (standard error), "
            f"{result.episodes} episodes of {result.steps} decisions"
        )
        if interrupted:
            print(f"interrupted: this is of {result.episodes} episodes, not of {arguments.episodes}")
    return arguments.interruption.status if interrupted else 0


def _check_usage(arguments: argparse.Namespace) -> None:
    if arguments.file is None and (arguments.model is None or arguments.policy is None):
        raise UsageError("give a TOML file, or both --model and --policy")
    if arguments.file is None and arguments.ensemble is not None:
        raise UsageError("--ensemble is for a TOML file")
    if arguments.file is None:
        return
    if arguments.model is not None or arguments.policy is not None:
        raise UsageError("--model and --policy stand in place of a TOML file: give either")
    if arguments.discount is not None or arguments.false_negative is not None:
        raise UsageError("--discount and --false-negative are for --model; a TOML file has its own")


def _recorder(arguments: argparse.Namespace) -> Recorder | None:
    """Return what records a simulation, with the files that a replay reads; None where it is not recorded."""
    if arguments.record is None:
        return None
    recorder = Recorder(arguments.record)
    facts = {name: getattr(arguments, name) for name in _REPEATED}
    if arguments.file is not None:
        attach_configuration(recorder, arguments.file)
        facts["file"] = Path(arguments.file).name
    else:
        facts |= {name: attach_file(recorder, facts[name]) for name in ("model", "policy")}
    recorder.head(simulation=json.dumps(facts))
    return recorder


def recorded_simulation(record: Record, folder: str | Path, given: str | Path | None = None) -> Ensemble:
    """Return the ensemble of a recorded simulation.

    Args:
        record: The record, whose head says what was simulated.
        folder: Where files of the record are laid out.
        given: A TOML file, in place of what was simulated.
    """
    arguments = Namespace(**json.loads(record.head["simulation"]))
    if given is not None:
        arguments.file, arguments.ensemble = str(given), arguments.ensemble if arguments.file else None
    else:
        here = lay_out(record, folder)
        for name in ("file", "model", "policy"):
            if getattr(arguments, name) is not None:
                setattr(arguments, name, str(here / getattr(arguments, name)))
    options = _from_file(arguments) if arguments.file is not None else _from_model(arguments)
    return simulated(**options, seed=arguments.seed)


def _from_model(arguments: argparse.Namespace) -> dict[str, Any]:
    policy, model = load_for(load(arguments.model, arguments.discount), arguments.policy, arguments)
    if sentence := visibility(model):
        print(f"mdm simulate: {sentence}", file=sys.stderr)
    return {
        "model": model,
        "policy": policy,
        "steps": arguments.steps,
    }


def _from_file(arguments: argparse.Namespace) -> dict[str, Any]:
    system = load_system(arguments.file, callbacks=False)
    name = arguments.ensemble or system.top[0].name
    if name not in system.ensembles:
        raise Error(f"{arguments.file}: there is no ensemble {name!r}; there are {', '.join(system.ensembles)}")
    control = system.ensembles[name].control
    controller = control.controller
    if controller.model is None:
        raise Error(f"{arguments.file}: ensemble {name!r} has no model to simulate")
    if controller.policy.num_actions != len(controller.model.action_space):
        raise Error(
            f"{arguments.file}: ensemble {name!r} runs one agent's part of a policy: give the team's --model and "
            f"--policy"
        )
    return {
        "model": controller.model,
        "policy": controller.policy,
        "steps": arguments.steps or controller.horizon,
        "drive": control.drive,
        "on_impossible": "predict" if controller.on_impossible == "safe_action" else controller.on_impossible,
        "on_no_observation": control.on_no_observation,
        "tracker": controller.information if controller.has_own_tracker else None,
    }
