"""``mdm completion``: scripts by which shells complete the arguments of the command, made from the tables of its verbs.

A shell asks for its script at each start. So the names of problems and solvers are read from the sources of their
modules, which are not imported: that would load numpy.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import mdm
from mdm.cli import VERBS
from mdm.cli.projects.examples import EXAMPLES

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from mdm.cli.usage import Verb


Option = tuple[tuple[str, ...], str, bool, tuple[str, ...]]
"""The names of an option, a line of help, whether it takes a value, and the values if they are known."""

_HELP: Option = (("-h", "--help"), "show this help message and exit", False, ())


class Command(NamedTuple):
    """A verb, or the command itself, as shells see it.

    Args:
        words: The verb with those before it, such as ``mdm map draft``.
        verbs: Its own verbs, each with a line of help.
        options: Its options.
        values: The values of its first positional argument, if they are known.
    """

    words: str
    verbs: dict[str, str]
    options: list[Option]
    values: tuple[str, ...]


def run(arguments: argparse.Namespace) -> int:
    """Print the script of a shell; return the exit status."""
    print(_SCRIPTS[arguments.shell](list(commands())))
    return 0


def commands() -> Iterator[Command]:
    """Yield the command and all its verbs."""
    version = (("--version",), "show program's version number and exit", False, ())
    yield Command("mdm", {verb: _text(line) for verb, (_, line) in VERBS.items()}, [_HELP, version], ())
    for name, (folder, _) in VERBS.items():
        verb: Verb = importlib.import_module(f"mdm.cli.{folder}").VERBS[name]
        yield from _commands(f"mdm {name}", verb)


def _commands(words: str, verb: Verb) -> Iterator[Command]:
    """Yield a verb and all below it."""
    verbs = {name: _text(below.line) for name, below in verb.verbs.items()}
    options: list[Option] = [_HELP]
    values: tuple[str, ...] = ()
    for each in verb.all_arguments:
        names, given = each.names, each.options
        known = _values(words, names[-1].strip("-"), given)
        if names[0].startswith("-"):
            takes = given.get("action") not in {"store_true", "store_const"}
            options.append((names, _text(given["help"]), takes, known))
        else:
            values = values or known
    problems = list(_problems(words)) if words == "mdm problem" else []
    verbs |= {problem.words.removeprefix("mdm problem "): line for problem, line in problems}
    yield Command(words, verbs, options, values)
    yield from (problem for problem, _ in problems)
    for name, below in verb.verbs.items():
        yield from _commands(f"{words} {name}", below)


def _values(words: str, name: str, given: dict[str, Any]) -> tuple[str, ...]:
    """Return the values that an argument may have; none if they are not known."""
    if words == "mdm solve" and name == "solver":
        return (*_declared(_sources("solvers", "solve.py"), "SOLVERS"), "help")
    if words == "mdm examples" and name == "name":
        return tuple(EXAMPLES)
    if "choices" in given:
        return tuple(given["choices"])
    metavar = given.get("metavar")
    forms = metavar.split("|") if isinstance(metavar, str) else ()  # such as event|RATE
    return tuple(form for form in forms if form.islower())


def _problems(words: str) -> Iterator[tuple[Command, str]]:
    """Yield each problem as a command with its parameters as options, and a line about it."""
    names = _declared(_sources("problems", "__init__.py"), "__all__")
    found = {node.name: node for node in _sources("problems", "*.py") if isinstance(node, ast.FunctionDef)}
    common: list[Option] = [
        (("-o", "--output"), "the model to write", True, ()),
        (("-h", "--help"), "explain the problem and its parameters", False, ()),
        (("--debug",), "show the traceback of an error", False, ()),
    ]
    for name in names:
        given = found[name].args
        parameters = [argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
        line = (ast.get_docstring(found[name]) or "").partition("\n")[0].removeprefix("Return ")
        own = [f"--{parameter.replace('_', '-')}" for parameter in parameters]
        yield Command(f"{words} {name}", {}, [*common, *(((option,), "", True, ()) for option in own)], ()), line


def _sources(package: str, pattern: str) -> list[ast.stmt]:
    """Return the statements of a package's modules."""
    paths = sorted((Path(inspect.getfile(mdm)).parent / package).glob(pattern))
    return [node for path in paths for node in ast.parse(path.read_text(encoding="utf-8")).body]


def _declared(statements: list[ast.stmt], name: str) -> Any:
    """Return the list or table of literals that is assigned to a name."""
    for node in statements:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            return ast.literal_eval(node.value)  # type: ignore[attr-defined]
    raise LookupError(f"no {name} is declared")


def _text(help_: str | None) -> str:
    return " ".join((help_ or "").replace("%%", "%").split())


def _cases(known: list[Command]) -> tuple[str, list[tuple[str, tuple[str, ...]]]]:
    """Return the pattern of all commands, and each option that takes a value, after its command, with its values."""
    takers = [
        (shlex.quote(f"{command.words} {name}"), choices)
        for command in known
        for names, _, takes, choices in command.options
        if takes
        for name in names
    ]
    return "|".join(shlex.quote(command.words) for command in known), takers


def _bash(known: list[Command]) -> str:
    verbs = "\n".join(
        f"      {shlex.quote(command.words)}) verbs={shlex.quote(' '.join((*command.verbs, *command.values)))}; "
        f"options={shlex.quote(' '.join(name for names, *_ in command.options for name in names))} ;;"
        for command in known
    )
    paths, takers = _cases(known)
    values = "\n".join(f"    {words}) words={shlex.quote(' '.join(choices))}; given=1 ;;" for words, choices in takers)
    return f"""# bash completion of mdm; eval "$(mdm completion bash)"
_mdm() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" command=mdm verbs options words= given= place
  for ((place = 1; place < COMP_CWORD; place++)); do
    case "$command ${{COMP_WORDS[place]}}" in
      {paths}) command="$command ${{COMP_WORDS[place]}}" ;;
    esac
  done
  case "$command" in
{verbs}
  esac
  case "$command ${{COMP_WORDS[COMP_CWORD - 1]}}" in
{values}
  esac
  if [[ -z $given && $current == -* ]]; then
    words=$options
  elif [[ -z $given ]]; then
    words=$verbs
  fi
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _mdm mdm"""


def _zsh(known: list[Command]) -> str:
    def described(pairs: list[tuple[str, str]]) -> str:
        return " ".join(shlex.quote(f"{name.replace(':', chr(92) + ':')}:{text}") for name, text in pairs)

    cases = "\n".join(
        f"    {shlex.quote(command.words)})\n"
        f"      verbs=({described([*command.verbs.items(), *((value, '') for value in command.values)])})\n"
        f"      options=({described([(name, text) for names, text, *_ in command.options for name in names])}) ;;"
        for command in known
    )
    paths, takers = _cases(known)
    values = "\n".join(
        f"    {words}) {' '.join(('compadd', '--', *map(shlex.quote, choices)) if choices else ('_files',))}; return ;;"
        for words, choices in takers
    )
    return f"""#compdef mdm
# zsh completion of mdm; eval "$(mdm completion zsh)" after compinit
_mdm() {{
  local command=mdm place
  local -a verbs options
  for ((place = 2; place < CURRENT; place++)); do
    case "$command $words[place]" in
      {paths}) command="$command $words[place]" ;;
    esac
  done
  case "$command" in
{cases}
  esac
  case "$command $words[CURRENT-1]" in
{values}
  esac
  if [[ $words[CURRENT] == -* ]]; then
    _describe -o option options
  elif (( $#verbs )); then
    _describe verb verbs
  else
    _files
  fi
}}
compdef _mdm mdm"""


def _fish(known: list[Command]) -> str:
    lines = [
        "# fish completion of mdm; mdm completion fish > ~/.config/fish/completions/mdm.fish",
        "function __mdm_at",
        "  set -l command mdm",
        "  for word in (commandline -opc)[2..-1]",
        '    switch "$command $word"',
        f"      case {' '.join(shlex.quote(command.words) for command in known)}",
        '        set command "$command $word"',
        "    end",
        "  end",
        '  test "$command" = "$argv"',
        "end",
    ]
    for command in known:
        begin = f"complete -c mdm -n {shlex.quote(f'__mdm_at {command.words}')}"
        if command.verbs or command.values:
            lines.append(f"{begin} -f")
        lines += (f"{begin} -a {name} -d {_fish_text(text)}" for name, text in command.verbs.items())
        lines += (f"{begin} -a {value}" for value in command.values)
        for names, text, takes, choices in command.options:
            forms = " ".join(f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in names)
            value = f" -x -a {_fish_text(' '.join(choices))}" if choices else " -r" if takes else ""
            lines.append(f"{begin} {forms}{value} -d {_fish_text(text)}")
    return "\n".join(lines)


def _fish_text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


_SCRIPTS: dict[str, Callable[[list[Command]], str]] = {"bash": _bash, "zsh": _zsh, "fish": _fish}
