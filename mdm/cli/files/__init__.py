"""The arguments of the verbs about models, policies and other files."""

from __future__ import annotations

import argparse
from typing import Any

from mdm.cli.usage import add_discount, add_discount_of, add_durations, add_import, add_verb, complete


def add_check(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Check a file: an ensemble's TOML file, a model or a policy. All problems are listed at once, those of one "
        "kind by the first few and their number; notes list what is allowed but odd: states that cannot be reached or "
        "left, observations that never occur, actions that change nothing. Functions that a TOML file names are looked "
        "for in the source of their modules, which are not run, unless --import is given."
    )
    parser = add_verb(verbs, "check", line, about, "mdm check examples/patrol/patrol.toml")
    parser.add_argument("file", metavar="FILE", help="a TOML file, a model or a policy")
    parser.add_argument("--model", metavar="M", help="the model that a policy is for, to check it against")
    add_durations(parser)
    parser.add_argument(
        "--normalize", action="store_true", help="take distributions that do not sum to 1 for notes, not problems"
    )
    add_import(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object, with every problem")
    complete(parser, "check", "mdm.cli.files.check")


def add_convert(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Read a model or a policy and write it in the format that the name of the second file asks for: .pomdp, .mdp, "
        ".dpomdp, .pgmx, .pomdpx (each with .gz, too) or .npz for models; .alpha, .vf, .pg, .policy or .npz for "
        "policies. What was written is read again and compared."
    )
    parser = add_verb(verbs, "convert", line, about, "mdm convert tiger.pomdp tiger.pomdpx")
    parser.add_argument("source", metavar="IN", help="a model or a policy")
    parser.add_argument(
        "target", metavar="OUT", help="the file to write, another than IN; one that is there is replaced"
    )
    add_discount(parser, "a discount in place of the model's")
    add_discount_of(parser)
    parser.add_argument("--normalize", action="store_true", help="make distributions sum to 1 however far they are off")
    parser.add_argument("--model", metavar="M", help="the model that a policy is for, whose names .npz keeps")
    complete(parser, "convert", "mdm.cli.files.convert")


def add_info(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Print the sizes and names of a model or policy, or the tree of a TOML file's ensembles and which predicate, "
        "event or function stands for each symbol. Modules of functions are not run, unless --import is given."
    )
    parser = add_verb(verbs, "info", line, about, "mdm info examples/patrol/top.pomdpx --json")
    parser.add_argument("file", metavar="FILE", help="a model, a policy or a TOML file")
    add_import(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "info", "mdm.cli.files.info")


def add_problem(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "problem",
        help=line,
        usage="mdm problem [--list] | NAME [--PARAMETER VALUE ...] -o FILE",
        description=(
            "Write a standard problem as a model, in the format of the file's suffix. Without a name, list "
            "the problems and their parameters; `mdm problem NAME --help` explains one."
        ),
        epilog="example: mdm problem rock_sample --size 4 --rocks 3 -o rocks.pomdpx",
    )
    parser.add_argument("--list", action="store_true", help="list the problems and their parameters")
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="NAME ...", help="the problem and its parameters")
    complete(parser, "problem", "mdm.cli.files.problem")


_PARTS = ("T", "O", "R", "start", "network")


def add_show(verbs: Any, line: str) -> None:
    """Add the verb and its arguments."""
    about = (
        "Show what a model says, by names or indices (a joint symbol as one argument, its parts with blanks between): "
        "T ACTION STATE, where an action leads; O ACTION NEXT-STATE, what is observed then (with --from the state "
        "before, for events); R ACTION [STATE [NEXT-STATE [OBSERVATION]]], rewards; start, the initial belief; "
        "network, what depends on what in a factored model. Zeros are left out."
    )
    parser = add_verb(verbs, "show", line, about, "mdm show tiger.pomdp O listen tiger-left")
    parser.add_argument("file", metavar="MODEL", help="a model")
    parser.add_argument("part", choices=_PARTS, nargs="?", metavar="PART", help=f"one of {', '.join(_PARTS)}")
    parser.add_argument("symbols", metavar="SYMBOL", nargs="*", help="names or indices")
    parser.add_argument("--from", metavar="STATE", dest="before", help="the state before, for observations of events")
    parser.add_argument("--picture", metavar="PNG", help="draw the network into a file (needs mdm[plot])")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    complete(parser, "show", "mdm.cli.files.show")
