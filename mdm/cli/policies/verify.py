"""``mdm verify``: how probable it is that a policy, or any policy, does something wrong, or right."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

from mdm.cli.policies.evaluate import of_ensemble
from mdm.cli.policies.inputs import load_for, visibility
from mdm.cli.progress import counting
from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.formats import check_policy_file, load_model, save_policy
from mdm.formats.source import suffixes
from mdm.formats.target import check_place
from mdm.policies import DeterministicPolicy, StagedPolicy
from mdm.texts import counted
from mdm.verification import Estimate, Exact, Verification, verify

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.models import MDP

_LONGEST = 12
"""The steps of a way that are printed."""
_NOUNS = {"P": "probability", "E": "expected steps", "S": "share of steps"}


def run(arguments: argparse.Namespace) -> int:
    """Verify; return the exit status."""
    if suffixes(arguments.model) == ".mcap":
        from mdm.cli.records.monitored import run as run_record  # noqa: PLC0415 - models need no replay

        return run_record(arguments)
    _check_usage(arguments)
    model, policy = _given(arguments)
    note = visibility(model, policy)
    if policy is None:
        seen = "the numbers are over policies that see the state: no policy over observations is outside of them"
        note = None if model.pomdp is None else seen
    if note is not None:
        print(f"mdm verify: {note}", file=sys.stderr)
    options = {name: getattr(arguments, name) for name in ("start", "episodes", "seed", "bounds")}
    with counting(arguments.interruption) as progress:
        answer = verify(model, arguments.specification, policy, **options, progress=progress)
    if not isinstance(answer.result, Estimate) and (arguments.episodes, arguments.seed) != (None, None):
        raise UsageError("--episodes and --seed are for policies that are simulated: this number is exact without them")
    if arguments.output is not None:
        found = answer.policies[arguments.greatest]
        if found is None:
            raise UsageError("within so many steps its policy would be too large to keep: ask for fewer")
        save_policy(found, arguments.output, model)
    if arguments.json:
        print(as_json(answer.facts()))
    else:
        for title, text in _lines(answer):
            print(f"{title:20}{text}")
    if arguments.output is not None and not arguments.json:
        which = "greatest" if arguments.greatest else "least"
        print(f"{'kept in':20}{arguments.output}: a policy that attains the {which}")
    return int(arguments.interruption.status) if arguments.interruption.number is not None else 0


def _check_usage(arguments: argparse.Namespace) -> None:
    if arguments.config is not None:
        raise UsageError("--config is the configuration of a record's run: it goes without a model")
    if arguments.policy is None and arguments.false_negative is not None:
        raise UsageError("--false-negative is for a policy over beliefs: give a POLICY")
    if arguments.output is None:
        if arguments.greatest:
            raise UsageError("--greatest says which policy -o keeps: give -o")
        return
    if arguments.policy is not None:
        raise UsageError("-o keeps a policy that attains the least or the greatest: it goes without a POLICY")
    check_place(arguments.output, arguments.model)
    within = "within" in arguments.specification.split()
    check_policy_file(StagedPolicy if within else DeterministicPolicy, arguments.output)


def _given(arguments: argparse.Namespace) -> tuple[MDP, Any]:
    """Return the model and the policy, or None where all policies are asked about."""
    if suffixes(arguments.model) == ".toml":
        if arguments.policy is None:
            raise UsageError("of a TOML file an ensemble is verified: give its name before the specification")
        policy, model, _ = of_ensemble(arguments)
        return model, policy
    model = load_model(arguments.model)
    if arguments.policy is None:
        return model, None
    policy, model = load_for(model, arguments.policy, arguments)
    return model, policy


def _lines(answer: Verification) -> Iterator[tuple[str, str]]:
    """Yield titles and texts for printing."""
    noun = _NOUNS[answer.kind]
    if answer.result is not None:
        yield noun, _number(answer.result)
        if isinstance(answer.result, Estimate):
            its = answer.result
            open_ = f", {its.undecided} of them undecided" if its.undecided else ""
            yield "", f"{its.episodes} simulated episodes{open_}, seed {its.seed}"
        if (found := answer.bounds) is not None:
            width = f"{found.upper - found.lower:.2g} apart, by {counted(found.beliefs, 'belief')} in"
            yield "belief graph", f"between {found.lower:.6g} and {found.upper:.6g}, {width} {found.seconds:.1f} s"
    else:
        for title, number in (("least", answer.least), ("greatest", answer.greatest)):
            assert number is not None
            yield title, f"{noun} {_number(number)}"
    if (way := answer.way) is not None:
        steps = [
            f"{printable(state)} ({printable(action)})" for state, action in zip(way.states, way.actions, strict=False)
        ]
        steps += [printable(state) for state in way.states[len(way.actions) :]]
        if len(steps) > _LONGEST:
            half = _LONGEST // 2
            steps = [*steps[:half], f"{len(steps) - 2 * half} more", *steps[-half:]]
        yield "most probable way", f"{', '.join(steps)}: {way.probability:.6g}"
    if (decision := answer.decision) is not None:
        where, does, instead = map(printable, (decision.where, decision.action, decision.instead))
        yield "worst decision", f"{does} in {where}: with {instead} there X is reached with {decision.probability:.6g}"


def _number(number: Exact | Estimate) -> str:
    if isinstance(number, Estimate):
        if math.isinf(number.lower):
            return "infinite: some episodes never end there"
        return f"between {number.lower:.6g} and {number.upper:.6g}, with {number.confidence:.0%} confidence"
    if math.isinf(number.value):
        return "infinite: it is not certain"
    if not number.error:
        return f"{number.value:.6g} (by the graph alone)"
    return f"{number.value:.6g} (error at most {number.error:.1g})"
