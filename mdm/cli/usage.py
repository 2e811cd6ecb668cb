"""Usage errors and argument types that sub-commands share."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.errors import Error, ModelError

if TYPE_CHECKING:
    from mdm.models.units import Unit
    from mdm.team.transport.access import Access

__all__ = [
    "LATEST",
    "UsageError",
    "add_discount",
    "add_discount_of",
    "add_durations",
    "add_false_negative",
    "add_import",
    "add_live_page",
    "add_page_hosts",
    "add_verb",
    "certificate",
    "complete",
    "count",
    "finite",
    "limit",
    "moment",
    "port",
    "seconds",
    "seed",
]


LATEST = 10_000_000_000
"""Seconds beyond which nothing of a record is: some 300 years, which nanoseconds in 64 bits hold."""


class UsageError(Error):
    """The arguments are inconsistent; the command prints its usage and exits with 2."""


def add_verb(verbs: Any, name: str, line: str, about: str, example: str) -> argparse.ArgumentParser:
    """Add a verb with a line of help, what its own help says about it, and an example; return its parser."""
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=line, description=about, epilog=f"example: {example}")
    return parser


def complete(parser: argparse.ArgumentParser, command: str, module: str) -> None:
    """Add the options and settings of every verb to a parser: ``--debug``, its name in errors, usage and module."""
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error, and more in the log")
    parser.set_defaults(format_usage=parser.format_usage, command=command, module=module)


def add_file(parser: argparse.ArgumentParser, help: str) -> None:  # noqa: A002
    """Add a TOML file, or a model and its policy in its place, to a parser; `take_model` tells them apart."""
    parser.add_argument("file", metavar="FILE", nargs="?", help=f"{help}; or a model, before its policy")
    parser.add_argument("policy_file", metavar="POLICY", nargs="?", help="the policy, after a model")
    parser.add_argument("--model", metavar="M", help="a model, in place of a TOML file")
    parser.add_argument("--policy", metavar="P", help="a policy, in place of a TOML file")


def take_model(arguments: argparse.Namespace) -> None:
    """Take ``MODEL POLICY`` for ``--model MODEL --policy POLICY``.

    Raises:
        UsageError: If these are given, too.
    """
    if arguments.policy_file is None:
        return
    if arguments.model is not None or arguments.policy is not None:
        raise UsageError("a model and its policy are given by --model and --policy or without, and not both")
    arguments.model, arguments.policy, arguments.file = arguments.file, arguments.policy_file, None


def add_discount(parser: argparse.ArgumentParser, help: str = "overrides the model's") -> None:  # noqa: A002
    """Add the option ``--discount``."""
    parser.add_argument("--discount", metavar="G", type=_discount, help=help)


def _discount(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"a number above 0 and at most 1 was expected, not {text!r}")
    return number


def add_discount_of(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--discount-of``."""
    parser.add_argument(
        "--discount-of",
        metavar="UNIT",
        type=_unit,
        help="what the discount is of: step, second (where durations say how long a step takes), or the seconds of a "
        "step; by default as the model's file has it",
    )


def _unit(text: str) -> Unit:
    from mdm.models.units import checked_unit  # noqa: PLC0415 - for those who give a unit

    try:
        return checked_unit(text if text in ("step", "second") else float(text))  # type: ignore[arg-type]
    except (ModelError, ValueError):
        raise argparse.ArgumentTypeError(f"step, second, or the seconds of a step was expected, not {text!r}") from None


def add_durations(parser: argparse.ArgumentParser) -> None:
    """Add the option of how long actions take."""
    parser.add_argument(
        "--durations",
        metavar="FILE.npz",
        help="how long actions take, and what they earn by time: values are those in real time",
    )


def add_false_negative(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--false-negative``."""
    parser.add_argument(
        "--false-negative",
        metavar="O",
        help="the observation, by name or index, that is a false negative: an event that nobody detected",
    )


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--import``."""
    parser.add_argument(
        "--import",
        dest="imports",
        action="store_true",
        help="import the functions of a TOML file, which runs its modules",
    )


def add_live_page(parser: argparse.ArgumentParser, shows: str, whose: str) -> None:
    """Add the options of a page that shows a run live.

    Args:
        parser: The parser.
        shows: Says of which agents.
        whose: Says which certificate is taken where none is given.
    """
    parser.add_argument(
        "--page",
        metavar="PORT",
        nargs="?",
        type=port,
        const=8765,
        help=f"{shows} for this machine's browsers, at port PORT (8765)",
    )
    parser.add_argument(
        "--page-control",
        action="store_true",
        help="let the page start, stop, reset and release ensembles, and set predicates that no sensor tells",
    )
    add_page_hosts(parser, whose)


def add_page_hosts(parser: argparse.ArgumentParser, whose: str = "", *, prefix: str = "--page-") -> None:
    """Add the options that open a page to other machines.

    Args:
        parser: The parser.
        whose: Says which certificate is taken where none is given; empty for none.
        prefix: What the names of the options begin with.
    """
    parser.add_argument(
        f"{prefix}host",
        metavar="HOST",
        help="open the page to other machines, with TLS, at this name or address of this machine (0.0.0.0: at all)",
    )
    parser.add_argument(
        f"{prefix}access",
        metavar="FOLDER/NAME",
        type=certificate,
        help="the page's certificate: NAME.pem, NAME.key.pem and authority.pem of a folder" + (whose and f" ({whose})"),
    )


def certificate(text: str) -> Access:
    """Parse an argument as the certificate of a folder, by its name without a suffix."""
    from mdm.team.transport.access import access_of  # noqa: PLC0415 - only where it is asked for

    path = Path(text)
    if not path.name or (path.is_dir() and not Path(f"{path}.pem").exists()):
        raise argparse.ArgumentTypeError(
            f"FOLDER/NAME was expected, for NAME.pem, NAME.key.pem and authority.pem of that folder, not {text!r}"
        )
    return access_of(path.parent, path.name)


def finite(text: str) -> float | None:
    """Return a finite number, or None."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def count(text: str) -> int:
    """Parse an argument as a whole number of 1 or more."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"a whole number of 1 or more was expected, not {text!r}")
    return number


def port(text: str) -> int:
    """Parse an argument as a port, 0 for any that is free."""
    if not (text.isascii() and text.isdecimal() and int(text) < 65_536):
        raise argparse.ArgumentTypeError(f"a port, up to 65535, was expected, not {text!r}")
    return int(text)


def seed(text: str) -> int:
    """Parse an argument as a whole number of 0 or more."""
    try:
        number = int(text)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"a whole number of 0 or more was expected, not {text!r}")
    return number


def moment(text: str) -> float:
    """Parse an argument as a second of a record."""
    number = finite(text)
    if number is None or abs(number) > LATEST:
        raise argparse.ArgumentTypeError(f"a number of seconds was expected, not {text!r}")
    return number


def seconds(text: str) -> float:
    """Parse an argument as a number of seconds above 0."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < 1e9:
        raise argparse.ArgumentTypeError(f"a number of seconds above 0 was expected, not {text!r}")
    return number


def limit(text: str) -> float:
    """Parse an argument as a number of 0 or more, possibly infinite."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not number >= 0:
        raise argparse.ArgumentTypeError(f"a number of 0 or more was expected, not {text!r}")
    return number
