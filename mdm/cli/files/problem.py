"""``mdm problem``: standard problems as model files, with the parameters of their functions."""

from __future__ import annotations

import argparse
import difflib
import inspect
import json
import re
import shlex
import textwrap
from typing import TYPE_CHECKING, Any

import msgspec

from mdm import problems
from mdm.cli.usage import UsageError
from mdm.errors import ModelError
from mdm.formats import save_model

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models import MDP

_KINDS = {int: ("N", "a whole number"), float: ("X", "a number"), str: ("TEXT", "a text")}


def run(arguments: argparse.Namespace) -> int:
    """List the problems, or write one; return the exit status."""
    if arguments.list or not arguments.words:
        if arguments.words:
            raise UsageError("--list goes without the name of a problem")
        _list()
        return 0
    name = arguments.words[0].replace("-", "_")
    if name not in problems.__all__:
        close = difflib.get_close_matches(name, problems.__all__, n=3)
        hint = f"did you mean {' or '.join(close)}?" if close else "`mdm problem` lists them"
        raise UsageError(f"there is no problem {arguments.words[0]!r}; {hint}")
    function: Callable[..., MDP] = getattr(problems, name)
    parser = _parser(function)
    if len(arguments.words) > 1 and not arguments.words[1].startswith("-"):
        options = [_option(name) for name in inspect.signature(function).parameters]
        value = arguments.words[1]
        raise UsageError(f"parameters are given by name, such as {options[0]} {value}: there are {', '.join(options)}")
    try:
        given = vars(parser.parse_args(arguments.words[1:]))
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    target = given.pop("output")
    arguments.debug |= given.pop("debug")
    arguments.format_usage = parser.format_usage
    arguments.command = f"problem {function.__name__}"
    try:
        model = function(**given)
    except ModelError as error:
        raise UsageError(str(error)) from error
    except OverflowError:
        raise UsageError("a parameter is too large a number") from None
    save_model(model, target)
    sizes = [(len(model.state_space), "states"), (len(model.action_space), "actions")]
    if model.observation_space is not None:
        sizes.append((len(model.observation_space), "observations"))
    print(f"{target}: a model ({model.kind}) of {', '.join(f'{count} {what}' for count, what in sizes)}")
    return 0


def _parser(function: Callable[..., MDP]) -> argparse.ArgumentParser:
    """Return a parser for a problem's parameters, made from its signature and docstring."""
    text, meanings = _documentation(function)
    parser = argparse.ArgumentParser(
        prog=f"mdm problem {function.__name__}",
        description=text.replace("%", "%%"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=f"example: mdm problem {function.__name__} -o {function.__name__}.npz",
        allow_abbrev=False,
    )
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="the model to write")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        default = "" if parameter.default is None else f" Default: {_shown(parameter.default)}"
        parser.add_argument(
            _option(parameter.name),
            dest=parameter.name,
            metavar=_kind(parameter.annotation)[0],
            type=_reader(parameter.annotation),
            default=argparse.SUPPRESS,
            help=f"{meanings[parameter.name]}{default}".replace("%", "%%"),
        )
    return parser


def _list() -> None:
    for name in problems.__all__:
        function = getattr(problems, name)
        print(f"{name}: {_documentation(function)[0].splitlines()[0]}")
        for parameter in inspect.signature(function).parameters.values():
            value = "..." if parameter.default is None else _shown(parameter.default)
            print(f"    {_option(parameter.name)} {value}")


def _documentation(function: Callable[..., MDP]) -> tuple[str, dict[str, str]]:
    """Return the description of a problem and of each argument from its docstring."""
    text, _, sections = inspect.cleandoc(function.__doc__ or "").partition("\n\nArgs:\n")
    arguments = sections.partition("\n\n")[0]
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", arguments, re.MULTILINE)
    return text.removeprefix("Return "), {name: " ".join(meaning.split()) for name, meaning in entries}


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _shown(default: object) -> str:
    """Return a default in the form in which a user types it."""
    if isinstance(default, str):
        return shlex.quote(textwrap.dedent(default).strip("\n").replace("\n", "/"))
    return shlex.quote(json.dumps(default))


def _kind(annotation: Any) -> tuple[str, str]:
    """Return the name of a type's values in a usage line and in a sentence."""
    return _KINDS.get(annotation, ("JSON", "a list in JSON, of the right length and numbers,"))


def _reader(annotation: Any) -> Callable[[str], Any]:
    """Return a parser for values of a type: numbers and texts directly, everything else as JSON."""

    def read(text: str) -> Any:
        try:
            return annotation(text) if annotation in _KINDS else msgspec.json.decode(text, type=annotation)
        except (ValueError, msgspec.MsgspecError):
            raise argparse.ArgumentTypeError(f"{_kind(annotation)[1]} was expected, not {text!r}") from None

    return read
