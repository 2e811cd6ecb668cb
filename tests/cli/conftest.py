"""The `mdm` command in this process."""

from __future__ import annotations

import io
import sys

import pytest

from mdm.cli import main


@pytest.fixture
def mdm(capsys, monkeypatch):
    """Run the command in this process; return exit status, output lines and error text."""

    def call(*arguments, stdin=""):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        monkeypatch.setattr(sys, "path", list(sys.path))
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return call
