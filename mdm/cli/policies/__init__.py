"""The verbs about solving, policies and their values, and their arguments."""

from __future__ import annotations

import argparse
from typing import Any

from mdm.cli.usage import (
    DEBUG,
    DISCOUNT,
    DISCOUNT_OF,
    DURATIONS,
    FALSE_NEGATIVE,
    JSON,
    SEED,
    WORKERS,
    Argument,
    Verb,
    count,
    given_file,
    limit,
    moment,
    seed,
)

__all__ = ["VERBS"]


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


def _picture(line: str, about: str, example: str, *arguments: Argument) -> Verb:
    """Return a kind of picture of the verb ``plot``."""
    file = Argument("-o --output PNG", "the picture's file", required=True)
    return Verb(about, example, (file, DEBUG, *arguments), "policies.plot", command="plot", line=line)


_MODEL, _POLICY = Argument("model MODEL", "a model"), Argument("policy POLICY", "a policy for it")
_VALUES = (
    Argument(
        "--episodes N",
        "simulate N episodes, even if the exact value is known (10000; 1000 if they cannot run as a batch)",
        count,
    ),
    Argument("--steps H", "decisions in an episode (no limit)", count),
    SEED,
    DISCOUNT,
    DISCOUNT_OF,
    DURATIONS,
    FALSE_NEGATIVE,
    *WORKERS,
    JSON,
)
"""The options that evaluation and comparison share."""
_INPUTS = (_MODEL, _POLICY, DISCOUNT, DISCOUNT_OF)
_DRAWN = (Argument("--seed S", "of the simulated episodes (0)", seed), FALSE_NEGATIVE)

VERBS = {
    "simulate": Verb(
        "Run episodes of an ensemble in a world that its own model drives, in virtual time, and report the mean "
        "discounted return with its standard error. Functions of the file are not called. Ctrl-C ends it after the "
        "episode, with the mean so far.",
        "mdm simulate tiger.pomdp tiger.vf --episodes 1000 --seed 1",
        (
            *given_file("a TOML file with ensembles"),
            Argument("--ensemble NAME", "which of its ensembles; by default the first"),
            Argument("--episodes N", "how many episodes (100)", count, default=100),
            SEED,
            DISCOUNT,
            DISCOUNT_OF,
            FALSE_NEGATIVE,
            Argument("--steps H", "decisions in an episode", count),
            Argument(
                "--record PATH",
                "record all decisions, with the world's true states, to this file, such as run.mcap; a record there is "
                "kept, and run.2.mcap written",
            ),
            *WORKERS,
            JSON,
        ),
        "policies.simulate",
    ),
    "solve": Verb(
        "Solve a model and print bounds on its value at the initial belief: the policy's value is at least the lower "
        "one, and no policy's exceeds the upper. It stops when the bounds are close, a limit is reached, or at Ctrl-C, "
        "SIGTERM or SIGHUP, and keeps the best policy so far.",
        "mdm solve tiger.pomdp -o tiger.npz --gap 0.01",
        (
            _MODEL,
            Argument(
                "-o --output POLICY",
                "the policy's file; its suffix chooses the format: .npz keeps any policy, .vf, .alpha and .policy "
                "alpha vectors, .policy tables, .pg controllers",
            ),
            Argument("--solver NAME", "by default chosen for the model; 'help' lists them", action=_Solver),
            Argument("--gap G", "stop when the bounds are this close (0.001)", limit, default=1e-3),
            Argument("--time S", "stop after S seconds; to lay out a large model takes what it takes", limit),
            Argument("--memory MB", "stop at this much memory (80 %% of the machine's)", limit),
            Argument("--iterations N", "stop after N sweeps, trials or rounds", count),
            DISCOUNT,
            DISCOUNT_OF,
            DURATIONS,
            Argument("--horizon H", "decisions, for solvers of finite horizons", count),
            FALSE_NEGATIVE,
            Argument("--seed S", "for randomised solvers", seed),
            Argument(
                "--whole",
                "keep all of SARSOP's vectors, not only those of a good plan",
                action="store_const",
                const=True,
            ),
            Argument("--history FILE.json", "write the bounds over time, for mdm plot bounds"),
            JSON,
        ),
        "policies.solve",
    ),
    "evaluate": Verb(
        "Compute the value of a policy at the initial belief of its model. Tables and controllers have an exact value. "
        "For policies over beliefs, print the value that they claim and an estimate from simulated episodes with a 95 "
        "% confidence interval, and whether the two contradict each other. Ctrl-C ends the simulation, with what is "
        "known by then.",
        "mdm evaluate tiger.pomdp tiger.vf --seed 1",
        (
            Argument("model MODEL", "a model, or a TOML file"),
            Argument("policy POLICY", "a policy for it, or the name of an ensemble of the file"),
            *_VALUES,
        ),
        "policies.evaluate",
    ),
    "verify": Verb(
        "Say how probable it is that a policy brings about what a specification says, or how soon or how often: at the "
        "initial belief, without any discount. Without a policy print the least and the greatest that are possible, "
        "over policies that see the state. Specifications: 'P(reach X)', 'P(reach X within 50)', 'P(reach X before "
        "Y)', 'P(always X)', 'E(steps until X)' and 'S(X)', the share of steps in the long run. X and Y are states, "
        "patterns of them (pit-*), values of factors (position = stairs), actions (action = Grab), and formulas of "
        "these with not, and, or. Policies over beliefs are simulated, and have an interval. Of a record, "
        "SPECIFICATION is a formula in time over predicates, as of a monitor: print whether it is true for ever, false "
        "for ever or open, and how a violation came about. The exit status is 1 where it is violated.",
        "mdm verify grid.mdp grid.npz 'P(reach pit-* before goal)'",
        (
            Argument("model MODEL", "a model, a TOML file, or a record"),
            Argument("policy [POLICY]", "a policy for it, or the name of an ensemble of the file"),
            Argument("specification SPECIFICATION", "what is asked, such as 'G(not Stairs)' of a record"),
            Argument("--from STATE", "begin in this state; by default at the model's initial belief", dest="start"),
            Argument("-o --output POLICY", "keep a policy that attains the least; its suffix chooses the format"),
            Argument("--greatest", "keep one that attains the greatest in its place"),
            Argument("--episodes N", "simulate N episodes (10000; 1000 if they cannot run as a batch)", count),
            Argument("--bounds S", "print bounds, too, by at most S seconds of the policy's belief graph", limit),
            SEED,
            FALSE_NEGATIVE,
            Argument("--config FILE.toml", "of a record without one: the configuration of its run"),
            JSON,
        ),
        "policies.verify",
    ),
    "compare": Verb(
        "Compare the values of several policies at the initial belief of a model. All are simulated with the same "
        "random numbers, so that their differences are known far better than their values. Differences are from the "
        "first policy, with their 95 % confidence.",
        "mdm compare tiger.pomdp tiger.vf tiger.npz --seed 1",
        (_MODEL, Argument("policies POLICY...", "policies for it; the first is the reference"), *_VALUES),
        "policies.evaluate:compare",
    ),
    "sweep": Verb(
        "Solve and evaluate a model for each point of a table of parameters, and write a row for each. Beside the "
        "result a journal, RESULTS.jsonl, has a line for each point that has ended: --resume does the others. A point "
        "that fails is a row that says why, and the exit status is 1. Ctrl-C keeps what has ended.",
        "mdm sweep sweep.toml -o results.csv --workers auto",
        (
            Argument("file SWEEP.toml", "the parameters, the solver's options, and how points are evaluated"),
            Argument("-o --output RESULTS", "the table: .csv, or .parquet (needs pyarrow)", required=True),
            Argument("--resume", "go on with the journal that is there"),
            *WORKERS,
            JSON,
        ),
        "policies.simulate:sweep",
    ),
    "plot": Verb(
        "Draw a picture (needs matplotlib); its file's suffix is .png, .svg or .pdf.",
        "mdm plot policy tiger.pomdp tiger.vf -o tiger.png",
        chosen=("picture", "PICTURE"),
        verbs={
            "bounds": _picture(
                "the bounds of solvers over time",
                "Draw the bounds over time of one or several runs, from the files of mdm solve --history.",
                "mdm plot bounds sarsop.json perseus.json -o bounds.png",
                Argument("histories HISTORY.json...", "a file written by mdm solve --history"),
            ),
            "policy": _picture(
                "the actions and values of a policy",
                "Draw the actions and values of a policy: over the states of an MDP or a factored model, as a grid of "
                "two factors, or over beliefs in two states.",
                "mdm plot policy tiger.pomdp tiger.vf -o tiger.png",
                *_INPUTS,
                Argument(
                    "--states A B",
                    "draw over beliefs in these two states; by default those that are most often confused",
                ),
                Argument("--axes DOWN ACROSS", "draw over these two factors of the state"),
                Argument("--columns N", "lay states without factors out in rows of N", count),
                Argument(
                    "--graph",
                    "draw SVG, as the page does: a table's decision diagram, a controller's graph, beliefs by action",
                    action="store_true",
                ),
                *_DRAWN,
            ),
            "belief": _picture(
                "a belief over an episode",
                "Draw the belief over one simulated episode, with true states, actions and observations.",
                "mdm plot belief tiger.pomdp tiger.vf -o belief.png --seed 1",
                *_INPUTS,
                Argument("--steps H", "decisions (25)", count, default=25),
                *_DRAWN,
            ),
            "sweep": _picture(
                "values over a parameter, from the result of a sweep",
                "Draw a column of a sweep's result over another, by its journal: values with their 95 %% confidence, "
                "and a line through the means of what has the same place. A sweep need not have ended.",
                "mdm plot sweep results.csv -x size --by rocks -o sweep.svg",
                Argument("results RESULTS", "the result of mdm sweep, beside its RESULTS.jsonl"),
                Argument("-x COLUMN", "to the right, such as a parameter", required=True),
                Argument("-y COLUMN", "upwards (value)", default="value"),
                Argument("--by COLUMN", "a line for each of its values"),
            ),
            "run": _picture(
                "a recorded run over time",
                "Draw the record of a run over time: the modes of each ensemble, its decisions, the lives of its "
                "actions, its faults, its belief, and the rewards since the start.",
                "mdm plot run run.mcap -o run.png --since 10 --until 20",
                Argument("record FILE", "the record"),
                Argument("--ensemble NAME", "this ensemble alone; can be given again", action="append"),
                Argument("--since S", "from second S of the record on (0)", moment, default=0.0),
                Argument("--until S", "to second S of the record (its end)", moment),
            ),
        },
    ),
}
