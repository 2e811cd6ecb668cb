"""The `mdm` command in this process."""

from __future__ import annotations

import io
import json
import sys

import pytest
from places import TIGER_VECTORS

from mdm import load_policy, save_policy
from mdm.cli import main
from mdm.compilation import COMPILE_TIME
from mdm.policies import AlphaVectors


@pytest.fixture
def mdm(capsys, monkeypatch):
    """Run the command in this process; return exit status, output lines and error text.

    For what counts episodes no time passes: how far it has come is not told, however long it takes.
    """
    monkeypatch.setattr("mdm.cli.progress.perf_counter", lambda: 0.0)

    def call(*arguments, stdin=""):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        monkeypatch.setattr(sys, "path", list(sys.path))
        monkeypatch.setattr(COMPILE_TIME, "go_on", lambda: None)  # whether kernels are kept on disk is not its matter
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return call


@pytest.fixture
def facts(mdm, monkeypatch):
    """Run the command with --json; return the object that it printed.

    How far a solver has come is not told, however long a busy machine takes.
    """
    monkeypatch.setattr("mdm.cli.progress.ProgressLine.__call__", lambda line, progress: None)

    def call(*arguments):
        status, output, errors = mdm(*arguments, "--json")
        assert (status, errors) == (0, "")
        return json.loads(output[0])

    return call


@pytest.fixture
def shifted(tmp_path):
    """Write the tiger's vectors with a number added to all; return the file."""

    def write(by):
        policy = load_policy(TIGER_VECTORS)
        save_policy(AlphaVectors(policy.vectors + by, policy.actions), tmp_path / "shifted.npz")
        return tmp_path / "shifted.npz"

    return write
