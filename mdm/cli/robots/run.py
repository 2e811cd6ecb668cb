"""``mdm run``: run the ensembles of a file."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections import Counter
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import anyio

from mdm.actors.actions.action_layer import ActionStatistics
from mdm.cli.interruption import hear_interrupts
from mdm.cli.robots.attached import Attached
from mdm.cli.robots.decision import in_words
from mdm.cli.robots.decisions_file import decisions_to
from mdm.cli.robots.page_hosts import page_hosts, refuse_without_page
from mdm.cli.usage import UsageError
from mdm.config import load_system, load_team
from mdm.config.recorded import attach_configuration
from mdm.recording import Recorder
from mdm.runtime import DeadlockError, Log, Runtime, run as run_program

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.config import System
    from mdm.messages import Decision
    from mdm.views.web import Page

__all__ = ["run"]

_FAILURES = {"failed", "timed_out", "abandoned"}


def run(arguments: argparse.Namespace) -> int:
    """Run the ensembles; return the exit status."""
    hear_interrupts()
    attached = Attached() if arguments.attached else None
    system = _load(arguments)
    first, ended = system.top[0], Counter[str]()
    log = _log(arguments, system)

    async def main() -> None:
        async with Runtime(log=log or False, record=_recorder(arguments), page=_page(arguments)) as runtime:

            def tally(decision: Decision) -> None:
                if decision.ensemble == first.path and decision.epoch >= 0:
                    seen.append(decision.epoch)
                    if len(seen) >= arguments.epochs:
                        runtime.shut_down()

            if log is not None and arguments.why:
                from mdm.cli.robots.why import why_in  # noqa: PLC0415 - for those who ask

                runtime.decisions.subscribe(why_in(log, system.ensembles.values()))
            seen: list[int] = []
            if arguments.epochs is not None:
                runtime.decisions.subscribe(tally)
            if attached is not None:
                attached.hold(runtime, sum(ensemble.patience for ensemble in system.top))
            write_decisions(runtime)
            with _releases(system, virtual=arguments.virtual):
                await runtime.start(system)
                try:
                    with anyio.move_on_after(arguments.seconds):
                        await runtime.wait()
                finally:
                    ended.update(_ended(runtime))

    try:
        path = None if system.member is not None else arguments.decisions
        with decisions_to(path) as write_decisions:  # before the record begins
            run_program(main, virtual=arguments.virtual)
    except DeadlockError:
        print("mdm run: ended, because no timer is pending and no input can come", file=sys.stderr)
    finally:
        failings = system.member.failings() if system.member is not None else _nothing_but_failures(ended)
        for failing in failings:
            print(f"mdm {arguments.command}: {failing}", file=sys.stderr)
    return 1 if failings else 0


def _log(arguments: argparse.Namespace, system: System) -> Log | None:
    """Return the log; None where it should be quiet."""
    if arguments.quiet:
        if arguments.why:
            raise UsageError("--why is told in the log, which --quiet leaves out")
        return None
    return Log(arguments.log, debug=arguments.debug, decisions=in_words(system.ensembles.values()))


def _page(arguments: argparse.Namespace) -> Page | None:
    """Return what shows the run live; None where nobody asked for it."""
    if arguments.page is None:
        refuse_without_page(arguments)
        return None
    from mdm.views.web import Page  # noqa: PLC0415 - an extra, and only where it is asked for

    return Page(
        arguments.page,
        **page_hosts(arguments, arguments.agent),
        control=arguments.page_control,
        title=Path(arguments.file).name,
    )


def _recorder(arguments: argparse.Namespace) -> Recorder | None:
    """Return what records the run, with its configuration; None where it is not recorded."""
    if arguments.record is None:
        return None
    recorder = Recorder(_record_of(Path(arguments.record), arguments.agent))
    attach_configuration(recorder, arguments.file, agent=arguments.agent)
    return recorder


def _record_of(path: Path, agent: str | None) -> Path:
    """Return the file of a record: of an agent, in a folder that is given, one that is not there yet.

    That of a process that was killed may be written still while the agent starts again.
    """
    if agent is None or not path.is_dir():
        return path
    starts = count(1)
    return next(
        file
        for start in starts
        if not (file := path / (f"{agent}.mcap" if start == 1 else f"{agent}.{start}.mcap")).exists()
    )


def _nothing_but_failures(ended: Counter[str]) -> list[str]:
    """Return that every action has failed, if so; an agent's process says nothing of it, but would be started again."""
    if not ended or not set(ended) <= _FAILURES:
        return []
    return [f"every action that was decided and ended has failed: {ended.total()}"]


def _ended(runtime: Runtime) -> Counter[str]:
    """Return how the actions that all ensembles have decided ended, and how many of them: safe actions apart."""
    counts: Counter[str] = Counter()
    for statistics in runtime.statistics().actors:
        if isinstance(statistics, ActionStatistics):
            counts.update(statistics.ended)
            counts.subtract(statistics.safe_ended)
    return +counts


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


def _load(arguments: argparse.Namespace) -> System:
    team = load_team(arguments.file)
    if team is None:
        if arguments.agent is not None:
            raise UsageError(f"--agent is for a team's file, and {arguments.file} has no table [team]")
        return load_system(arguments.file)
    if arguments.agent is None:
        raise UsageError(
            f"{arguments.file} describes the team {team.name!r}: say which agent this process is, such as "
            f"--agent {team.names[0]} (there are {', '.join(team.names)}), or run all of them here: "
            f"mdm team up {arguments.file}"
        )
    if arguments.virtual:
        raise UsageError("--virtual is for a file without a team: processes have no virtual time in common")
    team.check_agent(arguments.agent, key="--agent")
    return load_system(arguments.file, agent=arguments.agent, decisions=arguments.decisions)
