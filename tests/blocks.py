"""The fenced blocks of pages, by language, and how each is run.

An info string may say more after the language: ``file=NAME`` writes the block to a file, ``checked="TESTS"`` says which
tests run or compare it, and ``not-run="why"`` why it cannot run.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import subprocess
import sys
import tomllib
from typing import NamedTuple

import in_process
from places import ROOT

_FENCE = re.compile(r"^```(\w*)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A block: its page, line, language, what else its info string says, and its text."""

    page: str
    line: int
    language: str
    info: dict[str, str]
    text: str


def blocks(page):
    """Return the blocks of a page; Sphinx's directives are none."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        Block(page, text.count("\n", 0, match.start()) + 1, match[1], _info(match[2]), match[3])
        for match in _FENCE.finditer(text)
        if not match[2].startswith("{")
    ]


def texts(page, language, heading="", end="\n## "):
    """Return the texts of a page's blocks of a language, below a heading until the next one."""
    text = (ROOT / page).read_text(encoding="utf-8")
    below = text[text.index(heading) + len(heading) :].partition(end)[0] if heading else text
    return [match[3] for match in _FENCE.finditer(below) if match[1] == language]


def _info(text):
    return {name: value.strip('"') for name, value in re.findall(r'([\w-]+)=("[^"]*"|\S+)', text)}


def run(block, folder, scope, *, most=None):
    """Run a block in a folder, with the names that the blocks before it have made; return the folder to go on in.

    What ``print(…)  # text`` prints is compared with the text.

    Args:
        most: How many episodes are simulated at most, whatever the block says. Then what it tests by a pytest of its
            own is tested in this process.
    """
    block = block if most is None else _with_fewer_episodes(block, most)
    if "file" in block.info:
        (folder / block.info["file"]).write_text(block.text, encoding="utf-8")
    elif block.language == "python":
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block.text, f"{block.page}:{block.line}", "exec"), scope)
        said = re.findall(r"^print\(.*\)  # ([^,\n]*)", block.text, re.MULTILINE)
        assert not said or printed.getvalue().splitlines() == said, f"{block.page}:{block.line}"
    elif block.language == "console":
        for words in _lines(block):
            folder = _command(words, folder, alone=most is None)
    elif block.language == "toml":
        tomllib.loads(block.text)
    else:
        raise AssertionError(f"{block.page}:{block.line}: a block of {block.language or 'no language'} does not run")
    return folder


def _with_fewer_episodes(block, most):
    text = re.sub(r"(?<=\bepisodes[= ])[\d_]+", lambda said: str(min(int(said[0]), most)), block.text)
    many = r"(?m)^mdm (evaluate|compare) (?!.*--episodes)[^#\n]*?(?= *(#|$))"
    return block._replace(text=re.sub(many, rf"\g<0> --episodes {most}", text))


def printed(block, folder):
    """Run the commands of a console block in a folder; return what they print."""
    return "".join(_printed(words, folder, None, alone=True) for words in _lines(block) if words)


def _lines(block):
    return [shlex.split(line, comments=True) for line in block.text.replace("\\\n", " ").splitlines()]


def _command(words, folder, *, alone):
    if not words:
        return folder
    if words[0] == "cd":
        return folder / words[1]
    printed = None
    for command in _piped(words):
        printed = _printed(command, folder, printed, alone=alone)
    return folder


def _piped(words):
    """Return the commands of a line, of which each reads what the one before prints."""
    commands = [[]]
    for word in words:
        if word == "|":
            commands.append([])
        else:
            commands[-1].append(word)
    return commands


def _printed(words, folder, given, *, alone):
    """Run a command: that of this library in this process, another by a process of its own, or not `alone`."""
    if words[0] == "mdm":
        status, output, errors = in_process.mdm(*words[1:], folder=folder, given=given or "")
    else:
        assert words[0] == "python"
        if not alone and words[1:3] == ["-m", "pytest"]:
            assert in_process.suite(folder)
            return ""
        if not alone:
            done = in_process.script(folder / words[1], *words[2:], folder=folder)
            assert (done.status, done.wrong) == (0, ""), " ".join(words)
            return done.output
        if words[1:3] == ["-m", "pytest"]:
            words += ["-p", "no:cacheprovider", "-p", "no:asyncio", "-p", "no:randomly"]
        done = subprocess.run(
            [sys.executable, *words[1:]], cwd=folder, input=given, capture_output=True, text=True, timeout=250
        )
        status, output, errors = done.returncode, done.stdout, done.stderr
    assert status == 0, f"{' '.join(words)}\n{output}{errors}"
    return output
