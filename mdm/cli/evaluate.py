"""``mdm evaluate``: what a policy is worth in its model: exactly where that can be, by simulation where not."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import add_false_negative, count, seed

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "evaluate",
        help="tell what a policy is worth, exactly or by simulation",
        description=(
            "Tell what a policy is worth at the start of its model. For tables and controllers it is the exact value; "
            "for policies over beliefs what they claim themselves, and an estimate over simulated episodes with a "
            "95 % confidence interval. Whether the two contradict each other is said."
        ),
        epilog="example: mdm evaluate tiger.pomdp tiger.vf --seed 1",
    )
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument("policy", metavar="POLICY", help="a policy for it")
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says how policies are judged."""
    parser.add_argument(
        "--episodes",
        metavar="N",
        type=count,
        help="simulate so many, even where the exact value is known (10000; 1000 where they go one by one)",
    )
    parser.add_argument("--steps", metavar="H", type=count, help="decisions in an episode; by default there is no end")
    parser.add_argument("--seed", metavar="S", type=seed, help="the same seed gives the same result")
    parser.add_argument("--discount", metavar="G", type=float, help="in place of the model's")
    add_false_negative(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; return the exit status."""
    from mdm.cli.report import as_json  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.cli.value import load, load_for, shown  # noqa: PLC0415
    from mdm.cli.verdict import judge  # noqa: PLC0415

    policy, world = load_for(load(arguments.model, arguments.discount), arguments.policy, arguments)
    if (note := shown(world)) is not None:
        print(f"mdm evaluate: {note}", file=sys.stderr)
    verdict = judge(world, policy, arguments)
    if arguments.json:
        print(as_json(verdict.facts()))
        return 0
    for title, text in verdict.lines():
        print(f"{title:20}{text}")
    return 0
