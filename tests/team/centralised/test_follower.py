"""Agents for which another one decides: no word that the controller has not said holds one up for good."""

from __future__ import annotations

import asyncio

import msgspec
import pytest
from team_robots import over_beliefs, started

from mdm import problems
from mdm.team.centralised.messages import Proposal, encode
from mdm.team.team import Team
from mdm.team.transport.keys import join
from mdm.team.transport.network import Network
from mdm.team.transport.router import Packer
from mdm.testing import run_virtual

TEAM = Team("tigers", ["left", "right"], mode="centralised", lease=1.0)


def robots(main, **options):
    """Run with the controller's robot and another one, which have begun."""

    async def begun(runtime):
        network = Network(runtime.clock, team="tigers", lease=1.0)
        left, right = await started(runtime, TEAM, network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(2.0)
        assert (left.role, right.role) == ("leading", "following")
        assert right.did == ["listen"]
        await main(left, right)

    run_virtual(begun)


def speak(owner, receiver, channel, body):
    """Have a receiver hear what an agent would say next, which it does not."""
    key = join("tigers", owner.name, "joint", channel)
    transport, clock = receiver.transport, receiver.runtime.clock
    packer = Packer(owner.name, owner.transport.incarnation, clock.now)
    last = transport.unpacker._last.get(key)
    packer.sent[key] = [0 if last is None else last.number, 0]
    transport.arrive(key, packer.pack(key, encode(body), step=True))


def forge(left, right, **changed):
    """Have the one robot hear another decision than the last of the other."""
    told = left.replica._last
    speak(left, right, "decision", msgspec.structs.replace(told, **changed))


@pytest.mark.parametrize("ahead", [0, 1, 1000, 2**31, 2**62 - 1])
def test_a_decision_far_ahead_counts_until_the_controller_s_next_word(ahead):
    async def main(left, right):
        forge(left, right, step=min(left.replica._last.step + ahead, 2**62 - 1), action=8, command=None)
        await asyncio.sleep(1.0)
        assert right.did == ["listen", "open-right", "listen"]
        for _ in range(3):
            right.observe(None, "hear-left")
            left.observe("hear-left", None)
            await asyncio.sleep(0.5)
        assert right.commits[-1].digest == left.commits[-1].digest
        assert right.commits[-1].step == left.commits[-1].step
        assert right.did[-1] == left.did[-1]

    robots(main)


def test_a_stop_far_ahead_is_ended_by_a_start():
    """An agent that hears a stop stays stopped, whoever said it; not for longer than until it is started."""

    async def main(left, right):
        forge(left, right, step=2**40, running=False, action=None, command="stop", bars={"right": (1, 1, 2**40)})
        await asyncio.sleep(2.0)
        assert right.ensemble.mode == "stopped"
        left.ensemble.start()
        await asyncio.sleep(2.0)
        assert right.ensemble.mode == "deciding"
        right.observe(None, "hear-left")
        await asyncio.sleep(0.5)
        assert right.commits[-1].step == left.commits[-1].step

    robots(main)


@pytest.mark.parametrize("changed", [{"started": 2**40}, {"command": "strat"}])
def test_what_no_controller_says_is_dropped(changed):
    async def main(left, right):
        forge(left, right, **changed)
        await asyncio.sleep(0.1)
        assert right.transport.statistics().dropped["incredible"] == 1
        assert right.replica.malformed == 1

    robots(main)


@pytest.mark.parametrize("number", [1, 2, 1000, 2**40])
def test_a_stop_is_heard_though_another_spoke_under_its_number(number):
    async def main(left, right):
        speak(right, left, "part", Proposal(number, 0, right.replica.copy.part(0, [0]), None))
        right.ensemble.stop()
        await asyncio.sleep(2.0)
        assert left.ensemble.mode == right.ensemble.mode == "stopped"
        left.ensemble.start()
        await asyncio.sleep(2.0)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"
        right.observe(None, "hear-left")
        await asyncio.sleep(0.5)
        assert left.commits[-1].input == {"right": "hear-left"}

    robots(main)


@pytest.mark.parametrize("taken", [1000, 2**62 - 1])
def test_what_waits_is_said_though_the_controller_seemed_to_have_it(taken):
    async def main(left, right):
        forge(left, right, taken={"right": taken})
        right.ensemble.stop()
        forge(left, right, taken={"right": taken})
        await asyncio.sleep(2.0)
        assert left.ensemble.mode == right.ensemble.mode == "stopped"

    robots(main)


@pytest.mark.parametrize("word", ["strat", "stop\n", "", "Start"])
def test_no_word_but_the_commands_starts_a_team(word):
    async def main(left, right):
        left.ensemble.stop()
        await asyncio.sleep(1.0)
        step = left.replica._last.step
        speak(right, left, "part", Proposal(100, 0, None, word, "token", left.transport.incarnation, step))
        await asyncio.sleep(1.0)
        assert left.ensemble.mode == right.ensemble.mode == "stopped"
        assert left.transport.statistics().dropped["incredible"] == 1

    robots(main)
