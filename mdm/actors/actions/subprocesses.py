"""Subprocesses of actions: programs that end when the action does, with all that they have begun."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.errors import Error
from mdm.runtime.time.clock import check_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.checks import Number

_FIRST_PAUSE, _LAST_PAUSE = 0.001, 0.1


async def run_subprocess(
    *command: str | os.PathLike[str],
    grace: Number = 2.0,
    cwd: str | os.PathLike[str] | None = None,
    env: Mapping[str, str] | None = None,
) -> None:
    """Run a program and wait for its end, for use in an action; cancelled, the program ends before this does.

    The program leads a process group (and session) of its own. When it ends, or the action is cancelled, SIGTERM goes
    to all that is left in that group, and SIGKILL to those that have not ended `grace` seconds later; this returns when
    nothing of it lives. A second cancellation sends SIGKILL at once. Processes that leave the group, as daemons do, are
    not ended. Standard output and error are the caller's, standard input is empty.

    A subprocess takes real time: in virtual time, its `grace` is over at once.

    Args:
        command: The program and its arguments; no shell reads them.
        grace: Seconds that its processes have to end after SIGTERM. Let it be shorter than the action's own `grace`,
            after which the action counts as abandoned.
        cwd: The directory that it runs in; by default the caller's.
        env: Its environment variables; by default the caller's.

    Raises:
        Error: If it cannot be run, ends with another status than 0, or by a signal.

    Example:
        >>> robot = mdm.Ensemble("robot", policy=[0], actions={"Dock": lambda: mdm.run_subprocess("dock", "--slowly")})
    """
    check_seconds(grace, "grace", key="grace")
    group = _Group(_begin(command, cwd, env))
    try:
        try:
            await group.wait()
        except asyncio.CancelledError:
            await group.end(grace)
            raise
        await group.end(grace)
    except BaseException:
        group.kill()
        raise
    status = group.status
    if status:
        how = f"with status {status}" if status > 0 else f"by {_name(-status)}"
        raise Error(f"the subprocess {os.fspath(command[0])!r} ended {how}")


def _begin(
    command: tuple[str | os.PathLike[str], ...], cwd: str | os.PathLike[str] | None, env: Mapping[str, str] | None
) -> subprocess.Popen[bytes]:
    if not command:
        raise Error("a subprocess needs a program to run: its name is the first argument")
    if not hasattr(os, "killpg"):
        raise Error("subprocesses of actions need process groups, which this operating system lacks")
    try:
        return subprocess.Popen(  # noqa: S603 - the caller chooses the command
            command, stdin=subprocess.DEVNULL, cwd=cwd, env=env, start_new_session=True
        )
    except (OSError, TypeError, ValueError, subprocess.SubprocessError) as error:
        raise Error(f"the subprocess {command[0]!r} cannot be run: {error}") from error


class _Group:
    """The process group that a subprocess leads.

    Args:
        leader: The subprocess, which has just begun.
    """

    def __init__(self, leader: subprocess.Popen[bytes]) -> None:
        self._leader = leader

    @property
    def status(self) -> int | None:
        """The leader's status, the negative number of a signal that ended it, or None while it lives."""
        return self._leader.poll()

    async def wait(self) -> None:
        """Wait until the leader has ended."""
        try:
            descriptor = os.pidfd_open(self._leader.pid)
        except (AttributeError, OSError):  # no such thing here, or no room for one
            pause = _FIRST_PAUSE
            while self.status is None:
                await asyncio.sleep(pause)
                pause = min(2 * pause, _LAST_PAUSE)
            return
        loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        try:
            loop.add_reader(descriptor, ended.set)
            await ended.wait()
        finally:
            loop.remove_reader(descriptor)
            os.close(descriptor)

    async def end(self, grace: Number) -> None:
        """End all that lives in the group, and wait for it: by SIGTERM, and `grace` seconds later by SIGKILL."""
        if not self.lives():
            return
        self.send(signal.SIGTERM)
        loop = asyncio.get_running_loop()
        began, pause = loop.time(), _FIRST_PAUSE
        while self.lives():
            if loop.time() - began >= grace:
                self.send(signal.SIGKILL)
            await asyncio.sleep(pause)
            pause = min(2 * pause, _LAST_PAUSE)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to all that lives in the group."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._leader.pid, number)

    def kill(self) -> None:
        """Send SIGKILL to all that lives in the group, and wait for the leader, for a moment at most."""
        self.send(signal.SIGKILL)
        with suppress(subprocess.TimeoutExpired):
            self._leader.wait(_LAST_PAUSE)

    def lives(self) -> bool:
        """Whether anything in the group lives."""
        leading = self.status is None  # if not, it is no zombie from now on
        try:
            os.killpg(self._leader.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # it runs as another user
            return True
        return leading or _has_members(self._leader.pid)


def _has_members(group: int) -> bool:
    """Whether a process group has members besides zombies.

    These stay where nobody takes in orphans, as in containers whose first process is the robot's.
    """
    processes = Path("/proc")
    if not (processes / "self" / "stat").exists():
        return True  # nobody tells more than that there is some process
    for process in processes.iterdir():
        if process.name.isdecimal():
            with suppress(OSError):  # it has just ended
                # After the name, which may hold anything: the state, the parent, and the group.
                state, _, its_group = (process / "stat").read_bytes().rpartition(b")")[2].split()[:3]
                if int(its_group) == group and state not in {b"Z", b"X"}:
                    return True
    return False


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # one of real time
        return f"signal {number}"
