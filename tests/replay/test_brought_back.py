"""A robot that was brought back stopped: what its file told is in the record, and replayed without it."""

from __future__ import annotations

import asyncio

import pytest
from team_robots import Robot, over_beliefs, three

import mdm
from mdm.recording import Record
from mdm.replay.replay import replay, transports_of
from mdm.team.storage import path_of
from mdm.team.team import Team
from mdm.team.transport.network import Network

NAMES = ["r0", "r1", "r2"]


class Played(Robot):
    """A robot whose transport is that of a record."""

    def __init__(self, team, name, transport):
        class Wire:
            def transport(self, _):
                return transport

        super().__init__(team, name, Wire(), over_beliefs(three()))


async def lives(team, path, commands):
    """Run a team for some seconds, and tell each agent its commands; record that of the first one."""
    records = {name: path if name == "r0" else None for name in NAMES}
    runtimes = [mdm.Runtime(log=None, record=records[name]) for name in NAMES]
    network = Network(runtimes[0].clock, team="squad")
    robots = [Robot(team, name, network, over_beliefs(three())) for name in NAMES]
    async with runtimes[0], runtimes[1], runtimes[2]:
        for robot, runtime in zip(robots, runtimes, strict=True):
            await robot.start(runtime)
        for command in commands:
            await asyncio.sleep(2.0)
            getattr(robots[1].ensemble, command)()
        await asyncio.sleep(2.0)
        for runtime in runtimes:
            runtime.shut_down()


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_a_record_has_what_was_kept(mode, tmp_path):
    team = Team("squad", NAMES, mode=mode, period=0.5, lease=0.5, state=tmp_path / "state")
    mdm.run(lambda: lives(team, None, ["stop"]), virtual=True)
    kept = path_of(team.state, "squad", "r0").read_bytes()
    mdm.run(lambda: lives(team, tmp_path / "r0.mcap", ["start"]), virtual=True)
    path_of(team.state, "squad", "r0").write_bytes(kept)  # which a replay neither reads nor writes
    record = Record(tmp_path / "r0.mcap")
    [recalled] = [one for one in record.messages(["stimuli"]) if type(one.message).__name__ == "Recalled"]
    assert recalled.message.ensemble == "joint"
    transports = transports_of(record)
    played = replay(record, Played(team, "r0", transports["r0"]).member, transports=transports)
    assert played.same
    assert played.replayed >= 3
    assert path_of(team.state, "squad", "r0").read_bytes() == kept
