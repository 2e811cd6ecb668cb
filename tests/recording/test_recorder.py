"""The recorder: its runs are recorded and repeated by the tests of replay."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("threadpoolctl")

_PROGRAM = """
from mdm.recording.recorder import environment

before = environment()
import scipy.linalg

assert before["blas"], "numpy has a library for linear algebra"
assert environment() == before, (before, environment())
"""


def test_the_environment_is_the_same_whatever_else_the_program_has_loaded():
    done = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
