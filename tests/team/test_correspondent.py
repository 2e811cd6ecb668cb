"""Communicating teams: each agent decides on what it knows."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from team_robots import Robot, over_beliefs, over_states, started

import mdm
from mdm import problems
from mdm.team import Always, Never, Team, ValueOfCommunication
from mdm.team.network import Network
from mdm.testing import run_virtual

MODEL = problems.dec_tiger(discount=0.9)


def tigers(communication=None, **options):
    return Team("tigers", ["left", "right"], mode="communicating", period=1.0, communication=communication, **options)


def seen(count, seed=3):
    random = np.random.default_rng(seed)
    return [tuple(MODEL.observation_space.unravel(int(o))) for o in random.integers(4, size=count)]


def decided(communication, joint, **network):
    async def main(runtime):
        net = Network(runtime.clock, team="tigers", **network)
        robots = await started(runtime, tigers(communication), net, over_beliefs(MODEL))
        await asyncio.sleep(2.8)  # the first decision is made
        for left, right in joint:
            robots[0].observe(left, None)
            robots[1].observe(None, right)
            await asyncio.sleep(1.0)
        return robots

    return run_virtual(main)


def test_with_always_they_decide_as_one():
    joint = seen(12)
    left, right = decided(Always(), joint)
    alone = mdm.Controller(left.ensemble.controller.policy, MODEL)
    names = [alone.start().action_name, *(alone.observe(each).action_name for each in joint)]
    assert left.actions()[-len(names) :] == right.actions()[-len(names) :] == names[-len(left.actions()) :]
    assert [commit.digest for commit in left.commits] == [commit.digest for commit in right.commits]


def test_with_never_each_goes_by_its_own_observations():
    joint = seen(12)
    left, right = decided(Never(), joint)
    for place, robot in enumerate((left, right)):
        knows = mdm.team.Knowledge(robot.ensemble.controller.policy, MODEL, place, Never())
        names = [knows.decide().action_name]
        for each in joint:
            knows.observe(each[place])
            names.append(knows.decide().action_name)
        assert robot.actions()[-len(names) :] == names
        assert robot.replica.statistics().shared == 0


def test_a_policy_may_share_less():
    joint = seen(20)
    talking, _ = decided(Always(), joint)
    choosing, other = decided(ValueOfCommunication(1.0), joint)
    assert choosing.replica.statistics().shared + other.replica.statistics().shared > 0
    assert choosing.replica.statistics().shared < talking.replica.statistics().shared


def test_what_is_lost_or_late_is_summed_over_and_made_good():
    left, right = decided(Always(), seen(15), loss=0.3, seed=2, delay=(0.001, 0.2))
    assert len(left.actions()) >= 12
    assert left.replica.statistics().malformed == right.replica.statistics().malformed == 0


def test_commands_concern_all_and_who_comes_late_takes_part():
    async def main(runtime):
        net = Network(runtime.clock, team="tigers")
        left, right = await started(runtime, tigers(), net, over_beliefs(MODEL))
        await asyncio.sleep(5.0)
        assert left.did
        right.ensemble.stop()
        await asyncio.sleep(1.0)
        assert (left.ensemble.mode, right.ensemble.mode) == ("stopped", "stopped")
        left.ensemble.start()
        await asyncio.sleep(3.0)
        assert (left.ensemble.mode, right.ensemble.mode) == ("deciding", "deciding")
        assert left.commits[-1].step == right.commits[-1].step
        assert left.commits[-1].term[0] == 3
        await runtime.stop(right.member)
        await asyncio.sleep(3.0)
        back = await Robot(tigers(), "right", net, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(3.0)
        assert back.commits[-1].step == left.commits[-1].step

    run_virtual(main)


@pytest.mark.parametrize(
    ("team", "build", "words"),
    [
        (Team("rooms", ["a", "b"], mode="communicating", period=1.0), over_states, "decides on beliefs"),
        (Team("tigers", ["left", "right"], mode="communicating"), over_beliefs(MODEL), "give it a period"),
        (tigers(), over_beliefs(MODEL, horizon=5), "has no horizon"),
    ],
)
def test_what_cannot_be_decided_so_is_refused(team, build, words):
    async def main(runtime):
        with pytest.raises(mdm.ConfigError, match=words):
            await started(runtime, team, Network(runtime.clock, team=team.name), build)

    run_virtual(main)


def test_a_communication_policy_is_for_communicating_teams():
    with pytest.raises(mdm.ConfigError, match="is for communicating teams"):
        Team("tigers", ["left", "right"], communication=Always())


def test_another_configuration_is_refused():
    async def main(runtime):
        net = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", net, over_beliefs(MODEL)).start(runtime)
        right = await Robot(tigers(), "right", net, over_beliefs(problems.dec_tiger(discount=0.8))).start(runtime)
        await asyncio.sleep(5.0)
        assert "refused" in left.kinds() + right.kinds()
        assert (left.role, right.role) == ("deciding", "refused")

    run_virtual(main)


def test_a_command_before_the_first_tick_begins_now_and_not_with_the_clock():
    async def main(runtime):
        await asyncio.sleep(3e5 + 1)
        net = Network(runtime.clock, team="tigers")
        team = Team("tigers", ["left", "right"], mode="communicating", period=5.0)
        left, _right = await started(runtime, team, net, over_beliefs(MODEL))
        await asyncio.sleep(0.1)
        left.ensemble.reset()
        await asyncio.sleep(30.0)
        assert 5 <= left.replica.statistics().step <= 7

    run_virtual(main)


def test_who_comes_late_catches_up_a_little_at_each_tick(monkeypatch):
    async def main(runtime):
        net = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", net, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(30.0)
        right = await Robot(tigers(), "right", net, over_beliefs(MODEL)).start(runtime)
        layer, times = right.replica, iter(range(10**9))
        plain = runtime.clock.now
        catch_up = layer._catch_up

        def slowly(step):  # each look at the clock takes a tenth of a second
            monkeypatch.setattr(runtime.clock, "now", lambda: plain() + next(times) * 10**8)
            try:
                return catch_up(step)
            finally:
                monkeypatch.setattr(runtime.clock, "now", plain)

        monkeypatch.setattr(layer, "_catch_up", slowly)
        await asyncio.sleep(4.0)
        assert layer.statistics().step == 0
        assert 0 < layer._knowledge.step < 20
        await asyncio.sleep(30.0)
        assert layer.statistics().step == left.replica.statistics().step

    run_virtual(main)


def test_who_returns_with_another_configuration_takes_no_part_and_says_why():
    async def main(runtime):
        net = Network(runtime.clock, team="tigers")
        left, right = await started(runtime, tigers(), net, over_beliefs(MODEL))
        await asyncio.sleep(5.0)
        await runtime.stop(left.member)
        other = tigers()
        other.max_age = 7.0
        back = await Robot(other, "left", net, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(10.0)
        assert back.commits == []
        assert back.role == "refused"
        details = [fault.detail for fault in back.faults if fault.kind == "refused"]
        assert details == ["left cannot take part in the team: team's max_age is 7 s at left and 1 s at right"]
        assert [fault.kind for fault in right.faults].count("refused") <= 1
        assert right.role == "deciding"

    run_virtual(main)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"deadline": 0.1}, "leave its deadline out"),
        ({"on_impossible": "safe_action", "safe_action": "listen"}, "on_impossible is 'predict', 'keep' or 'reset'"),
        ({"false_negative": "hear-left hear-left"}, "has no false negatives"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, words):
    async def main(runtime):
        with pytest.raises(mdm.ConfigError, match=words):
            await started(runtime, tigers(), Network(runtime.clock, team="tigers"), over_beliefs(MODEL), **options)

    run_virtual(main)
