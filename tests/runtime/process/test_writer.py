"""The log's thread: a log that nobody reads, or that nobody can write, costs lines and nothing else."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading

import pytest
from patience import PATIENCE
from programs import python

from mdm import Actor, Runtime, run
from mdm.messages import Fault
from mdm.runtime.process.writer import Stream, Writer

ROBOT = """
import json, os, sys
import mdm
from mdm.policies import DeterministicPolicy

def safe():
    os.write(1, b"safe\\n")

def go():
    os.write(1, b"go\\n")

robot = mdm.Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={"go": go}, safe_action=safe)

async def main():
    async with mdm.Runtime() as runtime:
        await runtime.start(robot)
        for number in range(3000):
            robot.report("noise", "a line of a hundred characters " * 3 + str(number))
        robot.publish_state(0)
        try:
            await runtime.wait()
        finally:
            left.append(runtime)

left = []
try:
    mdm.run(main)
finally:
    found = left[0].statistics().log
    os.write(1, f"{found.written} {found.lost}\\n".encode())
"""


def followed_to_its_end(process):
    """Return what a robot said until it was terminated, after it began."""
    lines = [process.stdout.readline()]
    process.send_signal(signal.SIGTERM)
    lines += process.stdout.read().splitlines(keepends=True)
    return [line.strip() for line in lines]


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "robot.py"
    path.write_text(ROBOT)
    return path


def test_colours_are_for_terminals_where_they_are_wanted(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    ours, theirs = os.openpty()
    with open(ours, "w") as terminal, open(theirs, "w"), open(os.devnull, "w") as file:  # noqa: PTH123
        assert Stream(terminal, bool).colours
        assert not Stream(file, bool).colours
        assert not Stream(None, bool).colours
        monkeypatch.setenv("NO_COLOR", "1")
        assert not Stream(terminal, bool).colours


class Console:
    """As programs with a window of their own set standard error."""

    def __init__(self, **given):
        self.text = ""
        vars(self).update(given)

    def write(self, text):
        self.text += text


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"encoding": None, "errors": None},
        {"fileno": lambda: None, "isatty": lambda: False},
        {"fileno": lambda: 1 / 0, "isatty": lambda: None},
        {"flush": lambda: None, "isatty": lambda: True},
    ],
)
def test_standard_error_need_be_none_of_the_operating_system(given, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    console = Console(**given)
    monkeypatch.setattr("sys.stderr", console)

    async def main():
        async with Runtime(log="console") as runtime:
            await runtime.start(Actor("gripper"))
            runtime.root.report("action", "stuck at \u2192")
        return runtime.statistics().log

    log = run(main)
    assert (log.written > 2, log.lost) == (True, 0)
    assert "gripper" in console.text
    assert "stuck at \u2192" in console.text


def test_a_stream_without_an_encoding_takes_utf_8():
    reading, writing = os.pipe()
    with open(reading, "rb") as end:  # noqa: PTH123
        Stream(Console(fileno=lambda: writing, encoding=None), bool).write("\u2192")
        os.close(writing)
        assert end.read() == "\u2192\n".encode()


def test_standard_error_that_nobody_reads_does_not_hold_the_robot(program):
    with python(program) as process:
        *done, counts = followed_to_its_end(process)
        assert process.wait(PATIENCE) == 143
    assert done == ["go", "safe"]
    written, lost = map(int, counts.split())
    assert 0 < written < 3000
    assert lost > 0
    assert written + lost > 3000


def test_a_closed_standard_error_does_not_end_the_robot(program):
    with python(program) as process:
        process.stderr.close()
        *done, counts = followed_to_its_end(process)
        process.wait(PATIENCE)
        process.stderr = None
    assert done == ["go", "safe"]
    assert int(counts.split()[1]) > 2000


@pytest.mark.parametrize("shell", ["exec {} {} 2>&-", "ulimit -f 4; exec {} {} 2>log"])
def test_no_standard_error_and_one_that_is_full_do_not_end_the_robot(program, shell):
    command = shell.format(sys.executable, program)
    process = subprocess.Popen(["/bin/sh", "-c", command], stdout=subprocess.PIPE, text=True, cwd=program.parent)
    try:
        *done, counts = followed_to_its_end(process)
        process.wait(PATIENCE)
    finally:
        process.kill()
        process.communicate()
    assert done == ["go", "safe"]
    assert int(counts.split()[1]) > 2000


def test_every_line_that_is_read_is_there_in_order():
    program = (
        "import mdm\n"
        "async def main():\n"
        "    async with mdm.Runtime(log='json') as runtime:\n"
        "        for number in range(2000):\n"
        "            runtime.root.report('noise', str(number) + 'ä' * 200)\n"
        "mdm.run(main)\n"
    )
    with python("-c", program) as process:
        lines = [json.loads(line) for line in process.communicate(timeout=PATIENCE)[1].splitlines()]
    assert [line["detail"] for line in lines] == [f"{number}" + "ä" * 200 for number in range(2000)]


def test_a_logger_that_waits_or_fails_costs_lines_alone():
    hold, let_go = threading.Event(), []

    class Slow:
        def debug(self, event, **fields):
            raise ValueError(event)

        info = debug

        def error(self, event, **fields):
            if fields["detail"] == "0":
                let_go.append(hold.wait(PATIENCE))
            raise ValueError(event)

    async def main():
        async with Runtime(log=Slow()) as runtime:
            for number in range(10_000):
                runtime.faults.publish(Fault(0, "a", "b", str(number)))
            hold.set()
        return runtime.statistics().log

    found = run(main)
    assert let_go == [True]  # by the program, which had not waited for it
    assert (found.written, found.lost) == (0, 10_001)  # the fault that tells of it is a line, too
    assert not [thread for thread in threading.enumerate() if thread.name == "mdm:log"]


def test_what_waits_for_a_writer_that_does_not_end_is_left():
    hold, let_go = threading.Event(), []
    writer = Writer()
    writer.open()
    writer.put(lambda _: let_go.append(hold.wait(PATIENCE)), None)
    writer.close(0.01)
    assert let_go == []
    hold.set()
