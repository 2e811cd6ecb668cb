"""The `mdm` command: one module per sub-command, each with ``add_parser`` and ``run``."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import warnings
from typing import TYPE_CHECKING

import mdm
from mdm.cli.usage import UsageError
from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["VERBS", "main"]

VERBS = (
    "run",
    "team",
    "check",
    "info",
    "show",
    "convert",
    "problem",
    "trace",
    "simulate",
    "solve",
    "evaluate",
    "compare",
    "plot",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command; return 0 (success), 1 (failure) or 2 (wrong usage)."""
    parser = argparse.ArgumentParser(
        prog="mdm",
        description=(
            "Put MDP and POMDP policies to work: run, trace and simulate decision processes; check, show and convert "
            "models and policies."
        ),
        epilog="example: mdm run examples/patrol/patrol.toml",
    )
    parser.add_argument("--version", action="version", version=f"mdm {mdm.__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for verb in VERBS:
        module = importlib.import_module(f"mdm.cli.{verb}")
        verb_parser: argparse.ArgumentParser = module.add_parser(verbs)
        if verb != "team":  # whose own verbs have it
            verb_parser.add_argument(
                "--debug", action="store_true", help="show the traceback of an error, and more in the log"
            )
            verb_parser.set_defaults(format_usage=verb_parser.format_usage, command=verb)
    try:
        parsed = parser.parse_args(arguments)
    except SystemExit as stop:
        _flush()
        return stop.code if isinstance(stop.code, int) else 2
    return _run(parsed)


def _run(parsed: argparse.Namespace) -> int:
    module = importlib.import_module(f"mdm.cli.{parsed.verb}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = _show_warning
            status = int(module.run(parsed))
            if sys.stdout is not None:
                sys.stdout.flush()  # here, where errors are reported
            return status
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        _flush()
        return 1
    except UsageError as error:
        print(f"{parsed.format_usage()}mdm {parsed.command}: error: {error}", file=sys.stderr)
        return 2
    except Exception as error:
        if parsed.debug:
            raise
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


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"mdm: warning: {message}", file=sys.stderr)
