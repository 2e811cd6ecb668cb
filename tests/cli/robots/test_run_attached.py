"""`--attached`: a process ends with whoever started it."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager, suppress

import pytest
from programs import python

STARTER = """
import signal, subprocess, sys
command = [sys.executable, "-m", "mdm", "run", sys.argv[1], "--attached"]
robot = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
print(robot.pid, flush=True)
signal.signal(signal.SIGUSR1, lambda *_: robot.stdin.close())
sys.exit(robot.wait())
"""

ROBOT = """
import asyncio, time

def hold():
    print("holds", flush=True)
    time.sleep(SECONDS)
    print("lets go", flush=True)

async def drive():
    print("drives", flush=True)
    await asyncio.Event().wait()

def stop():
    print("stops", flush=True)

def cut():
    print("cuts", flush=True)
"""

FILE = """
emergency = "attached_robot:cut"
[predicates]
A = { initial = true }
[ensembles.robot]
policy = [0, 0]
safe_action = "attached_robot:stop"
[ensembles.robot.states]
a = ["A"]
[ensembles.robot.actions]
Go = "attached_robot:ACTION"
"""


@pytest.fixture
def starter(tmp_path):
    """Start a process that starts a robot; yield it when the robot acts."""

    @contextmanager
    def start(action, word, seconds=25):
        (tmp_path / "attached_robot.py").write_text(ROBOT.replace("SECONDS", str(seconds)))
        (tmp_path / "robot.toml").write_text(FILE.replace("ACTION", action))
        with python("-c", STARTER, tmp_path / "robot.toml") as process:
            robot = int(process.stdout.readline())
            try:
                assert process.stdout.readline() == word
                yield process
            finally:
                with suppress(ProcessLookupError):
                    os.kill(robot, signal.SIGKILL)

    return start


def test_one_whose_starter_is_killed_ends_in_order(starter):
    with starter("drive", "drives\n") as process:
        process.kill()
        assert process.stdout.read() == "stops\n"  # until the robot, which writes there as well, has ended


def test_one_whose_loop_is_held_ends_soon_after_its_starter(starter):
    with starter("hold", "holds\n") as process:
        process.kill()
        said = process.stdout.read()
    assert "cuts\n" in said
    assert "lets go" not in said


@pytest.mark.parametrize(("action", "said"), [("drive", "stops\n"), ("hold", "cuts\nlets go\nstops\n")])
def test_one_whose_starter_lives_has_the_time_that_it_needs(starter, action, said):
    with starter(action, f"{action}s\n", seconds=5) as process:
        process.send_signal(signal.SIGUSR1)
        assert process.stdout.read() == said
