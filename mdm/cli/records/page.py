"""``mdm page``: the record of a run on a page for browsers; and a record as snapshots, for all that show one."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from mdm.cli.progress import work_shown
from mdm.cli.usage import UsageError
from mdm.config.recorded import as_recorded, load_recorded
from mdm.errors import Error
from mdm.formats.target import check_place, replacing
from mdm.recording import Record
from mdm.recording.reader import records_of
from mdm.replay import transports_of
from mdm.runtime import run as run_program
from mdm.snapshots import RecordedRun
from mdm.snapshots.summary import Summary, decoded, keep, summary_of
from mdm.views.web import PageServer
from mdm.views.web.access import encryption
from mdm.views.web.file import page_file
from mdm.views.web.listening import LOOPBACK
from mdm.views.web.server import PORT, websockets
from mdm.views.web.team import RecordedTeam

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping


_LONG = 20_000
"""Messages from which on a record is read for longer than its summary takes."""
_RESTORES = "predicates are not known yet: a replay restores them"
_FAILED = "predicates are not known, for the run cannot be replayed: mdm replay says why"
_NEVER = "predicates are not known: the record does not tell them, and it is not replayed"


def run(arguments: argparse.Namespace) -> int:
    """Show the record until Ctrl-C, or write it to a file; return the exit status."""
    if arguments.output is None and (arguments.first, arguments.last) != (None, None):
        raise UsageError("--from and --to are for the file that --output names: a page shows all of the record")
    if None not in (arguments.first, arguments.last) and arguments.first > arguments.last:
        raise UsageError(f"--from {arguments.first:g} is after --to {arguments.last:g}")
    if arguments.output is not None:
        if (arguments.port, arguments.host, arguments.access) != (None, None, None):
            raise UsageError("--port, --host and --access are for a page that is served: --output writes a file")
        paths = paths_of(arguments.file)
        check_place(arguments.output, *paths.values())
        with work_shown():
            runs = {name: recorded_run(path, replay=not arguments.no_replay) for name, path in paths.items()}
        written = run_of(arguments.file, runs)
        if arguments.first is not None and arguments.first > written.last:
            raise Error(f"{arguments.file}: it ends at second {written.last:g}, before --from {arguments.first:g}")
        page = page_file(written, arguments.first, arguments.last)
        with replacing(Path(arguments.output)) as file:
            file.write(page)
        return 0
    websockets()  # before a long reading, as the rest
    host = LOOPBACK[0] if arguments.host is None else arguments.host
    encryption(host, arguments.access)
    shown = _Shown(arguments.file, replay=not arguments.no_replay)

    async def main() -> None:
        server = PageServer(
            shown.run,
            port=PORT if arguments.port is None else arguments.port,
            host=host,
            access=arguments.access,
            live=False,
            renew=shown.newest,
        )
        await server.open()
        print(f"page: {server.address}", file=sys.stderr, flush=True)
        summarising = asyncio.create_task(shown.restore(server))
        try:
            await asyncio.Event().wait()
        finally:
            summarising.cancel()
            await asyncio.gather(summarising, return_exceptions=True)
            await server.close()

    run_program(main)
    return 0


class _Shown:
    """A record, or those of a team's agents, shown and read again for as long as they grow: recorders may be at work.

    Args:
        path: The record, or a folder of them.
        replay: Have predicates from a replay.

    Attributes:
        run: As it was when it was last read.
    """

    def __init__(self, path: str, *, replay: bool) -> None:
        self._path, self._replay = path, replay
        self._lock = Lock()
        self._runs = {name: self._read(each) for name, each in paths_of(path).items()}
        self.run = run_of(path, self._runs)

    def _read(self, path: Path) -> RecordedRun:
        run = recorded_run(path, replay=False)
        if run.restored is None and run.restorable:
            run.pending = self._replay
            run.remark(_RESTORES if self._replay else _NEVER)
        return run

    def newest(self) -> RecordedRun | RecordedTeam:
        """Return the record as it is now.

        Raises:
            Error: If it cannot be read any more.
        """
        with self._lock:  # one page at a time
            grown = {name: run for name, run in self._runs.items() if run.grows}
            if grown:
                paths = paths_of(self._path)
                self._runs |= {name: self._read(paths[name]) for name in grown}
                self.run = run_of(self._path, self._runs)
            return self.run

    async def restore(self, server: PageServer) -> None:
        """Have a process of its own restore predicates, and show the record with them."""
        for name, path in paths_of(self._path).items():
            if not self._runs[name].pending:
                continue
            told = await _summarised(path)
            with self._lock:
                run = before = self._runs[name]
                try:
                    run = recorded_run(path, replay=False, summary=decoded(told))
                except Error:
                    before.pending = False
                if run.restored is None:
                    run.remark(_FAILED)
                run.generation = before.generation + 1
                self._runs[name] = run
                self.run = run_of(self._path, self._runs)
            server.show(self.run)


async def _summarised(path: Path) -> bytes:
    """Return the summary that a process of its own has made; nothing of one that failed."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-c", "from mdm.cli.records.page import summarise; summarise()", str(path)),
        stdout=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert process.stdout is not None
    try:
        return await process.stdout.read()
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


def paths_of(path: str | Path) -> dict[str, Path]:
    """Return the path of a record, or those of a folder of records by their agents, else by the names of their files.

    Raises:
        Error: If a folder has no records.
        FormatError: If a file in it is no record.
    """
    if not Path(path).is_dir():
        return {"": Path(path)}
    found: dict[str, Path] = {}
    named = [(record.head.get("agent", record.path.stem), record.path) for record in records_of(path).values()]
    for name, each in sorted(named, key=lambda pair: (pair[0], len(pair[1].stem))):  # bob.mcap before bob.2.mcap
        found[each.stem if name in found else name] = each  # of two runs of an agent none is left out
    return found


def run_of(path: str | Path, runs: Mapping[str, RecordedRun]) -> RecordedRun | RecordedTeam:
    """Return the run of `paths_of` a path, or those of a team together: of each agent its first, with a remark."""
    if not Path(path).is_dir():
        return runs[""]
    shown = dict(runs)
    for name in runs:
        first, _, number = name.rpartition(".")
        if first in runs and number.isdigit():
            del shown[name]
            shown[first].remark(f"a later start is in {name}.mcap, which is shown alone")
    return RecordedTeam(shown, title=Path(path).resolve().name)


def summarise() -> None:
    """Write the summary of the record that the last argument names to standard output: of a process of its own."""
    with work_shown():
        sys.stdout.buffer.write(recorded_run(sys.argv[-1]).summary().encoded())


def within(path: str) -> bytes:
    """Return the summary of a record that is about to be closed, to be attached to it."""
    return recorded_run(path, replay=False).summary(within=True).encoded()


def recorded_run(path: str | Path | Record, *, replay: bool = True, summary: Summary | None = None) -> RecordedRun:
    """Return a record as snapshots; without the names, maps and predicates of its configuration where it has none.

    A long record that has no summary gets one beside it, where its folder can be written.

    Args:
        path: The record, or its file.
        replay: Have predicates from a replay, where no summary tells them.
        summary: Its summary, where that is at hand.
    """
    record = path if isinstance(path, Record) else Record(path)
    summary = summary_of(record) if summary is None else summary
    if "configuration" not in record.head:
        return _made(record, summary)
    with tempfile.TemporaryDirectory() as folder:
        try:
            transports = transports_of(record) if "agent" in record.head else {}
            system = load_recorded(record, folder, transport=next(iter(transports.values()), None))
        except Error as error:
            run = _made(record, summary)
            run.remark(f"the record's configuration cannot be loaded: {error}")
            return run
        facts = {"ensembles": system.ensembles, "predicates": system.predicates, "places": system.places}
        run = _made(record, summary, system=system, **facts)
    for sentence in record.cannot:
        run.remark(sentence)
    if replay and run.restored is None:
        try:
            with as_recorded(record, system.ensembles.values()):
                run.restore(transports)
            _keep(run, record)
        except Error as error:
            run.remark(f"predicates are not known, for the run cannot be replayed: {error}")
    return run


def _made(record: Record, summary: Summary | None, **system: Any) -> RecordedRun:
    """Return a run by its summary, or where that does not fit, by reading its record."""
    if summary is not None:
        with suppress(Error):  # of another edition of the same version
            return RecordedRun(record, summary=summary, **system)
    run = RecordedRun(record, **system)
    _keep(run, record)
    return run


def _keep(run: RecordedRun, record: Record) -> None:
    """Keep the summary of a run beside its record, where that is long and does not grow."""
    if record.counts.total() >= _LONG and not record.grows:
        keep(run.summary(), record)
