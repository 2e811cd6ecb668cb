"""What members leave behind when they have ended, in order or not: nothing."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import subprocess
import sys
from collections import deque

import pytest
from places import ROOT
from team_robots import over_beliefs, started
from teams import team as random_team

from mdm.actors.actions import action_layer
from mdm.actors.control import output
from mdm.runtime import statistics
from mdm.team.agreement import agreement
from mdm.team.agreement.state import Log
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

PROGRAM = ROOT / "tests" / "leftover_program.py"


@pytest.mark.slow
def test_members_that_come_and_go_leave_no_thread_file_or_process(tmp_path):
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
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


@pytest.mark.parametrize(
    ("mode", "period", "steps"),
    [
        *(("replicated", 0.1, 500), ("replicated", None, 500), ("centralised", 0.1, 500), ("communicating", 0.1, 500)),
        pytest.param("replicated", 0.1, 5000, marks=pytest.mark.slow),
        pytest.param("replicated", None, 2000, marks=pytest.mark.slow),
        pytest.param("centralised", 0.1, 2000, marks=pytest.mark.slow),
        pytest.param("communicating", 0.1, 1000, marks=pytest.mark.slow),
    ],
)
def test_memory_does_not_grow_with_the_steps(mode, period, steps, monkeypatch):
    for module in (statistics, output, action_layer):  # latencies wait to be counted, a few of each kind
        monkeypatch.setattr(module, "FULL", 16)
    if steps < 1000:  # too few to fill a log of the usual size
        monkeypatch.setattr(agreement, "Log", lambda size, agents: Log(4, agents))

    async def main(runtime):
        network = Network(runtime.clock, team="team", loss=0.05, seed=1)
        team = Team("team", ["a", "b"], period=period, mode=mode)
        robots = await started(runtime, team, network, over_beliefs(random_team(7, agents=2)))
        for robot in robots:
            robot.commits, robot.beliefs, robot.did, robot.faults = (deque(maxlen=1) for _ in range(4))
        await asyncio.sleep(3.0)
        blocks = []
        for _ in range(20):
            for step in range(steps // 20):
                robots[step % 2].observe(*(0 if each == step % 2 else None for each in range(2)))
                await asyncio.sleep(0.1)
            gc.collect()
            blocks.append(sys.getallocatedblocks())
        assert robots[0].commits[-1].step >= 0.9 * steps
        early, late = blocks[8:14], blocks[14:]
        assert max(late) < max(early) + 0.3 * steps  # not an object a step

    run_virtual(main)
