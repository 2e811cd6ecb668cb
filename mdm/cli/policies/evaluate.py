"""``mdm evaluate``: the value of a policy in its model, exact if possible, else simulated."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import add_discount, add_durations, add_false_negative, count, seed

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "evaluate",
        help="compute the value of a policy, exactly or by simulation",
        description=(
            "Compute the value of a policy at the initial belief of its model. Tables and controllers have an exact "
            "value. For policies over beliefs, print the value that they claim and an estimate from simulated "
            "episodes with a 95 % confidence interval, and whether the two contradict each other. Ctrl-C ends the "
            "simulation, with what is known by then."
        ),
        epilog="example: mdm evaluate tiger.pomdp tiger.vf --seed 1",
    )
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument("policy", metavar="POLICY", help="a policy for it")
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that evaluation and comparison share."""
    parser.add_argument(
        "--episodes",
        metavar="N",
        type=count,
        help="simulate N episodes, even if the exact value is known (10000; 1000 if they cannot run as a batch)",
    )
    parser.add_argument("--steps", metavar="H", type=count, help="decisions in an episode (no limit)")
    parser.add_argument("--seed", metavar="S", type=seed, help="the same seed gives the same result")
    add_discount(parser)
    add_durations(parser)
    add_false_negative(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; return the exit status."""
    from mdm.cli.policies.inputs import load, load_durations_for, load_for, visibility  # noqa: PLC0415
    from mdm.cli.policies.verdict import judge  # noqa: PLC0415
    from mdm.cli.report import as_json  # noqa: PLC0415 - `mdm --help` needs no numpy

    model = load(arguments.model, arguments.discount)
    durations = load_durations_for(model, arguments.durations)
    policy, world = load_for(model, arguments.policy, arguments)
    if (note := visibility(world)) is not None:
        print(f"mdm evaluate: {note}", file=sys.stderr)
    verdict = judge(world, policy, arguments, durations)
    interrupted = arguments.interruption.number is not None
    if arguments.json:
        print(as_json(verdict.facts() | {"interrupted": interrupted}))
    else:
        for title, text in verdict.lines():
            print(f"{title:20}{text}")
        if interrupted:
            print(f"{'interrupted':20}this is of the episodes that had ended by then")
    return arguments.interruption.status if interrupted else 0
