"""The arguments of verbs, as data: their types, and those that several verbs share."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mdm.errors import Error, ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.models.units import Unit
    from mdm.team.transport.access import Access

LATEST = 10_000_000_000
"""Seconds beyond which nothing of a record is: some 300 years, which nanoseconds in 64 bits hold."""


class UsageError(Error):
    """The arguments are inconsistent; the command prints its usage and exits with 2."""


class Argument:
    """An argument of a verb: with its help, the function that parses its text, and more options of argparse.

    The words are the names of an option and of its value, as ``-o --output FILE``; without a value it is a flag. Of
    a positional argument they are its name and how the usage calls it: ``model MODEL``; ``[MODEL]`` may be left out,
    ``MODEL...`` stands for one or more.

    Attributes:
        names: Its names, as argparse has them.
        options: All that argparse takes beside.
        exclusive: Whether it stands in the place of others that are.
    """

    def __init__(
        self,
        words: str,
        help: str | None,  # noqa: A002
        type: Callable[[str], Any] | None = None,  # noqa: A002
        *,
        exclusive: bool = False,
        **options: Any,
    ) -> None:
        parts = words.split()
        self.names = tuple(part for part in parts if part.startswith("-")) or (parts[0],)
        metavars = parts[len(self.names) :]
        made: dict[str, Any] = {"help": help}
        if not metavars:
            made["action"] = "store_true"
        elif len(metavars) > 1:
            made |= {"metavar": tuple(metavars), "nargs": len(metavars)}
        elif metavars[0].startswith("["):
            made |= {"metavar": metavars[0][1:-1], "nargs": "?"}
        else:
            many = metavars[0].endswith("...")
            made |= {"metavar": metavars[0].removesuffix("..."), "nargs": "+" if many else None}
        self.options = made | options | ({} if type is None else {"type": type})
        self.exclusive = exclusive


class Verb(NamedTuple):
    """A verb, or one below it.

    Args:
        about: Its purpose, as its help says.
        example: A command line.
        arguments: Its arguments.
        runs: The module, below ``mdm.cli``, whose function `run` is called, or ``module:function``.
        line: Its line in the help of the verb above it.
        verbs: The verbs below it.
        chosen: Where the parsed arguments keep the verb below it, and how the usage calls it.
        command: Its name in errors; by default the words of the command line.
        usage: The line of its usage, where argparse's does not do.
        settings: More attributes of the parsed arguments.
    """

    about: str
    example: str
    arguments: tuple[Argument, ...] = ()
    runs: str = ""
    line: str = ""
    verbs: Mapping[str, Verb] = {}
    chosen: tuple[str, str] = ("", "")
    command: str = ""
    usage: str | None = None
    settings: Mapping[str, Any] = {}

    @property
    def all_arguments(self) -> tuple[Argument, ...]:
        """Its arguments with ``--debug``, which is the last one where the verb does not say another place."""
        return self.arguments if self.verbs or DEBUG in self.arguments else (*self.arguments, DEBUG)


def add_verb(verbs: Any, name: str, line: str, verb: Verb, *, command: str = "") -> None:
    """Add a verb and all below it to the verbs of a parser, each with ``--debug`` and the command's settings."""
    about, example = verb.about, f"example: {verb.example}"
    parser = verbs.add_parser(name, help=line, usage=verb.usage, description=about, epilog=example)
    command = verb.command or f"{command} {name}".lstrip()
    if verb.verbs:
        kinds = parser.add_subparsers(dest=verb.chosen[0], metavar=verb.chosen[1], required=True)
        for each, below in verb.verbs.items():
            add_verb(kinds, each, below.line, below, command=command)
        return
    group: Any = None
    for argument in verb.all_arguments:
        if argument.exclusive and group is None:
            group = parser.add_mutually_exclusive_group()
        (group if argument.exclusive else parser).add_argument(*argument.names, **argument.options)
    parser.set_defaults(format_usage=parser.format_usage, command=command, runs=verb.runs, **verb.settings)


def finite(text: str) -> float | None:
    """Return a finite number, or None."""
    try:
        found = float(text)
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def number(
    expected: str,
    least: float,
    most: float = math.inf,
    *,
    kind: Callable[[str], Any] = float,
    apart: tuple[float, ...] = (),
    be: str = "was",
) -> Callable[[str], Any]:
    """Return a parser of numbers from the least to the most, but for those ends that are apart.

    Another text is refused with the words for the expected numbers, and their verb.
    """

    def read(text: str) -> Any:
        try:
            found = kind(text)
        except ValueError:
            found = math.nan
        if not least <= found <= most or found in apart:
            raise argparse.ArgumentTypeError(f"{expected} {be} expected, not {text!r}")
        return found

    return read


count = number("a whole number of 1 or more", 1, kind=int)
seed = number("a whole number of 0 or more", 0, kind=int)
moment = number("a number of seconds", -LATEST, LATEST)
seconds = number("a number of seconds above 0", 0, 1e9, apart=(0, 1e9))
limit = number("a number of 0 or more", 0)
share = number("a number above 0 and at most 1", 0, 1, apart=(0,))


def port(text: str) -> int:
    """Parse an argument as a port, 0 for any that is free."""
    if not (text.isascii() and text.isdecimal() and int(text) < 65_536):
        raise argparse.ArgumentTypeError(f"a port, up to 65535, was expected, not {text!r}")
    return int(text)


def certificate(text: str) -> Access:
    """Parse an argument as the certificate of a folder, by its name without a suffix."""
    from mdm.team.transport.access import access_of  # noqa: PLC0415 - only where it is asked for

    path = Path(text)
    if not path.name or (path.is_dir() and not Path(f"{path}.pem").exists()):
        raise argparse.ArgumentTypeError(
            f"FOLDER/NAME was expected, for NAME.pem, NAME.key.pem and authority.pem of that folder, not {text!r}"
        )
    return access_of(path.parent, path.name)


def _unit(text: str) -> Unit:
    from mdm.models.units import checked_unit  # noqa: PLC0415 - for those who give a unit

    try:
        return checked_unit(text if text in ("step", "second") else float(text))  # type: ignore[arg-type]
    except (ModelError, ValueError):
        raise argparse.ArgumentTypeError(f"step, second, or the seconds of a step was expected, not {text!r}") from None


def _workers(text: str) -> Any:
    return text if text == "auto" else number("auto or a whole number of 0 or more", 0, kind=int)(text)


DEBUG = Argument("--debug", "show the traceback of an error, and more in the log")
JSON = Argument("--json", "one JSON object")
SEED = Argument("--seed S", "the same seed gives the same result", seed)
DISCOUNT = Argument("--discount G", "overrides the model's", share)
DISCOUNT_OF = Argument(
    "--discount-of UNIT",
    "what the discount is of: step, second (where durations say how long a step takes), or the seconds of a step; by "
    "default as the model's file has it",
    _unit,
)
DURATIONS = Argument(
    "--durations FILE.npz", "how long actions take, and what they earn by time: values are those in real time"
)
FALSE_NEGATIVE = Argument(
    "--false-negative O",
    "the observation, by name or index, that is a false negative: an event that nobody detected",
)
WORKERS = (
    Argument(
        "--workers N",
        "work in N processes here, auto for one on each processor; 0 (the default) in the command's own",
        _workers,
        default=0,
    ),
    Argument("--dask ADDRESS", "work on the workers of the Dask scheduler at this address, or of its file"),
)
IMPORT = Argument("--import", "import the functions of a TOML file, which runs its modules", dest="imports")


def given_file(help: str) -> tuple[Argument, ...]:  # noqa: A002
    """Return the arguments for a TOML file, or a model and its policy in its place; `take_model` tells them apart."""
    return (
        Argument("file [FILE]", f"{help}; or a model, before its policy"),
        Argument("policy_file [POLICY]", "the policy, after a model"),
        Argument("--model M", "a model, in place of a TOML file"),
        Argument("--policy P", "a policy, in place of a TOML file"),
    )


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


def live_page(shows: str, whose: str) -> tuple[Argument, ...]:
    """Return the options of a page that shows a run live; the texts say of which agents, and whose certificate."""
    return (
        Argument("--page [PORT]", f"{shows} for this machine's browsers, at port PORT (8765)", port, const=8765),
        Argument(
            "--page-control",
            "let the page start, stop, reset and release ensembles, and set predicates that no sensor tells",
        ),
        *page_hosts(whose),
    )


def page_hosts(whose: str = "", *, prefix: str = "--page-") -> tuple[Argument, ...]:
    """Return the options that open a page to other machines; a text says whose certificate is shown by default."""
    files = "the page's certificate: NAME.pem, NAME.key.pem and authority.pem of a folder"
    return (
        Argument(
            f"{prefix}host HOST",
            "open the page to other machines, with TLS, at this name or address of this machine (0.0.0.0: at all)",
        ),
        Argument(f"{prefix}access FOLDER/NAME", files + (whose and f" ({whose})"), certificate),
    )
