"""``mdm page``: the record of a run on a page for browsers; and a record as snapshots, for all that show one."""

from __future__ import annotations

import asyncio
import sys
import tempfile
from threading import Lock
from typing import TYPE_CHECKING

from mdm.config.recorded import as_recorded, load_recorded
from mdm.errors import Error
from mdm.recording import Record
from mdm.replay import transports_of
from mdm.runtime import run as run_program
from mdm.snapshots import RecordedRun
from mdm.views.web import PageServer
from mdm.views.web.access import encryption
from mdm.views.web.listening import LOOPBACK
from mdm.views.web.server import websockets

if TYPE_CHECKING:
    import argparse
    from pathlib import Path


def run(arguments: argparse.Namespace) -> int:
    """Show the record until Ctrl-C; return the exit status."""
    websockets()  # before a long replay, as the rest
    host = LOOPBACK[0] if arguments.host is None else arguments.host
    encryption(host, arguments.access)
    shown = _Shown(arguments.file, replay=not arguments.no_replay)

    async def main() -> None:
        server = PageServer(
            shown.run, port=arguments.port, host=host, access=arguments.access, live=False, renew=shown.newest
        )
        await server.open()
        print(f"page: {server.address}", file=sys.stderr, flush=True)
        try:
            await asyncio.Event().wait()
        finally:
            await server.close()

    run_program(main)
    return 0


class _Shown:
    """A record that is shown, and read again for as long as it grows: its recorder may still be at work.

    Args:
        path: The record.
        replay: Have predicates from a replay.

    Attributes:
        run: As it was when it was last read.
    """

    def __init__(self, path: str, *, replay: bool) -> None:
        self._path, self._replay = path, replay
        self._lock = Lock()
        self.run = recorded_run(path, replay=replay)

    def newest(self) -> RecordedRun:
        """Return the record as it is now.

        Raises:
            Error: If it cannot be read any more.
        """
        with self._lock:  # one page at a time
            if self.run.grows:
                self.run = recorded_run(self._path, replay=self._replay)
            return self.run


def recorded_run(path: str | Path | Record, *, replay: bool = True) -> RecordedRun:
    """Return a record as snapshots; without the names, maps and predicates of its configuration where it has none.

    Args:
        path: The record, or its file.
        replay: Have predicates from a replay.
    """
    record = path if isinstance(path, Record) else Record(path)
    if "configuration" not in record.head:
        return RecordedRun(record)
    with tempfile.TemporaryDirectory() as folder:
        transports = transports_of(record)
        try:
            system = load_recorded(record, folder, transport=next(iter(transports.values()), None))
        except Error as error:
            run = RecordedRun(record)
            run.remark(f"the record's configuration cannot be loaded: {error}")
            return run
        run = RecordedRun(
            *(record, system),
            ensembles=system.ensembles,
            predicates=system.predicates,
            places=system.places,
        )
    for sentence in record.cannot:
        run.remark(sentence)
    if replay:
        try:
            with as_recorded(record, system.ensembles.values()):
                run.restore(transports)
        except Error as error:
            run.remark(f"predicates are not known, for the run cannot be replayed: {error}")
    return run
