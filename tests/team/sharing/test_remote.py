"""Channels of other agents."""

from __future__ import annotations

import asyncio

import msgspec
import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused
from team_robots import Robot, over_beliefs

import mdm
from mdm import problems
from mdm.messages import Belief, Decision, State
from mdm.team.sharing.remote import Wire, typed
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual


class Pose(msgspec.Struct, frozen=True):
    x: float
    y: float


def test_messages_with_arrays_come_through():
    wire = Wire(Belief)
    sent = Belief(7, np.array([0.25, 0.75]))
    got = wire.decode(wire.encode(sent))
    assert got.time == 7
    np.testing.assert_array_equal(got.probabilities, [0.25, 0.75])
    assert not got.probabilities.flags.writeable
    made = Decision(1, "e", 0, "start", None, (1, None), None, 2, "go", 0.5)
    assert Wire(Decision).decode(Wire(Decision).encode(made)) == made


@given(st.binary(max_size=60))
def test_garbage_is_refused(data):
    for kind in (Belief, State, Decision):
        try:
            message = Wire(kind).decode(data)
        except mdm.Error:
            continue
        assert isinstance(message, kind)


def test_what_cannot_be_sent_is_refused():
    class Odd:
        pass

    class Holder(msgspec.Struct):
        one: Odd | int | list[Odd]

    with refused(mdm.ConfigError):
        Wire(Holder)
    with refused(mdm.ConfigError):
        typed(["patrol/pose"], "exports")
    with refused(mdm.ConfigError):
        typed("patrol/pose", "exports")
    assert typed(["patrol/belief"], "exports") == {"patrol/belief": Belief}


def test_a_channel_is_imported_with_its_last_message_and_forgotten_with_its_owner():
    model = problems.dec_tiger()

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        team = Team("tigers", ["left", "right"])
        build = over_beliefs(model)

        def member(name, **options):
            robot = Robot.__new__(Robot)
            robot.name, robot.did, robot.commits, robot.beliefs, robot.faults = name, [], [], [], []
            robot.ensemble = build(robot, team.names.index(name))
            robot.member = team.member(name, robot.ensemble, transport=network.transport(name), **options)
            return robot

        left = member("left", exports={"joint/belief": Belief, "pose": Pose})
        await left.start(runtime)
        await asyncio.sleep(1.0)
        right = member("right", imports={"left/joint/belief": Belief, "left/pose": Pose})
        await right.start(runtime)
        await asyncio.sleep(1.0)
        belief = right.member.imported("left/joint/belief")
        np.testing.assert_array_equal(belief.last.probabilities, [0.5, 0.5])
        poses = probe(right.member.imported("left/pose"))
        left.member.channel("pose", Pose).publish(Pose(1.0, 2.0))
        left.observe("hear-left", None)
        await asyncio.sleep(0.5)
        assert poses == [Pose(1.0, 2.0)]
        np.testing.assert_allclose(belief.last.probabilities, [0.85, 0.15])
        with refused(mdm.Error):
            right.member.imported("left/joint/action")
        network.crash("left")
        await asyncio.sleep(1.0)
        assert belief.last is None

    run_virtual(main)


def test_imports_are_of_other_agents():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team, build = Team("tigers", ["left", "right"]), over_beliefs(problems.dec_tiger())
        robot = Robot(team, "left", network, build)
        for name, words in (("middle/joint/belief", "has no agent 'middle'"), ("left/joint/belief", "another agent's")):
            with pytest.raises(mdm.ConfigError, match=words):
                team.member("left", build(robot, 0), transport=network.transport("left"), imports=[name])

    run_virtual(main)
