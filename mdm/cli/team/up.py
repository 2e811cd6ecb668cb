"""``mdm team up`` and ``run``: run all agents of a team on this machine, a process each, or one in this process."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import socket
import sys
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.interruption import hear_interrupts
from mdm.cli.robots.run import page_hosts, refuse_without_page, run as run_alone
from mdm.cli.team.crew import Console, Crew
from mdm.cli.team.file import forget_state, sound_systems_of, team_of
from mdm.errors import Error
from mdm.team.transport.access import OPERATOR
from mdm.team.transport.session import import_zenoh
from mdm.team.transport.settings import address, resolve

if TYPE_CHECKING:
    import argparse
    from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
    from contextlib import AbstractAsyncContextManager

    from mdm.team.team import Agent

_SLACK = 15.0
"""Seconds that an agent's process may take to end, beside the limits of its ensembles."""


def run(arguments: argparse.Namespace) -> int:
    """Run the agents; return the exit status."""
    team = team_of(arguments.file)
    systems = sound_systems_of(arguments.file, team)  # whatever is wrong is told once, and not by each agent
    patience = _SLACK + max(ensemble.patience for system in systems.values() for ensemble in system.top)
    import_zenoh()
    check_ports(team.agents)
    shown = _page_options(arguments)
    folder = None if arguments.decisions is None else _folder(arguments.decisions, team.names)
    if arguments.record is not None:
        _make_folder(arguments.record, "records")
    if arguments.fresh:  # once: an agent that is started again after a failure remembers
        forget_state(arguments.file, team.names)
    commands = {agent: _command(arguments, agent, folder) for agent in team.names}
    pages = {} if shown is None else _add_pages(commands, arguments.page, control=arguments.page_control)
    return asyncio.run(_run(commands, arguments, patience, _team_page(pages, shown, Path(arguments.file).name)))


def run_agent(arguments: argparse.Namespace) -> int:
    """Run one agent, as ``mdm run FILE --agent NAME`` does; return the exit status."""
    team = team_of(arguments.file)
    if arguments.fresh and arguments.agent in team.names:
        check_ports([team.agents[team.names.index(arguments.agent)]])  # one that lives there remembers
        forget_state(arguments.file, [arguments.agent])
    return run_alone(arguments)


def _page_options(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Return the options of the team's page; None where nobody asked for one."""
    if arguments.page is None:
        refuse_without_page(arguments)
        return None
    from mdm.views.web.access import encryption  # noqa: PLC0415 - only where it is asked for

    options = page_hosts(arguments, OPERATOR)
    encryption(**options)
    return {"port": arguments.page, "control": arguments.page_control, **options}


def _add_pages(commands: Mapping[str, list[str]], port: int, *, control: bool) -> dict[str, str]:
    """Let each agent's process serve a page of its own, which that of the team looks at; return their addresses."""
    from mdm.views.web.access import Access  # noqa: PLC0415 - only where it is asked for
    from mdm.views.web.listening import next_free  # noqa: PLC0415
    from mdm.views.web.server import PORT, websockets  # noqa: PLC0415

    websockets()
    token = os.environ.setdefault("MDM_PAGE_TOKEN", Access(port).token)  # which the agents' processes have from here
    pages = {}
    for agent, command in commands.items():
        free = next_free(port or PORT)
        if free is None:
            raise Error(f"there is no free port above {port or PORT} for the page of agent {agent!r}")
        port = free
        command += ["--page", str(port), *(["--page-control"] if control else [])]
        pages[agent] = Access(port, token).address
    return pages


@asynccontextmanager
async def _team_page(pages: Mapping[str, str], options: dict[str, Any] | None, title: str) -> AsyncIterator[None]:
    """Serve the page of the team, where there is one."""
    if options is None:
        yield
        return
    from mdm.views.web import PageServer  # noqa: PLC0415 - only where it is asked for
    from mdm.views.web.team import TeamRun  # noqa: PLC0415

    shown = TeamRun(pages, title=title, control=options["control"])
    server = PageServer(shown, live=True, **options)
    await server.open()
    shown.open()
    print(f"page: {server.address}", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        await shown.stop()
        await server.close()


def _folder(name: str, agents: Sequence[str]) -> Path:
    """Return the folder of decisions, made where there is none."""
    if not name:
        raise Error("decisions cannot be written to '': --decisions names no folder")
    folder = _make_folder(name, "decisions")
    for agent in agents:
        if (folder / f"{agent}.jsonl").exists():
            raise Error(f"{folder / agent}.jsonl is there already: name another folder, or remove it first")
    for agent in agents:
        file = folder / f"{agent}.jsonl"
        try:
            file.touch(exist_ok=False)
        except OSError as error:
            raise Error(f"decisions cannot be written to {file}: {error.strerror}") from None
    return folder


def _make_folder(name: str, content: str) -> Path:
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "that is a file, and no folder" if isinstance(error, FileExistsError) else error.strerror
        raise Error(f"{content} cannot be written to {name!r}: {reason}") from None
    return folder


def _command(arguments: argparse.Namespace, agent: str, folder: Path | None) -> list[str]:
    options = [] if folder is None else ["--decisions", str(folder / f"{agent}.jsonl")]
    options += [] if arguments.record is None else ["--record", arguments.record]
    options += ["--debug"] if arguments.debug else []
    command = [sys.executable, "-u", "-m", "mdm", "run", arguments.file]
    return [*command, "--agent", agent, "--attached", "--log", "json", *options]


def check_ports(agents: Iterable[Agent]) -> None:
    """Refuse to start where an agent cannot listen: the team itself may run already, or the agent be elsewhere at home.

    Raises:
        Error: If an agent's port is taken, or its address is none of this machine.
    """
    with ExitStack() as taken:  # all at once: two agents of it may want one port
        for agent in agents:
            protocol, host, port = address(agent.listens or "")
            if protocol == "unixsock-stream" or not port:
                continue
            resolve(agent.listens or "")
            kind = socket.SOCK_DGRAM if protocol == "udp" else socket.SOCK_STREAM
            family, _, _, _, place = socket.getaddrinfo(host.strip("[]"), int(port), type=kind)[0]
            one = taken.enter_context(socket.socket(family, kind))
            try:
                if kind == socket.SOCK_STREAM:
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                one.bind(place)
                if kind == socket.SOCK_STREAM:
                    one.listen()
            except OSError as error:
                way = "perhaps the team runs already (`mdm team status` says so), or another `port` in [team] is free"
                if error.errno == errno.EADDRNOTAVAIL:
                    way = f"run it on the machine that has this address: mdm team run FILE --agent {agent.name}"
                raise Error(f"agent {agent.name!r} cannot listen at {agent.listens}: {error.strerror}; {way}") from None


async def _run(
    commands: Mapping[str, Sequence[str]],
    arguments: argparse.Namespace,
    patience: float,
    page: AbstractAsyncContextManager[None],
) -> int:
    console = Console(list(commands), json=arguments.log == "json")
    crew = Crew(commands, console, patience)
    asked: list[tuple[int, float]] = []
    loop = asyncio.get_running_loop()

    def end(number: int) -> None:
        """End in order; signals within a second count as one, a second one changes nothing, the third ends at once."""
        if not asked or loop.time() - asked[-1][1] > 1.0:
            asked.append((number, loop.time()))
        if len(asked) > 2:
            crew.kill()
        crew.end()

    hear_interrupts()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, end, number)
    console.open()
    try:
        async with page:
            await crew.run(arguments.seconds)
    finally:
        lost = console.close()
    if lost:
        print(f"mdm team up: {lost} lines were lost, because nobody read them", file=sys.stderr)
    failed = {agent: count for agent, count in crew.failures.items() if count}
    for agent, count in failed.items():
        print(f"mdm team up: agent {agent!r} failed {count} {'time' if count == 1 else 'times'}", file=sys.stderr)
    return 1 if failed else 128 + asked[0][0] if asked else 0
