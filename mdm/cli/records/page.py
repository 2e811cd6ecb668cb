"""``mdm page``: the record of a run on a page."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING

from mdm.cli.records.shown import recorded_run
from mdm.runtime import run as run_program
from mdm.views.web import PageServer
from mdm.views.web.server import websockets

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Show the record until Ctrl-C; return the exit status."""
    websockets()  # before a long replay
    shown = recorded_run(arguments.file, replay=not arguments.no_replay)

    async def main() -> None:
        server = PageServer(shown, port=arguments.port, live=False)
        await server.open()
        print(f"page: {server.address}", file=sys.stderr, flush=True)
        try:
            await asyncio.Event().wait()
        finally:
            await server.close()

    run_program(main)
    return 0
