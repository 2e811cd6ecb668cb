"""Members in processes of their own over real sessions: what they decide is the same, whatever befalls them."""

from __future__ import annotations

import asyncio
import json
import signal
from argparse import Namespace
from types import SimpleNamespace

import pytest
from patience import PATIENCE
from peers import peers
from places import ROOT
from team_robots import Robot, over_beliefs
from teams import team as random_team
from transports import Loopback, endpoint

import mdm
from mdm.cli.team import decisions

PROGRAM = ROOT / "tests" / "member_program.py"

LONGEST_PAUSE = 20.0
"""Seconds: a lease is 1, but messages get lost and the machine may be busy."""


def endpoints(names):
    """Return a free endpoint of this machine for each agent."""
    return [(name, endpoint()) for name in names]


class Told:
    """The steps that a process has told."""

    def __init__(self, peer):
        self.peer = peer
        self.steps = []
        self.reading = asyncio.create_task(self.read())
        self.more = asyncio.Event()

    async def read(self):
        while line := await self.peer.process.stdout.readline():
            self.steps.append(json.loads(line))
            self.more.set()

    async def reach(self, count):
        """Wait until so many steps more were told."""
        wanted = len(self.steps) + count
        async with asyncio.timeout(PATIENCE):
            while len(self.steps) < wanted:
                self.more.clear()
                await self.more.wait()


def check_the_same(told):
    """No two processes tell another step for one (term, step)."""
    known = {}
    for each in told:
        for step in each.steps:
            key = (*step["term"], step["step"])
            what = {name: step[name] for name in ("input", "missing", "action", "digest")}
            assert known.setdefault(key, what) == what, key
    return known


async def run(folder, count, period, loss):
    names = "abcd"[:count]
    agents = endpoints(names)
    async with peers(PROGRAM, TMPDIR=str(folder / "temporary")) as start:
        seeds = iter(range(100))

        async def begin(agent):
            options = {"agent": agent, "agents": agents, "period": period, "loss": loss, "seed": next(seeds)}
            return Told(await start(**options, decisions=str(folder / f"{agent}.jsonl")))

        told: list[Told] = []
        try:
            await befall(names, told, begin)
        finally:
            for one in told:
                one.reading.cancel()
                await asyncio.gather(one.reading, return_exceptions=True)


async def befall(names, told, begin):
    """Let processes begin, come late, hang, crash and return; what they tell stays the same."""
    told += [await begin(agent) for agent in names[:-1]]
    first, second = told[:2]
    await second.reach(10)
    late = await begin(names[-1])
    told.append(late)
    await late.reach(10)
    late.peer.signal(signal.SIGSTOP)  # the others are enough to go on
    await second.reach(10)
    late.peer.signal(signal.SIGCONT)
    await late.reach(10)
    first.peer.signal(signal.SIGKILL)  # it leads
    await asyncio.gather(second.reach(10), late.reach(10))
    back = await begin("a")
    told.append(back)
    await asyncio.gather(back.reach(20), second.reach(20), late.reach(20))
    for one in told[1:]:
        one.peer.signal(signal.SIGTERM)
    statuses = [await one.peer.end() for one in told[1:]]
    await asyncio.gather(*(one.reading for one in told))
    check_the_same(told)
    assert statuses == [143] * len(statuses)
    shared = {step["step"] for step in second.steps} & {step["step"] for step in back.steps}
    assert len(shared) >= 20


@pytest.mark.slow
@pytest.mark.parametrize(("count", "period"), [(4, 0.05), (3, None)])
def test_processes_decide_the_same_through_crashes_hangs_and_losses(count, period, tmp_path, record_property):
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    asyncio.run(run(tmp_path, count, period, loss=0.3))
    assert list(temporary.iterdir()) == []
    assert {path.name for path in tmp_path.glob("*.jsonl")} == {f"{name}.jsonl" for name in "abcd"[:count]}
    assert decisions.run(Namespace(paths=[tmp_path], json=False)) == 0  # which prints how long nothing was decided
    told = decisions.tell(decisions.read([tmp_path]))["joint"]
    record_property("longest time without a decision", told.pause)
    assert told.shared >= 40
    assert told.pause < LONGEST_PAUSE


def test_a_process_and_an_agent_here_decide_the_same(tmp_path, monkeypatch):
    """The least that shows it. The compiler stays out: it loads longer than all the rest takes."""
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    monkeypatch.setattr("mdm.beliefs.choice.compiles", lambda model: False)
    agents = endpoints("ab")
    kept = tmp_path / "b.jsonl"

    async def main():
        net = Loopback(lease=1.0, listen=agents[0][1])
        team = mdm.Team("team", agents, period=0.05, lease=1.0)
        robot = Robot(team, "a", net, over_beliefs(random_team(7, agents=2)))
        async with peers(PROGRAM, MDM_COMPILE="0") as start, mdm.Runtime(log=None) as runtime:
            peer = await start(agent="b", agents=agents, period=0.05, loss=0.0, seed=1, decisions=str(kept))
            told = Told(peer)
            await robot.start(runtime)
            await told.reach(10)
            peer.signal(signal.SIGTERM)
            assert await peer.end() == 143
            await told.reading
        await net.close()
        return told, [json.loads(commit.line()) for commit in robot.commits]

    told, here = asyncio.run(main())
    assert [json.loads(line) for line in kept.read_text().splitlines()] == told.steps
    known = check_the_same([told])
    shared = [step for step in here if (*step["term"], step["step"]) in known]
    assert len(shared) >= 8
    check_the_same([told, SimpleNamespace(steps=here)])
