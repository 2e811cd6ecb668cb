"""What members leave behind when they have ended, in order or not: nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from places import ROOT

pytest.importorskip("zenoh", reason="pip install 'markov-decision-making[team]'")

PROGRAM = ROOT / "tests" / "leftover_program.py"


def test_members_that_come_and_go_leave_no_thread_file_or_process(tmp_path):
    ended = subprocess.run(
        [sys.executable, PROGRAM, "3"], capture_output=True, text=True, timeout=100, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}", "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    rounds = [json.loads(line) for line in ended.stdout.splitlines()]
    assert len(rounds) == 3
    native = [each.pop("native") for each in rounds]
    assert native[-1] < native[0] + 14  # threads of Zenoh, which has some for all sessions: 14 more were opened
    for each in rounds:
        _, failed, used, _, twice = each.pop("failures")
        assert failed.endswith("a fault")
        assert "the port is in use" in used
        assert "is live already" in twice
        assert each == rounds[0]
        assert each["threads"] == ["MainThread"]
        assert not each["children"]
        assert not each["shared"]
        assert "socket" not in each["files"]
    assert list(tmp_path.iterdir()) == []
