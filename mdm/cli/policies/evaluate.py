"""``mdm evaluate``: the value of a policy in its model, exact if possible, else simulated."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from mdm.cli.policies.inputs import load, load_durations_for, load_for, visibility
from mdm.cli.policies.verdict import judge
from mdm.cli.report import as_json

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; return the exit status."""
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
