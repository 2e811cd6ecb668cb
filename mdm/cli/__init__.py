"""The `mdm` command: a folder for each group of verbs, with their arguments, and a module for each.

Exit statuses are those of its help: 0, 1 for a failure, 2 for wrong usage, 128 and more for a signal.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
import warnings
from typing import TYPE_CHECKING

import mdm
from mdm.cli.interruption import Interruption
from mdm.cli.usage import UsageError, add_verb
from mdm.compilation import COMPILE_TIME
from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

__all__ = ["VERBS", "main", "make_parser"]

VERBS = {
    "run": ("robots", "run the ensembles of a TOML file, or one agent of a team's"),
    "team": ("team", "run a team, and ask it how it is"),
    "ros2": ("robots", "say what of ROS 2 a file needs, and whether it is there"),
    "check": ("files", "list all problems of an ensemble, model or policy file"),
    "info": ("files", "describe the content of a file"),
    "show": ("files", "show a row of a model by names, or its network"),
    "convert": ("files", "write a model or policy in another format"),
    "problem": ("files", "write a standard problem of the field as a model"),
    "trace": ("robots", "print the decisions for a sequence of stimuli"),
    "latency": ("robots", "measure how long decisions take here, with a system of one's own"),
    "simulate": ("policies", "simulate a policy in its model and print the mean return"),
    "solve": ("policies", "compute a policy for a model, certified by bounds"),
    "evaluate": ("policies", "compute the value of a policy, exactly or by simulation"),
    "verify": ("policies", "say how probable it is that a policy does something wrong"),
    "compare": ("policies", "compare the values of several policies"),
    "sweep": ("policies", "solve and evaluate a model for each point of a table of parameters"),
    "plot": ("policies", "draw bounds over time, a policy, a belief over an episode, a sweep, or a recorded run"),
    "replay": ("records", "run what a record has once more, and compare every decision"),
    "explain": ("records", "say why a decision in a record was made"),
    "statistics": ("records", "say from records how good a model is, and re-estimate it"),
    "record": ("records", "describe, print, export and repair the record of a run"),
    "page": ("records", "show the record of a run on a page for this machine's browsers"),
    "watch": ("records", "watch a running system, or a record, in the terminal"),
    "map": ("map", "propose, draft, check and show the map of a floor, and make a model from it"),
    "new": ("projects", "make a small project that runs, and has a test"),
    "examples": ("projects", "list the examples, or copy one of them"),
    "import-ros1": ("projects", "take over a package of the original MDM for ROS"),
    "completion": ("projects", "print what lets a shell complete the arguments of mdm"),
}
"""The verbs: the folder of each, which declares its arguments, and a line of help."""


def make_parser(verbs: Collection[str] = tuple(VERBS), *, lines_alone: bool = False) -> argparse.ArgumentParser:
    """Return the parser of the command.

    Args:
        verbs: Whose arguments it has; each loads the folder of its verb.
        lines_alone: Only a line of help for each verb, which loads nothing.
    """
    parser = argparse.ArgumentParser(
        prog="mdm",
        description=(
            "Put MDP and POMDP policies to work: run, trace and simulate decision processes;\ncheck, show and convert "
            "models and policies."
        ),
        epilog=(
            "example: mdm run examples/patrol/patrol.toml\n\n"
            "exit status: 0 what was asked is done; 1 it failed, as a sentence on standard error says; 2 wrong usage;\n"
            "130 ended by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP: what was printed or written then is the result so far"
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mdm {mdm.__version__}")
    added = parser.add_subparsers(dest="verb", metavar="VERB")
    for verb in verbs:
        folder, line = VERBS[verb]
        if lines_alone:
            added.add_parser(verb, help=line)
        else:
            add_verb(added, verb, line, importlib.import_module(f"mdm.cli.{folder}").VERBS[verb])
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; return 0 (success), 1 (failure), 2 (wrong usage), or 130 (Ctrl-C)."""
    interruption = Interruption()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # As standard error does: a terminal that lacks a character of a table or a name is no failure.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        return _main(arguments, interruption)
    except KeyboardInterrupt:
        return interruption.status


def _main(arguments: Sequence[str] | None, interruption: Interruption) -> int:
    words = sys.argv[1:] if arguments is None else arguments
    # Who names a verb waits for no other; what is no verb is told of with all of them.
    parser = make_parser(
        words[:1] if words and words[0] in VERBS else VERBS,
        lines_alone=not words or words[0] in {"-h", "--help", "--version"},
    )
    try:
        parsed, unknown = parser.parse_known_args(arguments)
        if parsed.verb is None and not unknown:
            parser.print_help()
            _flush()
            return 0
    except SystemExit as stop:
        _flush()
        return stop.code if isinstance(stop.code, int) else 2
    except OSError as error:  # what an option has printed goes nowhere
        _flush()
        if not isinstance(error, BrokenPipeError):
            print(f"mdm: {_sentence(error)}", file=sys.stderr)
        return 1
    if parsed.verb is None:
        parsed.command, parsed.format_usage = "", parser.format_usage
    if parsed.verb == "verify" and parsed.policy is None and len(unknown) == 1 and not unknown[0].startswith("-"):
        # Before an option between the arguments argparse takes the one that may be left out for left out.
        parsed.policy, parsed.specification, unknown = parsed.specification, unknown[0], []
    if unknown:
        return _refuse(parsed, f"there is no argument {' or '.join(unknown)}")
    parsed.interruption = interruption
    return _run(parsed)


def _refuse(parsed: argparse.Namespace, why: object) -> int:
    """Print the error of usage; return its status."""
    print(f"{parsed.format_usage()}{f'mdm {parsed.command}'.rstrip()}: error: {why}", file=sys.stderr)
    return 2


def _run(parsed: argparse.Namespace) -> int:
    from mdm.cli.progress import work_shown  # noqa: PLC0415 - help shows none

    try:
        module, _, function = parsed.runs.partition(":")
        run = getattr(importlib.import_module(f"mdm.cli.{module}"), function or "run")
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = _show_warning
            with COMPILE_TIME.told(lambda: _tell_of_compilation(parsed.command)), work_shown():
                status = int(run(parsed))
            if sys.stdout is not None:
                sys.stdout.flush()  # here, where errors are reported
            return status
    except BrokenPipeError:
        _flush()
        return 1
    except UsageError as error:
        return _refuse(parsed, error)
    except Exception as error:
        if parsed.debug:
            raise
        if _follows_interrupt(error):
            return int(parsed.interruption.status)
        _flush()
        print(f"mdm {parsed.command}: {_sentence(error)}", file=sys.stderr)
        return 1


def _flush() -> None:
    """Flush standard output, or discard it: otherwise Python tries again at exit and complains."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _follows_interrupt(error: BaseException | None) -> bool:
    """Return whether an error stems from Ctrl-C in code that it broke off, such as an import."""
    known: list[BaseException] = []  # an error raised again is in its own context
    while error is not None and error not in known:
        if isinstance(error, KeyboardInterrupt):
            return True
        known.append(error)
        error = error.__cause__ or error.__context__
    return False


def _sentence(error: Exception) -> str:
    from mdm.runtime import ActorFailure  # noqa: PLC0415 - `mdm --help` needs no numpy

    while isinstance(error, ActorFailure) and isinstance(error.__cause__, ActorFailure):
        error = error.__cause__  # the first failure says more than those that follow from it
    if isinstance(error, Error):
        return str(error)
    if isinstance(error, MemoryError):
        return "the model is too large for this machine's memory"
    if isinstance(error, OSError):
        return f"{error.filename}: {error.strerror}" if error.filename else f"{error.strerror or error}"
    return f"unexpected {type(error).__name__}: {error} (--debug shows where)"


def _tell_of_compilation(command: str) -> None:
    if sys.stderr is None:
        return
    start = "\r\x1b[K" if sys.stderr.isatty() else ""  # in place of a line of progress
    print(f"{start}mdm {command}: compiling, once on this machine; it takes some seconds", file=sys.stderr, flush=True)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"mdm: warning: {message}", file=sys.stderr)
