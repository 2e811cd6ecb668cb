"""``mdm solve``: a policy for a model, with the bounds that certify it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import UsageError, add_discount, add_durations, add_false_negative, count, limit, seed

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.solvers import Progress, Solution

__all__ = ["add_parser", "run"]

_OPTIONS = ("horizon", "seed", "whole")
"""Options of some solvers only."""
_LONG = 1.0
"""Seconds from which on it is told how long the policy's file took."""


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "solve",
        help="compute a policy for a model, certified by bounds",
        description=(
            "Solve a model and print bounds on its value at the initial belief: the policy's value is at least the "
            "lower one, and no policy's exceeds the upper. It stops when the bounds are close, a limit is reached, or "
            "at Ctrl-C, SIGTERM or SIGHUP, and keeps the best policy so far."
        ),
        epilog="example: mdm solve tiger.pomdp -o tiger.npz --gap 0.01",
    )
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument(
        "-o",
        "--output",
        metavar="POLICY",
        help="the policy's file; its suffix chooses the format: .npz keeps any policy, .vf, .alpha and .policy alpha "
        "vectors, .policy tables, .pg controllers",
    )
    parser.add_argument(
        "--solver", metavar="NAME", action=_Solver, help="by default chosen for the model; 'help' lists them"
    )
    parser.add_argument(
        "--gap", metavar="G", type=limit, default=1e-3, help="stop when the bounds are this close (0.001)"
    )
    parser.add_argument(
        "--time", metavar="S", type=limit, help="stop after S seconds; to lay out a large model takes what it takes"
    )
    parser.add_argument("--memory", metavar="MB", type=limit, help="stop at this much memory (80 %% of the machine's)")
    parser.add_argument("--iterations", metavar="N", type=count, help="stop after N sweeps, trials or rounds")
    add_discount(parser)
    add_durations(parser)
    parser.add_argument("--horizon", metavar="H", type=count, help="decisions, for solvers of finite horizons")
    add_false_negative(parser)
    parser.add_argument("--seed", metavar="S", type=seed, help="for randomised solvers")
    parser.add_argument(
        "--whole", action="store_const", const=True, help="keep all of SARSOP's vectors, not only those of a good plan"
    )
    parser.add_argument("--history", metavar="FILE.json", help="write the bounds over time, for mdm plot bounds")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


class _Solver(argparse.Action):
    """Takes the name of a solver, or lists them."""

    def __call__(self, parser: argparse.ArgumentParser, arguments: argparse.Namespace, name: Any, *_: object) -> None:
        from mdm.solvers import SOLVERS  # noqa: PLC0415 - `mdm --help` needs no numpy

        if name == "help":
            for solver, entry in SOLVERS.items():
                print(f"{solver:28}for {entry[2]}s")
            print("\ndocs/solving.md says which suits which model")
            parser.exit()
        if name not in SOLVERS:
            parser.error(f"there is no solver {name!r}; there are {', '.join(SOLVERS)}")
        setattr(arguments, self.dest, name)


def run(arguments: argparse.Namespace) -> int:
    """Solve the model; return the exit status."""
    from mdm.cli.policies.inputs import (  # noqa: PLC0415
        hidden_times,
        load,
        load_durations_for,
        revealed,
        visibility,
        with_false_negatives,
    )
    from mdm.cli.report import as_json  # noqa: PLC0415
    from mdm.formats import check_policy_file, save_policy  # noqa: PLC0415
    from mdm.formats.target import check_place, write_text  # noqa: PLC0415
    from mdm.policies import mismatch  # noqa: PLC0415
    from mdm.solvers.solve import default_solver, policy_class  # noqa: PLC0415

    if arguments.durations is not None and (arguments.horizon is not None or arguments.solver == "jesp"):
        raise UsageError("--durations is for time without an end: it goes with neither --horizon nor jesp")
    for target in (arguments.output, arguments.history):
        if target is not None:
            check_place(target, arguments.model, arguments.durations)
    if arguments.history is not None and Path(arguments.history).suffix.lower() != ".json":
        raise UsageError("--history writes JSON: its file ends in .json")
    model = load(arguments.model, arguments.discount)
    durations = load_durations_for(model, arguments.durations)
    world = with_false_negatives(revealed(model), arguments)
    given = {name: value for name in _OPTIONS if (value := getattr(arguments, name)) is not None}
    solver = arguments.solver or default_solver(world, given)
    _check_options(given, solver)
    if arguments.output is not None:
        check_policy_file(policy_class(solver, world, horizon=arguments.horizon, durations=durations), arguments.output)
    for note in filter(None, (visibility(world), hidden_times(world, durations))):
        print(f"mdm solve: {note}", file=sys.stderr)
    solution = _solve(world, solver, {**given, "durations": durations}, arguments)
    saving = 0.0
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
    return arguments.interruption.status if solution.reason == "interrupted" else 0


def _solve(model: MDP, solver: str, options: dict[str, Any], arguments: argparse.Namespace) -> Solution:
    """Solve a model, and tell how far it has come; Ctrl-C or SIGTERM ends it with what it has."""
    from mdm.cli.policies.progress import ProgressLine  # noqa: PLC0415
    from mdm.solvers import solve  # noqa: PLC0415

    interruption, line = arguments.interruption, ProgressLine()
    warned = arguments.output is not None

    def tell(progress: Progress) -> bool:
        nonlocal warned
        if not warned:  # only now, when the solver has taken the model
            print("mdm solve: without -o the policy is not kept, and its bounds alone are printed", file=sys.stderr)
            warned = True
        line(progress)
        return bool(interruption.asked())

    with interruption.deferred():
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


def _check_options(given: dict[str, Any], solver: str) -> None:
    """Refuse options that this solver does not have."""
    from mdm.solvers.solve import options_of  # noqa: PLC0415 - `mdm --help` needs none of it

    if solver == "jesp" and "horizon" not in given:
        raise UsageError("jesp plans for a finite horizon: give --horizon")
    for name in given:
        if name not in options_of(solver):
            raise UsageError(f"{solver} has no option --{name.replace('_', '-')}")


def _facts(solution: Solution, arguments: argparse.Namespace) -> dict[str, Any]:
    from mdm.cli.files.document import describe_policy  # noqa: PLC0415

    return {
        "model": arguments.model,
        "solver": solution.solver,
        "lower": solution.lower,
        "upper": solution.upper,
        "gap": solution.gap,
        "reason": solution.reason,
        "seconds": solution.seconds,
        "iterations": solution.iterations,
        "size": solution.history[-1].size,
        "form": describe_policy(solution.policy)["form"],
        "policy": arguments.output,
    }


def _print(solution: Solution, facts: dict[str, Any], arguments: argparse.Namespace, saving: float) -> None:
    from mdm.cli.policies.progress import bound  # noqa: PLC0415

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
