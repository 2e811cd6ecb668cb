"""``mdm check``: everything that would keep a file from being used, without using it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "check",
        help="say everything that is wrong with an ensemble, model or policy file",
        description="Check a file without running anything: an ensemble's TOML file, a model or a policy.",
        epilog="example: mdm check examples/patrol/patrol.toml",
    )
    parser.add_argument("file", metavar="FILE", help="a TOML file, a model or a policy")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Check the file; return the exit status."""
    from mdm.cli.document import load  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.errors import ConfigError  # noqa: PLC0415

    try:
        document = load(arguments.file)
    except ConfigError as error:
        for problem in error.problems:
            print(f"mdm check: {problem}", file=sys.stderr)
        return 1
    print(f"{arguments.file}: {document.kind}, no problems found")
    return 0
