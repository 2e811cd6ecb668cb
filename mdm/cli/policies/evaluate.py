"""``mdm evaluate``: the value of a policy in its model, exact if possible, else simulated."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.policies.inputs import load, load_durations_for, load_for, visibility
from mdm.cli.policies.verdict import judge
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.formats.source import suffixes

if TYPE_CHECKING:
    import argparse

    from mdm.models import MDP, Durations

__all__ = ["run"]

_OWN = ("discount", "discount_of", "durations", "false_negative")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; return the exit status."""
    if suffixes(arguments.model) == ".toml":
        policy, world, durations = _of_ensemble(arguments)
    else:
        model = load(arguments.model, arguments.discount, arguments.discount_of)
        durations = load_durations_for(model, arguments.durations)
        policy, world = load_for(model, arguments.policy, arguments)
    if (note := visibility(world, policy)) is not None:
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


def _of_ensemble(arguments: argparse.Namespace) -> tuple[Any, MDP, Durations | None]:
    """Return the policy of a TOML file's ensemble, the model that it is for, and how long actions take there."""
    from mdm.cli.robots.ensembles import load_ensembles  # noqa: PLC0415 - a model needs no actors

    for name in _OWN:
        if getattr(arguments, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is for a model's file; an ensemble has its own")
    system, name = load_ensembles(arguments.model, imports=False), arguments.policy
    if name not in system.ensembles:
        raise UsageError(f"{arguments.model}: there is no ensemble {name!r}; there are {', '.join(system.ensembles)}")
    controller = system.ensembles[name].controller
    if controller.model is None or controller.policy.num_actions != len(controller.model.action_space):
        raise UsageError(f"{arguments.model}: ensemble {name!r} has no model to evaluate all of its policy in")
    return controller.policy, controller.model, system.durations.get(name)
