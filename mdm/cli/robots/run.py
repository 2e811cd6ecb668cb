"""``mdm run``: run the ensembles of a file."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections import Counter
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import msgspec
import numpy as np

from mdm.actors.actions.action_layer import ActionStatistics
from mdm.cli.interruption import hear_interrupts
from mdm.cli.usage import UsageError
from mdm.config import load_system, load_team, load_team_file
from mdm.config.recorded import attach_configuration
from mdm.errors import Error, ModelError
from mdm.recording import Recorder
from mdm.runtime import DeadlockError, Log, Runtime, run as run_program

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from mdm.actors import Ensemble
    from mdm.config import System
    from mdm.messages import Decision
    from mdm.views.web import Page

_FAILURES = {"failed", "timed_out", "abandoned"}


def run(arguments: argparse.Namespace) -> int:
    """Run the ensembles; return the exit status."""
    hear_interrupts()
    attached = Attached() if arguments.attached else None
    system = _load(arguments)
    first, ended = system.top[0], Counter[str]()
    log = _log(arguments)

    async def main() -> None:
        async with Runtime(log=log or False, record=_recorder(arguments), page=_page(arguments)) as runtime:

            def tally(decision: Decision) -> None:
                if decision.ensemble == first.path and decision.epoch >= 0:
                    seen.append(decision.epoch)
                    if len(seen) >= arguments.epochs:
                        runtime.shut_down()

            if log is not None and arguments.why:
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


def _log(arguments: argparse.Namespace) -> Log | None:
    """Return the log; None where it should be quiet."""
    if arguments.quiet:
        if arguments.why:
            raise UsageError("--why is told in the log, which --quiet leaves out")
        return None
    return Log(arguments.log, debug=arguments.debug, decisions=True)


def why_in(log: Log, ensembles: Iterable[Ensemble]) -> Callable[[Decision], None]:
    """Return a handler that writes why with each decision of these ensembles.

    Decisions of others, as of a task's or of another agent that decides for all, have no line.
    """
    from mdm.explanation import brief, explain  # noqa: PLC0415 - for those who ask

    known = {ensemble.path: ensemble for ensemble in ensembles}

    def note(decision: Decision) -> None:
        ensemble = known.get(decision.ensemble)
        if ensemble is None:
            return
        try:
            case = ensemble.controller.case()
        except ModelError:
            return
        if (case.epoch, case.action) == (decision.epoch, decision.action):
            head = {"time": decision.time / 1e9, "ensemble": decision.ensemble, "epoch": decision.epoch}
            log.write("why", lambda: head | brief(explain(ensemble.named(case))))

    return note


def _page(arguments: argparse.Namespace) -> Page | None:
    """Return the page that shows the run live; None where nobody asked for it."""
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


def refuse_without_page(arguments: argparse.Namespace) -> None:
    """Refuse the options of a page where nobody asked for one.

    Raises:
        UsageError: If there are any.
    """
    for option in ("control", "host", "access"):
        if getattr(arguments, f"page_{option}", None) not in {None, False}:
            raise UsageError(f"--page-{option} is for a page: say --page, too")


def page_hosts(arguments: argparse.Namespace, name: str | None) -> dict[str, Any]:
    """Return the host and the access of a page.

    Args:
        arguments: The arguments of the verb.
        name: Whose certificate of the team is shown where none is given; None where there is no team.
    """
    from mdm.views.web.listening import LOOPBACK  # noqa: PLC0415 - an extra, and only where it is asked for

    host, access = arguments.page_host, arguments.page_access
    if host is None:
        host = LOOPBACK[0]
    if access is None and name is not None and host not in LOOPBACK:
        described = load_team_file(arguments.file)
        access = None if described is None else described.access(name)
    return {"host": host, "access": access}


def _recorder(arguments: argparse.Namespace) -> Recorder | None:
    """Return the recorder of the run, with its configuration; None where it is not recorded."""
    if arguments.record is None:
        return None
    path, agent = Path(arguments.record), arguments.agent
    if agent is not None and path.is_dir():
        # A file that is not there yet: that of a process that was killed may be written still.
        names = (f"{agent}.mcap" if start == 1 else f"{agent}.{start}.mcap" for start in count(1))
        path = next(path / name for name in names if not (path / name).exists())
    recorder = Recorder(path)
    attach_configuration(recorder, arguments.file, agent=agent)
    return recorder


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
        return load_system(arguments.file, virtual=arguments.virtual)
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


@contextmanager
def decisions_to(path: str | None) -> Iterator[Callable[[Runtime], None]]:
    """Open a file before a run begins; yield a function that adds each decision of a runtime to it, as a line of JSON.

    Raises:
        Error: If the file cannot be opened.
    """
    if path is None:
        yield lambda _: None
        return
    if not path.endswith(".jsonl"):
        raise Error(f"decisions are lines of JSON: name a file that ends in .jsonl, not {path}")
    encode = msgspec.json.Encoder(enc_hook=_plain).encode
    try:
        file = open(path, "ab", buffering=0)  # noqa: SIM115, PTH123 - it is closed below
    except OSError as error:
        raise Error(f"decisions cannot be written to {path}: {error.strerror}") from None

    def begin(runtime: Runtime) -> None:
        def write(decision: Decision) -> None:
            try:
                file.write(encode(decision) + b"\n")
            except OSError as error:
                subscription.cancel()
                runtime.root.report("decisions", f"lines cannot be written to {path}: {error.strerror}")

        subscription = runtime.decisions.subscribe(write)

    with file:
        yield begin


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError


_HELD = 3.0
"""Seconds after which an event loop that does not answer is held."""

_PATIENCE = 15.0
_BREATH = 0.2


class Attached:
    """Ends this process, in order where that can be, when its standard input ends.

    A thread waits for that, which a callback that holds the event loop does not keep from seeing it. An end in order
    has the time of its actors' limits. Where the starter of this process is gone, and so cannot end it, and the loop
    does not answer, the runtime's ``emergency`` is called and the process is killed.

    Args:
        descriptor: Standard input.
    """

    def __init__(self, descriptor: int = 0) -> None:
        self._descriptor = descriptor
        self._starter = os.getppid()
        self._runtime: Runtime | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._patience = _PATIENCE
        self._answered = threading.Event()
        threading.Thread(target=self._watch, name="mdm:attached", daemon=True).start()

    def hold(self, runtime: Runtime, patience: float) -> None:
        """Have a runtime end with standard input, on whose event loop this is called.

        Args:
            runtime: The runtime.
            patience: Seconds that its actors may take by their own limits.
        """
        self._loop, self._runtime, self._patience = asyncio.get_running_loop(), runtime, _PATIENCE + patience

    def _watch(self) -> None:
        with suppress(OSError):
            while os.read(self._descriptor, 4096):
                pass
        began, answered = time.monotonic(), time.monotonic()
        while time.monotonic() - began < self._patience:
            self._answered.clear()
            with suppress(RuntimeError):  # the loop has ended
                if self._loop is not None:
                    self._loop.call_soon_threadsafe(self._end)
            if self._answered.wait(_BREATH):
                answered = time.monotonic()
                time.sleep(_BREATH)
            elif os.getppid() != self._starter and time.monotonic() - answered > _HELD:
                break
        # The emergency, if any, comes before; whom this process has started goes with it.
        if self._runtime is not None and self._loop is not None and not self._loop.is_closed():
            self._runtime.emergency("standard input has ended, and this process, which does not end, is killed")
            time.sleep(_BREATH)
        if os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)

    def _end(self) -> None:
        """End the runtime; being called is the loop's answer."""
        self._answered.set()
        if self._runtime is not None:
            self._runtime.shut_down()
