"""``mdm simulate``: the mean discounted return of a policy in its model."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import UsageError, add_discount, add_false_negative, count, seed

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "simulate",
        help="simulate a policy in its model and print the mean return",
        description=(
            "Run episodes of an ensemble in a world that its own model drives, in virtual time, and report the mean "
            "discounted return with its standard error. Functions of the file are not called. Ctrl-C ends it after the "
            "episode, with the mean so far."
        ),
        epilog="example: mdm simulate --model tiger.pomdp --policy tiger.vf --episodes 1000 --seed 1",
    )
    parser.add_argument("file", metavar="FILE", nargs="?", help="a TOML file with ensembles")
    parser.add_argument("--ensemble", metavar="NAME", help="which of its ensembles; by default the first")
    parser.add_argument("--model", metavar="M", help="a model, in place of a TOML file")
    parser.add_argument("--policy", metavar="P", help="a policy, in place of a TOML file")
    parser.add_argument("--episodes", metavar="N", type=count, default=100, help="how many episodes (100)")
    parser.add_argument("--seed", metavar="S", type=seed, help="the same seed gives the same result")
    add_discount(parser)
    add_false_negative(parser)
    parser.add_argument("--steps", metavar="H", type=count, help="decisions in an episode")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Simulate; return the exit status."""
    from mdm.cli.policies.progress import counting  # noqa: PLC0415
    from mdm.cli.report import as_json  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.simulation import simulate  # noqa: PLC0415

    _check_usage(arguments)
    options = _from_file(arguments) if arguments.file is not None else _from_model(arguments)
    with counting(arguments.interruption) as progress:
        result = simulate(**options, episodes=arguments.episodes, seed=arguments.seed, progress=progress)
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


def _from_model(arguments: argparse.Namespace) -> dict[str, Any]:
    from mdm.cli.policies.inputs import load, load_for, visibility  # noqa: PLC0415

    policy, model = load_for(load(arguments.model, arguments.discount), arguments.policy, arguments)
    if sentence := visibility(model):
        print(f"mdm simulate: {sentence}", file=sys.stderr)
    return {
        "model": model,
        "policy": policy,
        "steps": arguments.steps,
    }


def _from_file(arguments: argparse.Namespace) -> dict[str, Any]:
    from mdm.config import load_system  # noqa: PLC0415
    from mdm.errors import Error  # noqa: PLC0415

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
    }
