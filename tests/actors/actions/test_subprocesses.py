"""Programs as actions, as real processes: they end with the action, and with them all that they have begun.

Each process holds a pipe open for writing, so that its reader knows, without asking anybody, when all of them are gone.
"""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest
from action_lives import lives_of, robot, told
from patience import PATIENCE
from programs import python
from sentences import refused

from mdm import ConfigError, Error, Runtime, bind, run, run_subprocess
from mdm.actors.actions.subprocesses import _has_members

READY = "echo ready >&3"
# The trap is that of the shell alone, which waits, when this is ready, for what SIGTERM ends.
BRAKES = f"trap 'echo braked >&3; exit 0' TERM; ({READY}; exec sleep 1000)"


class Pipe:
    """A named pipe that a shell and what it begins hold open, as descriptor 3."""

    def __init__(self, path):
        os.mkfifo(path)
        self.path = path
        self.end = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self.text = ""

    def shell(self, script, **options):
        """Run a script of the shell."""
        return run_subprocess("sh", "-c", f"exec 3>{self.path}; {script}", **options)

    async def ready(self, number=1):
        """Wait until so many have said that they are ready."""
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(PATIENCE):
            while self.text.count("ready") < number:
                readable = loop.create_future()
                loop.add_reader(self.end, lambda future=readable: future.done() or future.set_result(None))
                await readable
                loop.remove_reader(self.end)
                with suppress(BlockingIOError):  # it was closed, and is open again
                    self.text += os.read(self.end, 4096).decode()

    @property
    def closed(self):
        """Whether all who held it have ended."""
        try:
            while data := os.read(self.end, 4096):
                self.text += data.decode()
        except BlockingIOError:
            return False
        return True


@pytest.fixture
def pipe(tmp_path):
    made = Pipe(tmp_path / "pipe")
    yield made
    os.close(made.end)


@pytest.fixture(params=["pidfd", "polled"])
def waiting(request, monkeypatch):
    """However the end of a process is noticed."""
    if request.param == "polled":
        monkeypatch.delattr(os, "pidfd_open", raising=False)
    return request.param


@pytest.mark.usefixtures("waiting")
def test_it_returns_when_the_program_has_ended_well(pipe, tmp_path):
    async def main():
        await pipe.shell("echo $PWD $SHELF $# >&3; cat >&3", cwd=tmp_path, env={"SHELF": "top"})

    run(main)
    assert pipe.closed
    assert pipe.text.split() == [str(tmp_path.resolve()), "top", "0"]


@pytest.mark.usefixtures("waiting")
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("exit 3", "the subprocess 'sh' ended with status 3"),
        ("kill -SEGV $$", "the subprocess 'sh' ended by SIGSEGV"),
        ("kill -40 $$", "the subprocess 'sh' ended by signal 40"),
    ],
)
def test_another_end_is_a_failure(script, words):
    with pytest.raises(Error, match=words):
        run(lambda: run_subprocess("sh", "-c", script))


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        ((), {}, "a subprocess needs a program to run"),
        (("no-such-program",), {}, "the subprocess 'no-such-program' cannot be run: .*No such file"),
        (("true",), {"cwd": "/no/such/folder"}, "the subprocess 'true' cannot be run: .*No such file.*/no/such/folder"),
        (("true", 5), {}, "the subprocess 'true' cannot be run: .*int"),
        (("true", "\0"), {}, "the subprocess 'true' cannot be run: embedded null byte"),
    ],
)
def test_what_cannot_be_run_is_an_error_in_a_sentence(command, options, words):
    with pytest.raises(Error, match=words):
        run(lambda: run_subprocess(*command, **options))


@pytest.mark.parametrize("grace", [0, -1.0, "2", None])
def test_grace_is_a_time(grace):
    with refused(ConfigError):
        run(lambda: run_subprocess("true", grace=grace))


def test_without_process_groups_nothing_is_run(monkeypatch):
    monkeypatch.delattr(os, "killpg")
    with refused(Error):
        run(lambda: run_subprocess("true"))


async def cancelled(pipe, script, ready=1, **options):
    """Run a script, cancel it when it is ready, and return how many seconds its end took."""
    task = asyncio.create_task(pipe.shell(script, **options))
    await pipe.ready(ready)
    began = time.monotonic()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    return time.monotonic() - began


@pytest.mark.usefixtures("waiting")
def test_cancelled_it_lets_the_program_end_by_itself(pipe):
    async def main():
        await cancelled(pipe, BRAKES, grace=60.0)
        assert pipe.closed

    run(main)
    assert pipe.text.split() == ["ready", "braked"]


@pytest.mark.usefixtures("waiting")
def test_a_program_that_ignores_being_terminated_is_killed(pipe):
    async def main():
        took = await cancelled(pipe, f"trap '' TERM; {READY}; sleep 1000; sleep 1000", grace=0.3)
        assert pipe.closed
        assert took >= 0.3

    run(main)


CHILDREN = f"(trap '' TERM; {READY}; sleep 1000) & (sleep 1000 & {READY}; wait) & {READY}"


@pytest.mark.usefixtures("waiting")
def test_what_the_program_has_begun_ends_with_it(pipe):
    async def main():
        await cancelled(pipe, f"{CHILDREN}; wait", ready=3, grace=0.2)
        assert pipe.closed

    run(main)


@pytest.mark.usefixtures("waiting")
def test_what_the_program_leaves_behind_ends_when_it_has_ended(pipe):
    async def main():
        await pipe.shell(CHILDREN, grace=0.2)
        assert pipe.closed

    run(main)


def test_a_second_cancellation_kills_at_once(pipe):
    async def main():
        task = asyncio.create_task(pipe.shell(f"trap '' TERM; {READY}; sleep 1000", grace=1e6))
        await pipe.ready()
        for _ in range(2):
            task.cancel()
            await asyncio.sleep(0)
        with pytest.raises(asyncio.CancelledError):
            await task
        while not pipe.closed:  # what has been killed takes a moment
            await asyncio.sleep(0.001)

    run(main)


def test_what_nobody_awaits_to_its_end_is_killed(pipe):
    async def main():
        shell = pipe.shell(f"trap '' TERM; {READY}; sleep 1000", grace=1e6)
        shell.send(None)  # it has begun, and waits
        await pipe.ready()
        shell.close()
        gc.collect()
        while not pipe.closed:
            await asyncio.sleep(0.001)

    run(main)


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="there is nothing to wait on")
def test_where_the_end_cannot_be_waited_for_nothing_is_left(pipe, monkeypatch):
    opened = []
    real = os.pidfd_open
    monkeypatch.setattr(os, "pidfd_open", lambda process: opened.append(real(process)) or opened[-1])

    class Broken(asyncio.SelectorEventLoop):
        def add_reader(self, *_):
            raise OSError("no more descriptors")

    with asyncio.Runner(loop_factory=Broken) as runner, refused(OSError):
        runner.run(pipe.shell("sleep 1000"))
    os.set_blocking(pipe.end, True)
    assert os.read(pipe.end, 1) == b""  # when what was killed has gone
    with refused(OSError):
        os.fstat(opened[0])


def test_a_zombie_is_no_member_of_a_group():
    """Where nobody takes in orphans, as in containers whose first process is the robot, they stay zombies."""
    with subprocess.Popen(["true"], start_new_session=True) as process:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        os.killpg(process.pid, 0)  # it is there
        assert not _has_members(process.pid) or not Path("/proc/self/stat").exists()
    with subprocess.Popen(["sleep", "1000"], start_new_session=True) as process:
        assert _has_members(process.pid)
        process.kill()


def test_the_next_action_begins_when_the_process_has_gone(pipe):
    """By a decision of the ensemble; and the safe action at the end of the runtime."""
    seen = []

    async def main():
        async with Runtime(log=None) as runtime:
            ensemble = robot(
                {
                    "Drive": bind(lambda: pipe.shell(BRAKES, grace=60.0), grace=120.0),
                    "Stop": lambda: seen.append(("Stop", pipe.closed)),
                },
                safe_action=lambda: seen.append(("SAFE", pipe.closed)),
            )
            await runtime.start(ensemble)
            lives = lives_of(runtime)
            ensemble.publish_state(0)
            await pipe.ready()
            ensemble.publish_state(1)
            while not seen:
                await asyncio.sleep(0.001)
            assert told(lives) == [
                ("Drive", "running"),
                ("Drive", "preempted"),
                ("Stop", "running"),
                ("Stop", "succeeded"),
            ]
            pipe.text = ""
            ensemble.publish_state(0)
            await pipe.ready()

    run(main)
    assert seen == [("Stop", True), ("SAFE", True)]


ROBOT = """
import sys
import mdm

def go():
    return mdm.run_subprocess("sh", "-c", sys.argv[1])

async def main():
    async with mdm.Runtime() as runtime:
        robot = mdm.Ensemble("robot", policy=[0], actions={"Go": go})
        await runtime.start(robot)
        robot.publish_state(0)
        await runtime.wait()

mdm.run(main)
"""


def test_a_signal_that_ends_the_robot_ends_the_process_too(pipe):
    with python("-c", ROBOT, f"exec 3>{pipe.path}; {BRAKES}") as process:
        asyncio.run(pipe.ready())
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 143
        assert pipe.closed
    assert "braked" in pipe.text
