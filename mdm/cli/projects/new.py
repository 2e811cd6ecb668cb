"""``mdm new``: a small project that runs, and has a test."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.cli.projects.folder import examples, making
from mdm.cli.usage import UsageError

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]

_NAME = b"@NAME@"


def run(arguments: argparse.Namespace) -> int:
    """Make a project; return the exit status."""
    target = Path(arguments.name)
    name = target.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        expected = "letters, digits and _ were expected, a letter first"
        raise UsageError(f"{name!r} cannot be the name of an ensemble: {expected}")
    with making(target) as made:
        for file in (examples() / "projects" / arguments.kind).iterdir():
            if file.is_file():
                (made / file.name).write_bytes(file.read_bytes().replace(_NAME, name.encode()))
    run_it = "mdm team up team.toml" if arguments.kind == "team" else "mdm run robot.toml"
    print(
        f"{target}: a project; README.md says what its files are\nRun it there: {run_it}\n"
        "Test it: python -m pytest (which takes pip install pytest)"
    )
    return 0
