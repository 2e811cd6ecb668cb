"""``mdm completion``: what the shells themselves complete, against the parsers."""

from __future__ import annotations

import inspect
import shlex
import shutil
import subprocess
import sys

import pytest
from patience import PATIENCE

from mdm import problems
from mdm.cli import VERBS, main
from mdm.cli.projects.completion import commands
from mdm.cli.projects.examples import EXAMPLES
from mdm.solvers import SOLVERS

TRIED = [
    ([""], set(VERBS)),
    (["s"], {verb for verb in VERBS if verb.startswith("s")}),
    (["map", ""], {"goals", "draft", "check", "show", "model"}),
    (["map", "draft", "--js"], {"--json"}),
    (["solve", "model.pomdp", "--ga"], {"--gap"}),
    (["run", "--log", ""], {"console", "json"}),
    (["completion", ""], {"bash", "zsh", "fish"}),
    (["problem", "rock"], {"rock_sample"}),
    (["problem", "rock_sample", "--r"], {"--rocks"}),
    (["trace", "robot.toml", "--drive", ""], {"event"}),
    (["solve", "model.pomdp", "--solver", "s"], {"sarsop"}),
    (["examples", "from"], {"from_arrays"}),
    (["trace", "robot.toml", "--on-impossible", ""], {"predict", "keep", "reset"}),
]


@pytest.fixture
def script(request, tmp_path, capsys):
    """The script of a shell that is there."""
    shell = request.param
    if shutil.which(shell) is None:
        pytest.skip(f"there is no {shell}")
    assert main(["completion", shell]) == 0
    path = tmp_path / f"mdm.{shell}"
    path.write_text(capsys.readouterr().out)
    return path


def completed(shell, *lines):
    done = subprocess.run([shell, *lines], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return {line.split("\t")[0].strip() for line in done.stdout.splitlines()} - {""}


@pytest.mark.parametrize("script", ["bash"], indirect=True)
@pytest.mark.parametrize(("words", "expected"), TRIED)
def test_bash(script, words, expected):
    given = " ".join(map(shlex.quote, ["mdm", *words]))
    place = "$((${#COMP_WORDS[@]} - 1))"
    program = f'. {script}; COMP_WORDS=({given}); COMP_CWORD={place}; _mdm; printf "%s\\n" "${{COMPREPLY[@]}}"'
    assert completed("bash", "-c", program) == expected


@pytest.mark.parametrize("script", ["zsh"], indirect=True)
@pytest.mark.parametrize(("words", "expected"), TRIED)
def test_zsh(script, words, expected):
    """With stand-ins for what the shell's completion system has as functions."""
    given = " ".join(map(shlex.quote, ["mdm", *words]))
    program = f"""
compdef() {{ }}; _files() {{ }}
compadd() {{ shift; print -l -- "$@" }}
_describe() {{ print -l -- ${{${{(P)@[-1]}}%%:*}} }}
. {script}; words=({given}); CURRENT=$#words; _mdm
"""
    found = completed("zsh", "-f", "-c", program)
    assert {word for word in found if word.startswith(words[-1])} == expected


@pytest.mark.parametrize("script", ["fish"], indirect=True)
@pytest.mark.parametrize(("words", "expected"), TRIED)
def test_fish(script, words, expected):
    program = f"source {script}; complete -C {shlex.quote(' '.join(['mdm', *words]))}"
    found = completed("fish", "--no-config", "-c", program)
    assert expected <= found
    assert {word for word in found if word in VERBS} == (expected if words in ([""], ["s"]) else expected & set(VERBS))


def test_every_verb_and_option_is_known():
    known = {command.words: command for command in commands()}
    assert set(known["mdm"].verbs) == set(VERBS)
    assert len(known) > 30
    for command in known.values():
        assert any("--help" in names for names, *_ in command.options)
        if not command.verbs:
            assert any("--debug" in names for names, *_ in command.options)
    assert {names: takes for names, _, takes, _ in known["mdm map model"].options}["--robot",] is True


def test_names_are_those_of_the_modules():
    known = {command.words: command for command in commands()}
    assert list(known["mdm problem"].verbs) == problems.__all__
    for name, line in known["mdm problem"].verbs.items():
        function = getattr(problems, name)
        assert line == inspect.getdoc(function).partition("\n")[0].removeprefix("Return ")
        options = {option for names, *_ in known[f"mdm problem {name}"].options for option in names}
        parameters = {f"--{parameter.replace('_', '-')}" for parameter in inspect.signature(function).parameters}
        assert options == {"-o", "--output", "-h", "--help", "--debug"} | parameters
    solvers = {names: values for names, _, _, values in known["mdm solve"].options}["--solver",]
    assert solvers == (*SOLVERS, "help")
    assert known["mdm examples"].values == tuple(EXAMPLES)


def test_the_scripts_are_made_without_numpy():
    program = "import sys; from mdm.cli import main; main(['completion', 'zsh']); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True).returncode == 0


def test_a_shell_that_is_not_known(capsys):
    assert main(["completion", "tcsh"]) == 2
    assert "invalid choice: 'tcsh'" in capsys.readouterr().err
