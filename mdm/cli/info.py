"""``mdm info``: sizes and names of a model or policy; tree and wiring of ensembles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "info",
        help="describe the content of a file",
        description=(
            "Print the sizes and names of a model or policy, or the tree of a TOML file's ensembles and which "
            "predicate, event or function stands for each symbol."
        ),
        epilog="example: mdm info examples/patrol/rooms.pomdpx --json",
    )
    parser.add_argument("file", metavar="FILE", help="a model, a policy or a TOML file")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Describe the file; return the exit status."""
    from mdm.cli.document import load  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.cli.report import as_json  # noqa: PLC0415
    from mdm.cli.wiring import lines  # noqa: PLC0415
    from mdm.config import System  # noqa: PLC0415

    document = load(arguments.file)
    if arguments.json:
        print(as_json(document.facts()))
    elif isinstance(document.content, System):
        print("\n".join([document.content.tree(), *lines(document.content)]))
    else:
        for key, value in document.facts().items():
            if value is None or value == []:
                continue
            print(f"{key.replace('_', ' '):24}{_text(value)}")
    return 0


def _text(value: Any) -> str:
    if isinstance(value, list):
        parts = [_text(part) for part in value[:12]] + (["…"] if len(value) > 12 else [])
        return "; ".join(parts) if any(isinstance(part, list) for part in value) else ", ".join(parts)
    if isinstance(value, dict):
        return f"{value['name']} ({value['size']})"
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)
