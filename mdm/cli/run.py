"""``mdm run``: run the ensembles of a file."""

from __future__ import annotations

import asyncio
import signal
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from mdm.cli.usage import count

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.config import System
    from mdm.messages import Decision

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb and its arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "run",
        help="run the ensembles of a TOML file",
        description=(
            "Run the ensembles of a TOML file until Ctrl-C, SIGTERM, or --epochs decisions of the first one. SIGUSR1 "
            "releases those that are safe: kill -USR1 PID."
        ),
        epilog="example: mdm run examples/patrol/patrol.toml --virtual --epochs 20",
    )
    parser.add_argument("file", metavar="FILE", help="the TOML file")
    parser.add_argument(
        "--virtual", action="store_true", help="in virtual time: without waiting, until nothing is pending"
    )
    parser.add_argument("--epochs", metavar="N", type=count, help="stop after N decisions of the first ensemble")
    parser.add_argument("--log", choices=("console", "json"), default="console", help="how to write the log")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run the ensembles; return the exit status."""
    from mdm.config import load_system  # noqa: PLC0415 - `mdm --help` needs no numpy
    from mdm.runtime import (  # noqa: PLC0415
        DeadlockError,
        Runtime,
        run as run_program,
    )

    system = load_system(arguments.file)
    first = system.top[0].name

    async def main() -> None:
        async with Runtime(log=arguments.log, debug=arguments.debug) as runtime:

            def tally(decision: Decision) -> None:
                if decision.ensemble == first and decision.epoch >= 0:
                    seen.append(decision.epoch)
                    if len(seen) >= arguments.epochs:
                        runtime.shut_down()

            seen: list[int] = []
            if arguments.epochs is not None:
                runtime.decisions.subscribe(tally)
            with _releases(system, virtual=arguments.virtual):
                await runtime.start(system)
                await runtime.wait()

    try:
        run_program(main, virtual=arguments.virtual)
    except DeadlockError:
        print("mdm run: ended, because no timer is pending and no input can come", file=sys.stderr)
    return 0


@contextmanager
def _releases(system: System, *, virtual: bool) -> Iterator[None]:
    """Release the ensembles that are safe whenever SIGUSR1 comes; in virtual time nobody can send it in time."""
    number = getattr(signal, "SIGUSR1", None)  # Windows has none
    if number is None or virtual:
        yield
        return

    def release() -> None:
        for ensemble in system.ensembles.values():
            if ensemble.mode == "safe":
                ensemble.release()

    loop = asyncio.get_running_loop()
    loop.add_signal_handler(number, release)
    try:
        yield
    finally:
        loop.remove_signal_handler(number)
