"""Centralised teams: one agent decides, all act, and nobody acts on without it."""

from __future__ import annotations

import asyncio

import msgspec
import numpy as np
import pytest
from team_robots import Robot, over_beliefs, over_states, started, three

import mdm
from mdm import problems
from mdm.runtime.time.scheduler import next_tick
from mdm.team.centralised.messages import Proposal, encode
from mdm.team.ownership import Placement
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual


def tigers(**options):
    return Team("tigers", ["left", "right"], mode="centralised", **options)


@pytest.mark.parametrize("period", [1.0, None])
def test_the_controller_decides_for_all_on_what_all_have_seen(period):
    model = problems.dec_tiger()
    random = np.random.default_rng(3)
    seen = [tuple(model.observation_space.unravel(int(o))) for o in random.integers(4, size=10)]

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        robots = await started(runtime, tigers(period=period), network, over_beliefs(model))
        await asyncio.sleep(0.5)
        for left, right in seen:
            robots[0].observe(left, None)
            await asyncio.sleep(0.2)
            robots[1].observe(None, right)
            await asyncio.sleep(0.8)
        return robots

    left, right = run_virtual(main)
    alone = mdm.Controller(left.ensemble.controller.policy, model)
    steps = [alone.start()]
    for joint in seen:
        parts = [joint] if period else [(joint[0], None), (None, joint[1])]
        steps += [alone.observe(part) for part in parts]
    names = [step.action_name for step in steps]
    if period:  # the first of them is made before the tick
        assert left.actions()[-len(names) :] == names[-len(left.actions()) :]
    else:
        assert left.actions() == names
    assert left.actions()[-8:] == right.actions()[-8:]
    assert left.did[-8:] == right.did[-8:]
    assert left.role == "leading"
    assert right.role == "following"


def test_states_are_collected_too():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms", loss=0.2, seed=4)
        a, b = await started(runtime, Team("rooms", ["a", "b"], mode="centralised"), network, over_states)
        await asyncio.sleep(0.5)
        a.lab.set(False)
        b.lab.set(True)
        await asyncio.sleep(2.0)
        assert (a.did, b.did) == (["stay"], ["go"])
        b.lab.set(False)
        await asyncio.sleep(2.0)
        assert b.did[-1] == "stay"

    run_virtual(main)


def test_what_is_lost_is_said_again_50_ms_after_it_was_said_itself():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left, right = await started(runtime, tigers(), network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(1.0)
        before = len(left.commits)
        right.observe(None, "hear-left")
        await asyncio.sleep(0.03)
        assert len(left.commits) == before + 1
        network.loss = 1.0
        right.observe(None, "hear-left")
        network.loss = 0.0
        await asyncio.sleep(0.045)
        assert len(left.commits) == before + 1
        await asyncio.sleep(0.01)
        assert len(left.commits) == before + 2

    run_virtual(main)


def test_nothing_is_lost_for_long_where_messages_are():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", loss=0.3, seed=2, delay=(0.001, 0.02))
        left, right = await started(runtime, tigers(), network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(3.0)
        for _ in range(6):
            right.observe(None, "hear-left")
        await asyncio.sleep(5.0)
        assert len([commit for commit in left.commits if commit.input]) == 6
        assert right.commits[-1].digest == left.commits[-1].digest
        right.ensemble.stop()
        assert right.ensemble.mode == "stopped"
        await asyncio.sleep(3.0)
        assert left.ensemble.mode == "stopped"

    run_virtual(main)


def test_what_is_late_counts_no_more_and_who_is_gone_is_not_waited_for():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        left, _ = await started(runtime, tigers(period=1.0), network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(3.5)
        network.crash("right")
        await asyncio.sleep(5.0)
        missing = [commit.missing for commit in left.commits]
        assert missing[2:4] == [()] * 2  # from when right is there
        assert missing[-4:] == [("right",)] * 4

    run_virtual(main)


def test_a_lost_controller_makes_each_agent_safe_until_it_decides_again():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        team = tigers()

        def build(robot, agent):
            return over_beliefs(problems.dec_tiger())(robot, agent, safe_action=robot.act("SAFE"))

        left, right = await started(runtime, team, network, build)
        await asyncio.sleep(1.0)
        assert right.did == ["listen"]
        network.crash("left")
        await asyncio.sleep(1.0)
        assert right.ensemble.mode == "safe"
        assert [cause.kind for cause in right.ensemble.causes] == ["lost_controller"]
        assert right.did == ["listen", "SAFE"]
        assert "lost_controller" in right.kinds()
        await runtime.stop(left.member)
        back = await Robot(team, "left", network, build).start(runtime)
        await asyncio.sleep(2.0)
        assert right.ensemble.mode == "deciding"
        assert right.did == ["listen", "SAFE", "listen"]
        back.observe("hear-left", None)
        await asyncio.sleep(1.0)
        assert right.did[-1] == back.did[-1] == "open-right"

    run_virtual(main)


def test_one_robot_is_controlled_from_off_board():
    model = problems.tiger()

    async def main(runtime):
        network = Network(runtime.clock, team="tiger", lease=0.5)
        team = Team("tiger", ["robot", "base"])
        robots = {}
        for name in team.names:

            class Process:
                did = []  # noqa: RUF012 - of each class its own

            process = robots[name] = type(name, (), {"did": []})
            manager = mdm.PredicateManager()
            process.heard = {side: manager.event(f"Heard{side}") for side in ("Left", "Right")}
            process.ensemble = mdm.Ensemble(
                "tiger",
                policy=mdm.policies.AlphaVectors([[-1, -1], [-80, 8], [8, -80]], [0, 1, 2]),
                model=model,
                predicates=manager,
                observations=[mdm.ObservationFactor("ear", {"tiger-left": "HeardLeft", "tiger-right": "HeardRight"})]
                if "tiger-left" in model.observation_space.names
                else [mdm.ObservationFactor("ear", ["HeardLeft", "HeardRight"])],
                actions={n: (lambda n=n, p=process: p.did.append(n)) for n in model.action_space.names},
                safe_action=lambda p=process: p.did.append("SAFE"),
            )
            process.member = team.member(
                name,
                process.ensemble,
                transport=network.transport(name),
                placement={"tiger": Placement(control="base", actions="robot", inputs="robot")},
            )
            await runtime.start(process.member)
        robot, base = robots["robot"], robots["base"]
        await asyncio.sleep(1.0)
        first = model.action_space.names[0]
        assert robot.did == [first]
        assert base.did == []
        robot.heard["Left"].fire()
        await asyncio.sleep(0.5)
        robot.heard["Left"].fire()
        await asyncio.sleep(0.5)
        assert len(robot.did) == 3
        assert robot.did[-1] != first
        network.crash("base")
        await asyncio.sleep(1.0)
        assert robot.did[-1] == "SAFE"
        assert base.did == []

    run_virtual(main)


def test_another_configuration_is_refused():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        await Robot(tigers(), "left", network, over_beliefs(problems.dec_tiger())).start(runtime)
        right = Robot(tigers(), "right", network, over_beliefs(problems.dec_tiger(), horizon=2))
        await right.start(runtime)
        await asyncio.sleep(2.0)
        assert right.role == "refused"
        assert "horizon is 2 at right and None at left" in right.faults[0].detail
        assert right.did == []

    run_virtual(main)


def test_what_was_observed_while_nobody_decided_counts_no_more():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        build = over_beliefs(problems.dec_tiger(), safe_action="listen")
        left, right = await started(runtime, tigers(), network, build)
        await asyncio.sleep(2.0)
        network.crash("left")
        await runtime.stop(left.member)
        await asyncio.sleep(2.0)
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        back = await Robot(tigers(), "left", network, build).start(runtime)
        await asyncio.sleep(3.0)
        assert [commit.command for commit in back.commits] == ["begin"]
        assert right.replica.statistics().late == 1
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert back.commits[-1].input == {"right": "hear-left"}

    run_virtual(main)


def test_the_controller_holds_on_to_what_a_lost_teammate_means_when_it_begins_anew():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        build = over_beliefs(problems.dec_tiger(), on_lost_teammate="hold", supervision=mdm.Restart(3, 60.0, 0.1))
        left, _right = await started(runtime, tigers(period=0.5), network, build)
        await asyncio.sleep(2.0)
        network.crash("right")
        await asyncio.sleep(2.0)
        left.ensemble.control.call_later(0.01, lambda: left.ensemble.control.fail(ValueError("broken")))
        await asyncio.sleep(1.0)
        before = len(left.did)
        await asyncio.sleep(2.0)
        assert len(left.did) == before

    run_virtual(main)


def test_each_agent_tells_of_the_decisions_that_it_carries_out():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        told = probe(runtime.decisions)
        left, right = await started(runtime, tigers(period=0.5), network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(4.0)
        of = {robot.name: [one for one in told if one.ensemble == robot.ensemble.path] for robot in (left, right)}
        assert len(of["right"]) >= 3
        assert {one.cause for one in of["right"]} == {"team"}
        ends = [[(one.epoch, one.action_name) for one in of[name]][-3:] for name in ("left", "right")]
        assert ends[0] == ends[1]

    run_virtual(main)


def test_a_controller_of_an_older_policy_decides_nothing_and_the_others_follow_the_corrected_one():
    model = three()

    async def main(runtime):
        network = Network(runtime.clock, team="fire", lease=0.5)
        team = Team("fire", ["one", "two", "three"], mode="centralised", period=0.25, lease=0.5)

        def build(robot, agent):
            return over_beliefs(model)(robot, agent, safe_action=robot.act("SAFE"))

        def older(robot, agent):
            return over_beliefs(model, horizon=5)(robot, agent, safe_action=robot.act("SAFE"))

        one, two, third = await started(runtime, team, network, build)
        await asyncio.sleep(3.0)
        network.crash("one")
        await runtime.stop(one.member)
        await asyncio.sleep(3.0)
        before = [len(robot.did) for robot in (two, third)]
        wrong = await Robot(team, "one", network, older).start(runtime)
        await asyncio.sleep(5.0)
        assert wrong.did == ["SAFE"]
        assert [robot.role for robot in (wrong, two, third)] == ["refused", "waiting", "waiting"]
        assert [len(robot.did) for robot in (two, third)] == before
        assert [robot.ensemble.mode for robot in (two, third)] == ["safe", "safe"]
        assert [cause.kind for cause in two.ensemble.causes] == ["lost_controller"]
        assert "horizon is 5 at one and None at two" in two.faults[-1].detail
        network.crash("one")
        await runtime.stop(wrong.member)
        corrected = await Robot(team, "one", network, build).start(runtime)
        await asyncio.sleep(5.0)
        assert [robot.role for robot in (corrected, two, third)] == ["leading", "following", "following"]
        assert [robot.ensemble.mode for robot in (corrected, two, third)] == ["deciding"] * 3
        assert all(len(robot.did) > 5 for robot in (corrected, two, third))

    run_virtual(main)


def test_an_answer_that_an_agent_did_not_give_refuses_nobody():
    """Another can answer in its name where certificates are not asked for."""

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        robots = [Robot(tigers(), name, network, over_beliefs(problems.dec_tiger())) for name in ("left", "right")]
        for robot in robots:
            await robot.start(runtime)
            served = robot.transport._served
            for key in served:
                served[key] = lambda _: msgspec.msgpack.encode({"horizon": "5"})
            assert [key.split("/")[-1] for key in served if "configuration" in key] == ["configuration"]
        await asyncio.sleep(1.0)
        assert [robot.role for robot in robots] == ["leading", "following"]
        assert [robot.did for robot in robots] == [["listen"]] * 2
        robots[1].observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert robots[0].commits[-1].input == {"right": "hear-left"}

    run_virtual(main)


@pytest.mark.parametrize("ahead", [0.03, 0.06])
def test_what_is_said_after_a_stop_that_lasted_is_not_taken_for_forged(ahead):
    """The controller's ticks go on while the team is stopped, whichever clock ticks first after the start."""

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = tigers(period=0.1, deadline=0.05)
        left, right = await started(runtime, team, network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(1.0)
        left.ensemble.stop()
        await asyncio.sleep(10.0 + ahead)
        before = len(left.commits)
        # a tick that the controller has not had yet, as a clock that is a little ahead says it
        proposal = Proposal(0, next_tick(runtime.clock.now(), 10.0), None, None)
        right.member.link.send(right.replica._key, encode(proposal), priority="step")
        left.ensemble.start()
        await asyncio.sleep(2.0)
        assert len(left.commits) > before + 10
        assert "incredible" not in left.transport.statistics().dropped

    run_virtual(main)


def test_what_an_agent_of_another_configuration_says_counts_for_nothing():
    model = three()

    async def main(runtime):
        network = Network(runtime.clock, team="fire", lease=0.5)
        team = Team("fire", ["one", "two", "three"], mode="centralised", lease=0.5)
        one, two = await started(runtime, team, network, over_beliefs(model), names=["one", "two"])
        await asyncio.sleep(2.0)
        [last] = await started(runtime, team, network, over_beliefs(model, horizon=5), names=["three"])
        await asyncio.sleep(2.0)
        before = len(one.commits)
        last.observe(None, None, "flames")
        last.ensemble.reset()
        await asyncio.sleep(2.0)
        assert len(one.commits) == before
        assert last.did == []
        two.observe(None, "flames", None)
        await asyncio.sleep(1.0)
        assert one.commits[-1].input == {"two": "flames"}
        assert one.commits[-1].missing == ("three",)

    run_virtual(main)


def test_nothing_is_asked_of_a_controller_before_it_has_compared():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left, _right = await started(runtime, tigers(), network, over_beliefs(problems.dec_tiger()))
        left.ensemble.reset()
        left.ensemble.stop()
        await asyncio.sleep(2.0)
        assert [fault.detail.partition(",")[0] for fault in left.faults if fault.kind == "void_command"] == ["reset"]
        assert left.ensemble.mode == "stopped"
        assert left.did == []

    run_virtual(main)
