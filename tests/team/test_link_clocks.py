"""Clocks of other agents: measured in every mode, and told where they are too far off."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest
from team_robots import Robot, over_beliefs, started

from mdm import Runtime, VirtualClock, problems, run
from mdm.recording import Record
from mdm.replay.replay import replay, transports_of
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
        runtime.clock.corrected = lambda: -3_600_000_000_000  # chrony has come
        await asyncio.sleep(20.0)
        return [[fault.detail for fault in robot.faults if fault.kind == "clock"] for robot in (left, right)]

    for told in run_virtual(main):  # of one clock in virtual time, both agents are on the machine that was put right
        first, second = told
        assert first.endswith("or for none: synchronise the clocks")
        assert second.endswith(
            "the time of day here was put right by -3600.000 s since the start: start this agent again"
        )


@pytest.mark.parametrize(("corrected", "said"), [(0.1, 0), (0.11, 1), (-0.11, 1)])
def test_a_small_correction_explains_no_skew(corrected, said):
    async def main(runtime):
        _, _, left, _ = await team_of_two(runtime, 0.3, period=0.5, deadline=0.1)
        runtime.clock.corrected = lambda: round(corrected * 1e9)
        await asyncio.sleep(7.0)
        details = [fault.detail for fault in left.faults if "s ahead of that of" in fault.detail]
        return len(details), sum("start this agent again" in detail for detail in details)

    assert run_virtual(main) == (1, said)


class Board(VirtualClock):
    """The clock of a board without one of its own, whose time of day is put right behind its start."""

    right = 0

    def corrected(self):
        return self.right and self.right - self.epoch

    def catch_up(self):
        self.epoch = self.right
        self._arm_next()


HOUR = 3_600_000_000_000
NAMES = ["left", "right"]


def boards(late):
    """Return the clocks of two robots, of which one is an hour behind."""
    return [Board(epoch=0 if name == late else HOUR) for name in NAMES]


async def on_boards(clocks, team, happen, record=None):
    """Have something happen to two robots that run by clocks of their own; record the one whose clock is behind."""
    behind = min(clocks, key=lambda clock: clock.epoch)
    network = Network(max(clocks, key=lambda clock: clock.epoch), team="tigers", delay=0.01)
    robots = [Robot(team, name, network, over_beliefs(problems.dec_tiger())) for name in NAMES]
    runtimes = [Runtime(clock=clock, log=None, record=record if clock is behind else None) for clock in clocks]
    async with runtimes[0], runtimes[1]:
        for robot, runtime in zip(robots, runtimes, strict=True):
            await robot.start(runtime)
        await asyncio.sleep(12.0)
        await happen(robots)
        for runtime in runtimes:
            runtime.shut_down()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("late", NAMES)
def test_a_clock_that_was_put_right_is_taken_up_where_that_lasts(mode, late, tmp_path):
    """An agent an hour behind was late for ever: it went on by the time of its start."""
    clocks, team = boards(late), Team("tigers", NAMES, mode=mode, period=0.5)

    async def happen(robots):
        clocks[NAMES.index(late)].right = HOUR  # chrony has come
        await asyncio.sleep(12.0)
        counts = [len(robot.commits) for robot in robots]
        await asyncio.sleep(10.0)
        told = [fault.detail for fault in robots[NAMES.index(late)].faults if fault.kind == "clock"]
        assert told[-1] == f"the clock of {late} went on by 3600.000 s, to the time of day here"
        left, right = [
            [(commit.step, commit.action) for commit in robot.commits[count:]]
            for robot, count in zip(robots, counts, strict=True)
        ]
        assert len(left) >= 15
        assert left[-10:] == right[-10:]
        for robot in robots:
            assert [abs(offset.seconds) < 0.1 for offset in robot.member.clocks.offsets.values()] == [True]
            times = [commit.time for commit in robot.commits]
            assert times == sorted(times)

    run(lambda: on_boards(clocks, team, happen, tmp_path / "late.mcap"), virtual=True)
    record = Record(tmp_path / "late.mcap")
    transports = transports_of(record)
    wire = SimpleNamespace(transport=transports.__getitem__)
    again = Robot(team, late, wire, over_beliefs(problems.dec_tiger()))
    played = replay(record, again.member, transports=transports)
    assert played.same
    assert played.replayed >= 15


@pytest.mark.parametrize("case", ["for a moment", "backwards", "with the other"])
def test_a_clock_is_not_taken_up_where_that_would_do_harm(case):
    clocks, team = boards("left"), Team("tigers", NAMES, period=0.5)
    if case == "with the other":  # both have the same time, and agree on each step
        clocks[1].epoch = 0

    async def happen(robots):
        clocks[0].right = -HOUR if case == "backwards" else HOUR
        await asyncio.sleep(5.0)
        if case == "for a moment":
            clocks[0].right = 0
        await asyncio.sleep(20.0)
        assert clocks[0].epoch == 0
        assert [fault.detail for fault in robots[0].faults if "went on by" in fault.detail] == []

    run(lambda: on_boards(clocks, team, happen), virtual=True)


def test_who_is_gone_has_no_clock():
    async def main(runtime):
        network, _, left, _ = await team_of_two(runtime, 0.0)
        await asyncio.sleep(2.0)
        assert list(left.member.clocks.offsets) == ["right"]
        network.crash("right")
        await asyncio.sleep(3.0)
        assert left.member.clocks.offsets == {}

    run_virtual(main)
