"""Clocks of other agents: measured in every mode, and told where they are too far off."""

from __future__ import annotations

import asyncio

import pytest
from team_robots import over_beliefs, started

from mdm import problems
from mdm.team.sharing.calls import ask
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

MODES = ["replicated", "centralised", "communicating"]


async def team_of_two(runtime, ahead, *, mode="replicated", delay=0.01, **options):
    """Return two running robots, of which the clock of one goes ahead."""
    network = Network(runtime.clock, team="tigers", delay=delay)
    team = Team("tigers", ["left", "right"], mode=mode, **options)
    left, right = await started(runtime, team, network, over_beliefs(problems.dec_tiger()), names=["left", "right"])
    own = right.member.clocks.time
    right.member.clocks.time = lambda: own() + round(ahead * 1e9)
    return network, team, left, right


@pytest.mark.parametrize("mode", MODES)
def test_an_offset_is_measured_and_told_beyond_half_a_period_or_the_deadline(mode):
    async def main(runtime):
        network, team, left, right = await team_of_two(runtime, 0.15, mode=mode, period=0.5, deadline=0.1)
        await asyncio.sleep(7.0)
        assert left.member.clocks.limit == 0.1
        for robot, sign in ((left, 1), (right, -1)):
            [(_, offset)] = robot.member.clocks.offsets.items()
            assert abs(offset.seconds - sign * 0.15) <= offset.error <= 0.011
            assert [fault.kind for fault in robot.faults].count("clock") == 1
        told = next(fault.detail for fault in left.faults if fault.kind == "clock")
        assert told.startswith("the clock of right is 0.150 s ahead of that of left, and the team allows for 0.1 s")
        asker = network.transport("console")
        await asker.open()
        status = await ask(asker, team, "status")
        assert status["right"]["clocks"]["left"]["seconds"] == pytest.approx(-0.15, abs=0.011)

    run_virtual(main)


def test_clocks_that_agree_well_enough_are_not_told_of():
    async def main(runtime):
        _, _, left, right = await team_of_two(runtime, 0.09, period=0.2, deadline=0.2)
        await asyncio.sleep(7.0)
        assert left.member.clocks.limit == 0.1
        assert left.kinds() == right.kinds() == []

    run_virtual(main)


def test_an_offset_that_the_delay_may_explain_is_none_until_it_is_told_again_once_it_was_well():
    async def main(runtime):
        _, _, left, right = await team_of_two(runtime, 0.12, delay=0.03)  # events make steps, which wait for 0.1 s
        await asyncio.sleep(7.0)
        assert left.kinds() == []
        time = right.member.clocks.time
        for ahead, count in ((5.0, 1), (0.0, 1), (-5.0, 2)):
            right.member.clocks.time = lambda ahead=ahead: time() + round((ahead - 0.12) * 1e9)
            await asyncio.sleep(11.0)
            assert left.kinds().count("clock") == count

    run_virtual(main)


def test_an_agent_whose_clock_was_put_right_says_that_it_is_to_be_started_again():
    """Also where it has said before that the clocks differ; the others can say no more than that."""

    async def main(runtime):
        _, _, left, right = await team_of_two(runtime, -3600.0, period=0.5, deadline=0.1)
        await asyncio.sleep(7.0)
        runtime.clock.corrected = lambda: 3_600_000_000_000  # chrony has come
        await asyncio.sleep(20.0)
        return [[fault.detail for fault in robot.faults if fault.kind == "clock"] for robot in (left, right)]

    for told in run_virtual(main):  # of one clock in virtual time, both agents are on the machine that was put right
        first, second = told
        assert first.endswith("or for none: synchronise the clocks")
        assert second.endswith(
            "the time of day here was put right by 3600.000 s since the start: start this agent again"
        )


@pytest.mark.parametrize(("corrected", "said"), [(0.1, 0), (0.11, 1), (-0.11, 1)])
def test_a_small_correction_explains_no_skew(corrected, said):
    async def main(runtime):
        _, _, left, _ = await team_of_two(runtime, 0.3, period=0.5, deadline=0.1)
        runtime.clock.corrected = lambda: round(corrected * 1e9)
        await asyncio.sleep(7.0)
        details = [fault.detail for fault in left.faults if fault.kind == "clock"]
        return len(details), sum("start this agent again" in detail for detail in details)

    assert run_virtual(main) == (1, said)


def test_who_is_gone_has_no_clock():
    async def main(runtime):
        network, _, left, _ = await team_of_two(runtime, 0.0)
        await asyncio.sleep(2.0)
        assert list(left.member.clocks.offsets) == ["right"]
        network.crash("right")
        await asyncio.sleep(3.0)
        assert left.member.clocks.offsets == {}

    run_virtual(main)
