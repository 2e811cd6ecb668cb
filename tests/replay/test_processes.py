"""Runs of robots in processes of their own, in wall time, and however they end: each is repeated from its record."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys

import pytest
from patience import PATIENCE
from places import EXAMPLES
from programs import python
from records import wait_until_written

from mdm.messages import Answer
from mdm.recording import Record
from mdm.stimuli import Finished, Said
from mdm.testing import replay

CODE = """
import asyncio, random

draw = random.Random(1)

async def sense(system):
    told = 0
    while True:
        await asyncio.sleep(draw.uniform(0.001, 0.02))
        system.predicates.sense(draw.choice(["Near", "Bright"]), draw.random() < 0.5)
        told += 1
        if told == 100:
            print("told", flush=True)

async def go():
    await asyncio.sleep(draw.choice([0, 0.003, 1]))
    if draw.random() < 0.2:
        raise ValueError("as it was meant to be")

def turn():
    pass

async def safe():
    await asyncio.sleep(0.01)
"""

FILE = """
tasks = ["a_robot:sense"]

[predicates]
Near = { initial = false, max_age = 0.05 }
Bright = { initial = false }
Held = { formula = "Near", held_for = 0.01 }
Done = { set = "go.succeeded", reset = "Bright" }

[ensembles.robot]
policy = [0, 1, 1, 0, 0, 1, 0, 1]
safe_action = "a_robot:safe"
on_failed_action = "decide"
on_lost_input = "continue"

[ensembles.robot.states]
held = ["Held"]
bright = ["Bright"]
done = ["Done"]

[ensembles.robot.actions]
go = { call = "a_robot:go", timeout = 0.05 }
turn = "a_robot:turn"
"""


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "a_robot.py").write_text(CODE)
    (tmp_path / "robot.toml").write_text(FILE)
    return tmp_path / "robot.toml"


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGTERM, 143), pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow), (signal.SIGKILL, -9)],
)
def test_a_run_that_a_signal_ends_is_repeated(robot, tmp_path, number, status):
    path = tmp_path / "run.mcap"
    with python("-m", "mdm", "run", robot, "--record", path) as process:
        assert process.stdout.readline() == "told\n"
        process.send_signal(number)
        assert process.wait(PATIENCE) == status
        wait_until_written(path)  # by a process of its own, which completes the record of one that was killed, too
    ended = [each for each in Record(path).messages(["stimuli"]) if isinstance(each.message, Finished)]
    assert len(ended) == (number is not signal.SIGKILL)
    assert replay(path) > 20


SEARCH = """
tasks = ["a_world:live"]

[events]
HearLeft = {}
HearRight = {}

[ensembles.tiger]
model = "tiger.pomdp"
policy = "tiger.vf"
search = { seconds = 0.02 }
deadline = 0.4

[ensembles.tiger.observations]
ears = { hear-left = "HearLeft", hear-right = "HearRight" }

[ensembles.tiger.actions]
listen = "a_world:act"
open-left = "a_world:act"
open-right = "a_world:act"
"""

WORLD = """
import asyncio, random, time

def act():
    pass

async def live(system):
    draw = random.Random(2)
    tiger = system.ensembles["tiger"]
    await asyncio.sleep(0)
    await tiger.ready()
    number = 0
    while tiger.control.decisions <= 12:  # a busy machine decides on fewer of these
        system.predicates.occur(draw.choice(["HearLeft", "HearRight"]))
        if number % 5 == 2:
            time.sleep(0.5)  # the deadline passes meanwhile
        await asyncio.sleep(draw.choice([0.01, 0.05]))
        number += 1
    print("told", flush=True)
    await asyncio.Event().wait()
"""


@pytest.mark.slow
def test_searches_answer_as_they_did(tmp_path, monkeypatch):
    monkeypatch.setenv("MDM_COMPILE", "0")  # the compiler loads longer than they search
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, tmp_path)
    (tmp_path / "a_world.py").write_text(WORLD)
    (tmp_path / "robot.toml").write_text(SEARCH)
    path = tmp_path / "run.mcap"
    with python("-m", "mdm", "run", tmp_path / "robot.toml", "--record", path) as process:
        assert process.stdout.readline() == "told\n"
        process.terminate()
        assert process.wait(PATIENCE) == 143
    said = [each.message for each in Record(path).messages(["stimuli"]) if isinstance(each.message, Said)]
    assert {each.message.source for each in said if each.type == Answer.__name__} == {"search", "fallback"}
    assert replay(path) > 10


@pytest.mark.parametrize(
    "options",
    [
        ["--virtual", "--seconds", "12"],
        pytest.param(["--virtual", "--seconds", "90"], marks=pytest.mark.slow),
        pytest.param(["--seconds", "4"], marks=pytest.mark.slow),
    ],
)
def test_the_demo_is_repeated(tmp_path, options):
    pytest.importorskip("navground")
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "mdm", "run", EXAMPLES / "patrol" / "patrol.toml", "--record", path, *options]
    subprocess.run(list(map(str, command)), check=True, capture_output=True, timeout=PATIENCE)
    assert replay(path) > 1
