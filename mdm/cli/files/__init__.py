"""The verbs about files of models, policies and ensembles, and their arguments."""

from __future__ import annotations

import argparse

from mdm.cli.usage import DISCOUNT_OF, DURATIONS, IMPORT, JSON, Argument, Verb, share

__all__ = ["VERBS"]

_PARTS = ("T", "O", "R", "start", "network")

VERBS = {
    "check": Verb(
        "Check a file: an ensemble's TOML file, a model or a policy. All problems are listed at once, those of one "
        "kind by the first few and their number; notes list what is allowed but odd: states that cannot be reached or "
        "left, observations that never occur, actions that change nothing; of a TOML file, with line and column, "
        "unlikely times and rates, values that hold together, sensors and actions without a use. Functions that a "
        "TOML file names are looked for in the source of their modules, which are not run, unless --import is given. "
        "FILE.py:FUNCTION runs that function, and checks the ensembles or the System that it returns.",
        "mdm check examples/patrol/patrol.toml",
        (
            Argument("file FILE", "a TOML file, a model, a policy, or FILE.py:FUNCTION"),
            Argument("--model M", "the model that a policy is for, to check it against"),
            DURATIONS,
            Argument("--normalize", "take distributions that do not sum to 1 for notes, not problems"),
            IMPORT,
            Argument("--live", "of a file with a table [ros2], also look for 5 s whether ROS has what it names"),
            Argument("--json", "one JSON object, with every problem"),
        ),
        "files.check",
    ),
    "info": Verb(
        "Print the sizes and names of a model or policy, or the tree of a TOML file's ensembles and which predicate, "
        "event or function stands for each symbol. Modules of functions are not run, unless --import is given.",
        "mdm info examples/patrol/top.pomdpx --json",
        (Argument("file FILE", "a model, a policy or a TOML file"), IMPORT, JSON),
        "files.info",
    ),
    "show": Verb(
        "Show what a model says, by names or indices (a joint symbol as one argument, its parts with blanks between): "
        "T ACTION STATE, where an action leads; O ACTION NEXT-STATE, what is observed then (with --from the state "
        "before, for events); R ACTION [STATE [NEXT-STATE [OBSERVATION]]], rewards; start, the initial belief; "
        "network, what depends on what in a factored model. Zeros are left out.",
        "mdm show tiger.pomdp O listen tiger-left",
        (
            Argument("file MODEL", "a model"),
            Argument("part [PART]", f"one of {', '.join(_PARTS)}", choices=_PARTS),
            Argument("symbols SYMBOL", "names or indices", nargs="*"),
            Argument("--from STATE", "the state before, for observations of events", dest="before"),
            Argument("--picture PNG", "draw the network into a file (needs matplotlib)"),
            JSON,
        ),
        "files.show",
    ),
    "convert": Verb(
        "Read a model or a policy and write it in the format that the name of the second file asks for: .pomdp, .mdp, "
        ".dpomdp, .pgmx, .pomdpx (each with .gz, too) or .npz for models; .alpha, .vf, .pg, .policy or .npz for "
        "policies. What was written is read again and compared.",
        "mdm convert tiger.pomdp tiger.pomdpx",
        (
            Argument("source IN", "a model or a policy"),
            Argument("target OUT", "the file to write, another than IN; one that is there is replaced"),
            Argument("--discount G", "a discount in place of the model's", share),
            DISCOUNT_OF,
            Argument("--normalize", "make distributions sum to 1 however far they are off"),
            Argument("--model M", "the model that a policy is for, whose names .npz keeps"),
        ),
        "files.convert",
    ),
    "problem": Verb(
        "Write a standard problem as a model, in the format of the file's suffix. Without a name, list the problems "
        "and their parameters; `mdm problem NAME --help` explains one.",
        "mdm problem rock_sample --size 4 --rocks 3 -o rocks.pomdpx",
        (
            Argument("--list", "list the problems and their parameters"),
            Argument("words NAME", "the problem and its parameters", nargs=argparse.REMAINDER, metavar="NAME ..."),
        ),
        "files.problem",
        usage="mdm problem [--list] | NAME [--PARAMETER VALUE ...] -o FILE",
    ),
}
