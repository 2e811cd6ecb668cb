"""The fenced blocks of pages, by language, and how each is run.

An info string may say more after the language: ``file=NAME`` writes the block to a file first, and ``not-run="why"``
says why it cannot run.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from typing import NamedTuple

from places import ROOT

_FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A block: its page, line, language, what else its info string says, and its text."""

    page: str
    line: int
    language: str
    info: dict[str, str]
    text: str


def blocks(page):
    """Return the blocks of a page that has a language."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        Block(page, text.count("\n", 0, match.start()) + 1, match[1], _info(match[2]), match[3])
        for match in _FENCE.finditer(text)
    ]


def _info(text):
    return {name: value.strip('"') for name, value in re.findall(r'([\w-]+)=("[^"]*"|\S+)', text)}


def run(block, folder, scope):
    """Run a block in a folder, with the names that the blocks before it have made; return the folder to go on in."""
    if "file" in block.info:
        (folder / block.info["file"]).write_text(block.text, encoding="utf-8")
    elif block.language == "python":
        exec(compile(block.text, f"{block.page}:{block.line}", "exec"), scope)
    elif block.language == "console":
        for line in block.text.replace("\\\n", " ").splitlines():
            folder = _command(shlex.split(line, comments=True), folder)
    elif block.language == "toml":
        tomllib.loads(block.text)
    return folder


def _command(words, folder):
    if not words:
        return folder
    if words[0] == "cd":
        return folder / words[1]
    programs = {"mdm": ["-m", "mdm"], "python": []}
    if words[1:3] == ["-m", "pytest"]:
        words += ["-p", "no:cacheprovider", "-p", "no:asyncio", "-p", "no:randomly"]
    done = subprocess.run(
        [sys.executable, *programs[words[0]], *words[1:]], cwd=folder, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"
    return folder
