"""The arguments of the verbs about solving, policies and their values."""

from __future__ import annotations

import argparse
from typing import Any

from mdm.cli.usage import (
    add_discount,
    add_discount_of,
    add_durations,
    add_false_negative,
    add_file,
    add_verb,
    complete,
    count,
    limit,
    moment,
    seed,
)


def add_compare(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Compare the values of several policies at the initial belief of a model. All are simulated with the same "
        "random numbers, so that their differences are known far better than their values. Differences are from the "
        "first policy, with their 95 % confidence."
    )
    parser = add_verb(verbs, "compare", line, about, "mdm compare tiger.pomdp tiger.vf tiger.npz --seed 1")
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument("policies", metavar="POLICY", nargs="+", help="policies for it; the first is the reference")
    add_arguments(parser)
    complete(parser, "compare", "mdm.cli.policies.compare")


def add_evaluate(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Compute the value of a policy at the initial belief of its model. Tables and controllers have an exact value. "
        "For policies over beliefs, print the value that they claim and an estimate from simulated episodes with a 95 "
        "% confidence interval, and whether the two contradict each other. Ctrl-C ends the simulation, with what is "
        "known by then."
    )
    parser = add_verb(verbs, "evaluate", line, about, "mdm evaluate tiger.pomdp tiger.vf --seed 1")
    parser.add_argument("model", metavar="MODEL", help="a model, or a TOML file")
    parser.add_argument("policy", metavar="POLICY", help="a policy for it, or the name of an ensemble of the file")
    add_arguments(parser)
    complete(parser, "evaluate", "mdm.cli.policies.evaluate")


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
    add_discount_of(parser)
    add_durations(parser)
    add_false_negative(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")


def add_plot(verbs: Any, line: str) -> None:
    """Add the verb, its kinds of pictures and their arguments."""
    about = "Draw a picture (needs mdm[plot]); its file's suffix is .png, .svg or .pdf."
    parser = add_verb(verbs, "plot", line, about, "mdm plot policy tiger.pomdp tiger.vf -o tiger.png")
    kinds = parser.add_subparsers(dest="picture", metavar="PICTURE", required=True)
    bounds = _kind(
        kinds,
        "bounds",
        "the bounds of solvers over time",
        "Draw the bounds over time of one or several runs, from the files of mdm solve --history.",
        "mdm plot bounds sarsop.json perseus.json -o bounds.png",
    )
    bounds.add_argument("histories", metavar="HISTORY.json", nargs="+", help="a file written by mdm solve --history")
    policy = _kind(
        kinds,
        "policy",
        "the actions and values of a policy",
        "Draw the actions and values of a policy: over the states of an MDP or a factored model, as a grid of two "
        "factors, or over beliefs in two states.",
        "mdm plot policy tiger.pomdp tiger.vf -o tiger.png",
    )
    _add_inputs(policy)
    policy.add_argument(
        "--states",
        metavar=("A", "B"),
        nargs=2,
        help="draw over beliefs in these two states; by default those that are most often confused",
    )
    policy.add_argument("--axes", metavar=("DOWN", "ACROSS"), nargs=2, help="draw over these two factors of the state")
    policy.add_argument("--columns", metavar="N", type=count, help="lay states without factors out in rows of N")
    belief = _kind(
        kinds,
        "belief",
        "a belief over an episode",
        "Draw the belief over one simulated episode, with true states, actions and observations.",
        "mdm plot belief tiger.pomdp tiger.vf -o belief.png --seed 1",
    )
    _add_inputs(belief)
    belief.add_argument("--steps", metavar="H", type=count, default=25, help="decisions (25)")
    run = _kind(
        kinds,
        "run",
        "a recorded run over time",
        "Draw the record of a run over time: the modes of each ensemble, its decisions, the lives of its actions, its "
        "faults, its belief, and the rewards since the start.",
        "mdm plot run run.mcap -o run.png --since 10 --until 20",
    )
    run.add_argument("record", metavar="FILE", help="the record")
    run.add_argument("--ensemble", metavar="NAME", action="append", help="this ensemble alone; can be given again")
    run.add_argument("--since", metavar="S", type=moment, default=0.0, help="from second S of the record on (0)")
    run.add_argument("--until", metavar="S", type=moment, help="to second S of the record (its end)")
    for each in (policy, belief):
        each.add_argument("--seed", metavar="S", type=seed, default=0, help="of the simulated episodes (0)")
        add_false_negative(each)


def _kind(kinds: Any, name: str, summary: str, description: str, example: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = kinds.add_parser(
        name, help=summary, description=description, epilog=f"example: {example}"
    )
    parser.add_argument("-o", "--output", metavar="PNG", required=True, help="the picture's file")
    complete(parser, "plot", "mdm.cli.policies.plot")
    return parser


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument("policy", metavar="POLICY", help="a policy for it")
    add_discount(parser)
    add_discount_of(parser)


def add_simulate(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Run episodes of an ensemble in a world that its own model drives, in virtual time, and report the mean "
        "discounted return with its standard error. Functions of the file are not called. Ctrl-C ends it after the "
        "episode, with the mean so far."
    )
    parser = add_verb(verbs, "simulate", line, about, "mdm simulate tiger.pomdp tiger.vf --episodes 1000 --seed 1")
    add_file(parser, "a TOML file with ensembles")
    parser.add_argument("--ensemble", metavar="NAME", help="which of its ensembles; by default the first")
    parser.add_argument("--episodes", metavar="N", type=count, default=100, help="how many episodes (100)")
    parser.add_argument("--seed", metavar="S", type=seed, help="the same seed gives the same result")
    add_discount(parser)
    add_discount_of(parser)
    add_false_negative(parser)
    parser.add_argument("--steps", metavar="H", type=count, help="decisions in an episode")
    parser.add_argument(
        "--record",
        metavar="PATH",
        help="record all decisions, with the world's true states, to this file, such as run.mcap; a record "
        "there is kept, and run.2.mcap written",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "simulate", "mdm.cli.policies.simulate")


def add_solve(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Solve a model and print bounds on its value at the initial belief: the policy's value is at least the lower "
        "one, and no policy's exceeds the upper. It stops when the bounds are close, a limit is reached, or at Ctrl-C, "
        "SIGTERM or SIGHUP, and keeps the best policy so far."
    )
    parser = add_verb(verbs, "solve", line, about, "mdm solve tiger.pomdp -o tiger.npz --gap 0.01")
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
    add_discount_of(parser)
    add_durations(parser)
    parser.add_argument("--horizon", metavar="H", type=count, help="decisions, for solvers of finite horizons")
    add_false_negative(parser)
    parser.add_argument("--seed", metavar="S", type=seed, help="for randomised solvers")
    parser.add_argument(
        "--whole", action="store_const", const=True, help="keep all of SARSOP's vectors, not only those of a good plan"
    )
    parser.add_argument("--history", metavar="FILE.json", help="write the bounds over time, for mdm plot bounds")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "solve", "mdm.cli.policies.solve")


class _Solver(argparse.Action):
    """Takes the name of a solver, or lists them."""

    def __call__(self, parser: argparse.ArgumentParser, arguments: argparse.Namespace, name: Any, *_: object) -> None:
        from mdm.solvers import SOLVERS  # noqa: PLC0415 - what its help lists, no other verb needs

        if name == "help":
            for solver, entry in SOLVERS.items():
                print(f"{solver:28}for {entry[2]}s")
            print("\ndocs/solving.md says which suits which model")
            parser.exit()
        if name not in SOLVERS:
            parser.error(f"there is no solver {name!r}; there are {', '.join(SOLVERS)}")
        setattr(arguments, self.dest, name)
