"""The process that searches ends with its input, and answers nothing that it was not asked."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from mdm.problems import tiger
from mdm.runtime.process.frames import HEADER, frame, unframed
from mdm.solvers import TreeSearch

PROGRAM = [sys.executable, "-c", "from mdm.solvers.online.worker import main; main()"]


def answers(data):
    while data:
        length = int.from_bytes(data[:HEADER], "big")
        yield unframed(data[HEADER : HEADER + length])
        data = data[HEADER + length :]


@pytest.mark.parametrize("given", [b"", b"\0\0\0", frame(TreeSearch(tiger(), expansions=1).parts())[:-5]])
def test_it_ends_where_its_input_does(given):
    done = subprocess.run(PROGRAM, input=given, capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_it_is_ready_then_answers_each_question():
    search = TreeSearch(tiger(), expansions=40, seed=2)
    question = (7, np.array([0, 1]), np.array([0.5, 0.5]))
    given = frame(search.parts()) + frame(question)
    done = subprocess.run(PROGRAM, input=given, capture_output=True)
    ready, (number, result) = answers(done.stdout)
    assert ready is None
    assert number == 7
    assert (done.returncode, done.stderr) == (0, b"")
    assert result.action == search.action([0.5, 0.5])


@pytest.mark.parametrize("tells", [False, True])
def test_whoever_asked_is_told_that_it_compiles(tells):
    program = f"""if True:
        from mdm.compilation import COMPILE_TIME
        from mdm.solvers.online import worker

        def compile_slowly(search):
            COMPILE_TIME.begin()
            COMPILE_TIME._began -= 5
            COMPILE_TIME.go_on()
            COMPILE_TIME.end()

        worker.Search.prepare = compile_slowly
        worker.main(tells={tells})
    """
    given = frame(TreeSearch(tiger(), expansions=1).parts())
    done = subprocess.run([sys.executable, "-c", program], input=given, capture_output=True)
    line = b"mdm: compiling the tree search, once on this machine; it takes some seconds\n"
    assert done.stderr == (line if tells else b"")
