"""``mdm solve``: a policy for a model, with the bounds that certify it."""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mdm.cli.files.info import describe_policy
from mdm.cli.policies.inputs import hidden_times, load, load_durations_for, visibility, with_false_negatives
from mdm.cli.progress import ProgressLine, bound
from mdm.cli.report import as_json
from mdm.cli.usage import UsageError
from mdm.formats import check_policy_file, save_policy
from mdm.formats.target import check_place, write_text
from mdm.loading import revealed
from mdm.policies import mismatch
from mdm.solvers import solve
from mdm.solvers.solve import default_solver, options_of, policy_class

if TYPE_CHECKING:
    import argparse

    from mdm.models import MDP
    from mdm.solvers import Progress, Solution

_OPTIONS = ("horizon", "seed", "whole")
"""Options of some solvers only."""
_LONG = 1.0
"""Seconds from which on it is told how long the policy's file took."""


def run(arguments: argparse.Namespace) -> int:
    """Solve the model; return the exit status."""
    if arguments.durations is not None and (arguments.horizon is not None or arguments.solver == "jesp"):
        raise UsageError("--durations is for time without an end: it goes with neither --horizon nor jesp")
    for target in (arguments.output, arguments.history):
        if target is not None:
            check_place(target, arguments.model, arguments.durations)
    if arguments.history is not None and Path(arguments.history).suffix.lower() != ".json":
        raise UsageError("--history writes JSON: its file ends in .json")
    model = load(arguments.model, arguments.discount, arguments.discount_of)
    durations = load_durations_for(model, arguments.durations)
    world = with_false_negatives(revealed(model), arguments)
    given = {name: value for name in _OPTIONS if (value := getattr(arguments, name)) is not None}
    solver = arguments.solver or default_solver(world, given)
    _check_options(given, solver)
    if arguments.output is not None:
        check_policy_file(policy_class(solver, world, horizon=arguments.horizon, durations=durations), arguments.output)
    for note in filter(None, (visibility(world), hidden_times(world, durations))):
        print(f"mdm solve: {note}", file=sys.stderr)
    saving = 0.0
    with arguments.interruption.deferred():  # until the policy is kept
        solution = _solve(world, solver, {**given, "durations": durations}, arguments)
        if arguments.output is not None:
            fits = mismatch(solution.policy, model) is None  # not if observations include the observed state
            began = perf_counter()
            save_policy(solution.policy, arguments.output, model if fits else world)
            saving = perf_counter() - began
    facts = _facts(solution, arguments)
    if arguments.history is not None:
        history = [{key: getattr(entry, key) for key in entry.__struct_fields__} for entry in solution.history]
        write_text(arguments.history, as_json(facts | {"history": history}) + "\n")
    if arguments.json:
        print(as_json(facts))
    else:
        _print(solution, facts, arguments, saving)
    _warn(world, solution)
    interrupted = solution.reason == "interrupted" or arguments.interruption.number is not None
    return arguments.interruption.status if interrupted else 0


def _solve(model: MDP, solver: str, options: dict[str, Any], arguments: argparse.Namespace) -> Solution:
    """Solve a model and print the progress; Ctrl-C or SIGTERM ends it with the best result so far."""
    interruption, line = arguments.interruption, ProgressLine(limit=arguments.time)
    warned = arguments.output is not None

    def tell(progress: Progress) -> bool:
        nonlocal warned
        if not warned:  # only now, when the solver has taken the model
            print("mdm solve: without -o the policy is not kept, and its bounds alone are printed", file=sys.stderr)
            warned = True
        line(progress)
        return bool(interruption.asked())

    try:
        return solve(
            model,
            solver,
            gap=arguments.gap,
            time=arguments.time,
            iterations=arguments.iterations,
            memory=None if arguments.memory is None else int(min(arguments.memory * 1e6, sys.maxsize)),
            progress=tell,
            **options,
        )
    finally:
        line.end()


def _warn(model: MDP, solution: Solution) -> None:
    """Print that the policy ends where it could be kept out of, if it does."""
    from mdm.verification.dangers import avoidable_end  # noqa: PLC0415 - slow to import

    danger = None if solution.reason == "interrupted" else avoidable_end(model, solution.policy)
    if danger is not None:
        print(f"mdm solve: {danger}", file=sys.stderr)


def _check_options(given: dict[str, Any], solver: str) -> None:
    """Refuse options that this solver does not have."""
    if solver == "jesp" and "horizon" not in given:
        raise UsageError("jesp plans for a finite horizon: give --horizon")
    for name in given:
        if name not in options_of(solver):
            raise UsageError(f"{solver} has no option --{name.replace('_', '-')}")


def _facts(solution: Solution, arguments: argparse.Namespace) -> dict[str, Any]:
    keys = ("solver", "lower", "upper", "gap", "reason", "seconds", "iterations")
    return {
        "model": arguments.model,
        **{key: getattr(solution, key) for key in keys},
        "size": solution.history[-1].size,
        "form": describe_policy(solution.policy)["form"],
        "policy": arguments.output,
    }


def _print(solution: Solution, facts: dict[str, Any], arguments: argparse.Namespace, saving: float) -> None:
    why = {
        "gap": f"the gap is at most {arguments.gap:g}",
        "time": "time limit",
        "iterations": "iteration limit",
        "memory": "memory limit",
        "interrupted": "interrupted: this is the best so far",
        "converged": "converged",
        "exact": "the result is exact",
    }[solution.reason]
    lower, upper = bound(solution.lower), bound(solution.upper)
    known = f"{lower} to {upper}"
    known += f" (gap {solution.gap:.3g})" if "?" not in {lower, upper} else " (? for an unknown bound)"
    print(f"{'value at the start':20}{known}")
    print(f"{'policy':20}{facts['form']}, size {facts['size']}")
    print(f"{'solver':20}{solution.solver}, {solution.iterations} iterations in {solution.seconds:.3g} s")
    print(f"{'stopped':20}{why}")
    kept = f"nowhere: give -o, such as -o {Path(arguments.model).name.split('.')[0]}.npz"
    if arguments.output is not None:
        size = Path(arguments.output).stat().st_size
        kept = f"{arguments.output}, {size / 1e6:.3g} MB" if size >= 1e6 else f"{arguments.output}, {size / 1e3:.3g} kB"
        kept += f", which took {saving:.3g} s" if saving > _LONG else ""
    print(f"{'kept in':20}{kept}")
