"""Members of replicated teams come and go: what they are told, and what they do without each other."""

from __future__ import annotations

import asyncio

import pytest
from team_robots import Robot, history, over_beliefs, over_states, started, three, tigers, two

import mdm
from mdm import problems
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual


def test_a_side_without_a_majority_is_safe_and_decides_nothing():
    model = three()

    async def main(runtime):
        network = Network(runtime.clock, team="fire", lease=0.5)
        team = Team("fire", ["one", "two", "three"], period=0.5)

        def build(robot, agent):
            return over_beliefs(model)(robot, agent, safe_action=robot.act("SAFE"))

        one, two, late = await started(runtime, team, network, build)
        await asyncio.sleep(2.2)
        network.partition({"one"}, {"two", "three"})
        await asyncio.sleep(3.0)
        assert one.ensemble.mode == "safe"
        assert [cause.kind for cause in one.ensemble.causes] == ["lost_majority"]
        assert one.did[-1] == "SAFE"
        assert "lost_majority" in one.kinds()
        held = len(one.commits)
        decided = len(two.commits)
        assert two.ensemble.mode == late.ensemble.mode == "deciding"
        await asyncio.sleep(2.0)
        assert len(one.commits) == held
        assert len(two.commits) > decided
        network.heal()
        await asyncio.sleep(3.0)
        assert one.ensemble.mode == "deciding"
        shared = min(robot.commits[-1].step for robot in (one, two, late))
        digests = {robot.name: {c.step: c.digest for c in robot.commits} for robot in (one, two, late)}
        assert digests["one"][shared] == digests["two"][shared] == digests["three"][shared]

    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
@pytest.mark.parametrize("pause", [0.0, 0.2, 3.0])
def test_a_team_that_ends_in_order_reports_no_loss(mode, pause):
    model = three()

    async def main(runtime):
        network = Network(runtime.clock, team="fire", lease=0.5)
        team = Team("fire", ["one", "two", "three"], period=0.5, mode=mode)

        def build(robot, agent):
            return over_beliefs(model)(robot, agent, safe_action=robot.act("SAFE"))

        robots = await started(runtime, team, network, build)
        await asyncio.sleep(2.2)
        for robot in robots:
            await runtime.stop(robot.member)
            await asyncio.sleep(pause)
        assert [robot.kinds() for robot in robots] == [[], [], []]

    run_virtual(main)


def test_one_that_others_have_left_and_that_stays_says_why_it_does_nothing():
    model = three()

    async def main(runtime):
        network = Network(runtime.clock, team="fire", lease=0.5)
        team = Team("fire", ["one", "two", "three"], period=0.5)
        one, two, last = await started(runtime, team, network, over_beliefs(model))
        await asyncio.sleep(2.2)
        await runtime.stop(one.member)
        await asyncio.sleep(0.01)
        await runtime.stop(two.member)
        await asyncio.sleep(5.0)
        assert (last.role, last.kinds()) == ("waiting", [])
        await asyncio.sleep(10.0)
        assert last.kinds() == ["lost_majority"]

    run_virtual(main)


def test_who_waits_at_the_start_says_for_what():
    async def main(runtime):
        network = Network(runtime.clock, team="fire")
        alone = await Robot(Team("fire", ["one", "two", "three"]), "one", network, over_beliefs(three())).start(runtime)
        await asyncio.sleep(2.0)
        assert [fault.detail for fault in alone.faults] == [
            "cannot decide: of team 'fire' 1 of 3 agents are here (one), and it takes 2"
        ]

    run_virtual(main)


@pytest.mark.parametrize("reaction", ["continue", "hold", "safe_action"])
def test_a_lost_teammate_is_answered_as_the_ensemble_says(reaction):
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)

        def build(robot, agent):
            return over_beliefs(problems.dec_tiger())(
                robot, agent, safe_action=robot.act("SAFE"), on_lost_teammate=reaction
            )

        left, right = await started(runtime, tigers(), network, build)
        await asyncio.sleep(1.0)
        network.partition({"left"}, {"right"})
        await asyncio.sleep(2.0)
        before = list(left.did)
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        after = left.did[len(before) :]
        assert after == {"continue": ["open-right"], "hold": [], "safe_action": []}[reaction]
        assert left.ensemble.mode == ("safe" if reaction == "safe_action" else "deciding")
        assert ("SAFE" in before) == (reaction == "safe_action")
        assert "lost_teammate" in left.kinds()
        network.heal()
        await asyncio.sleep(3.0)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"
        assert left.did[-1] == "open-right"  # what is decided by now, in each case
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert left.commits[-1].digest == right.commits[-1].digest

    run_virtual(main)


def test_who_leaves_in_order_is_not_missed():
    async def main(runtime):
        def build(robot, agent):
            return over_beliefs(problems.dec_tiger())(
                robot, agent, safe_action=robot.act("SAFE"), on_lost_teammate="safe_action"
            )

        left, right = await two(runtime, build)
        await asyncio.sleep(1.0)
        await runtime.stop(left.member)
        assert left.did == ["listen", "SAFE"]
        await asyncio.sleep(3.0)
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert right.did == ["listen", "open-right"]
        assert not right.faults

    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised", "communicating"])
@pytest.mark.parametrize("reaction", ["safe_action", "hold"])
@pytest.mark.parametrize("ends", ["in order", "by a crash"])
@pytest.mark.parametrize(("age", "stays"), [(0.5, "left"), (0.5, "right"), (10.0, "left"), (10.0, "right")])
def test_a_teammate_is_lost_until_it_is_admitted_again(mode, reaction, ends, age, stays):
    """One of its name that was refused, or has only just come, was never there: its farewell is not that of the lost.

    Where nobody has been there for long, it is the one that stays who is refused meanwhile.
    """

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        period = {"period": 0.5} if mode == "communicating" else {}

        def build(robot, agent):
            return over_beliefs(problems.dec_tiger())(
                robot, agent, safe_action=robot.act("SAFE"), on_lost_teammate=reaction
            )

        def robot(name, **options):
            return Robot(tigers(mode=mode, lease=0.5, **period, **options), name, network, build)

        name = "right" if stays == "left" else "left"
        gone = await robot(name).start(runtime)
        one = await robot(stays).start(runtime)
        await asyncio.sleep(age)
        assert one.member.statistics().live == ("left", "right")
        network.crash(name)
        await runtime.stop(gone.member)
        await asyncio.sleep(2.0)
        assert one.member.lost == (name,)
        for other in (robot(name, max_age=3.0), robot(name)):
            await other.start(runtime)
            if other.member.team.max_age == 3.0:
                await asyncio.sleep(2.0)
                assert "refused" in one.kinds()
            if ends == "by a crash":
                network.crash(name)
            await runtime.stop(other.member)
            await asyncio.sleep(3.0)
            assert one.member.lost == (name,)
            assert one.replica.lost == {name}
            causes = {cause.kind for cause in one.ensemble.causes} - {"lost_controller"}
            assert causes == ({"lost_teammate"} if reaction == "safe_action" else set())
        await robot(name).start(runtime)
        await asyncio.sleep(3.0)
        assert one.ensemble.mode == "deciding"
        assert one.member.lost == ()

    run_virtual(main)


def test_who_comes_late_does_what_is_decided_now_and_nothing_of_before():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team, build = tigers(quorum="continue"), over_beliefs(problems.dec_tiger())
        left = await Robot(team, "left", network, build).start_alone(runtime)
        await asyncio.sleep(1.0)
        for _ in range(4):
            left.observe("hear-left", None)
            await asyncio.sleep(1.0)
        assert left.did == ["listen", "open-right", "listen", "open-right", "listen"]
        right = await Robot(team, "right", network, build).start(runtime)
        await asyncio.sleep(1.0)
        assert right.did == ["listen"]
        assert history(right) == history(left)
        assert not any(commit.caught_up for commit in left.commits)
        assert all(commit.caught_up for commit in right.commits)
        left.observe("hear-left", None)
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert right.commits[-1].step > 5
        assert not right.commits[-1].caught_up

    run_virtual(main)


def test_a_copy_that_differs_takes_that_of_the_others():
    async def main(runtime):
        left, right = await two(runtime)
        await asyncio.sleep(1.0)
        right.ensemble.controller.information.reset([0.9, 0.1])  # a cosmic ray
        right.replica.copy._digest = None
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        assert "digest" in right.kinds() + left.kinds()
        assert left.commits[-1].digest == right.commits[-1].digest

    run_virtual(main)


def test_an_agent_of_another_model_is_refused_and_says_why():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", network, over_beliefs(problems.dec_tiger())).start(runtime)
        other = over_beliefs(problems.dec_tiger(), horizon=3)
        right = await Robot(tigers(), "right", network, other).start(runtime)
        await asyncio.sleep(2.0)
        assert right.role == "refused" or left.role == "refused"
        told = [fault.detail for fault in left.faults + right.faults if fault.kind == "refused"]
        assert any("horizon" in text for text in told)

    run_virtual(main)


def test_an_ensemble_that_fails_begins_anew_with_the_others():
    async def main(runtime):
        def build(robot, agent):
            return over_beliefs(problems.dec_tiger())(
                robot, agent, safe_action=robot.act("SAFE"), supervision=mdm.Restart(backoff=0.5)
            )

        left, right = await two(runtime, build)
        await asyncio.sleep(1.0)
        mdm.testing.crash(right.ensemble.action)
        await asyncio.sleep(0.2)
        left.observe("hear-left", None)
        await asyncio.sleep(2.0)
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        assert right.ensemble.mode == "deciding"
        assert right.did == ["listen", "SAFE", "open-right", "listen"]  # the present action, when it is back
        assert history(left)[-1] == history(right)[-1]

    run_virtual(main)


def test_what_was_seen_without_a_majority_is_not_acted_on_when_there_is_one_again():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        left, right = await started(runtime, tigers(quorum="majority"), network, over_beliefs(problems.dec_tiger()))
        await asyncio.sleep(1.0)
        network.partition({"left"}, {"right"})
        await asyncio.sleep(2.0)
        for _ in range(5):
            left.observe("hear-left", None)
        assert left.replica.statistics().unsaid == 5
        network.heal()
        await asyncio.sleep(2.0)
        assert [commit.command for commit in left.commits] == ["begin"]
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        assert left.did == right.did
        assert left.did[-1] == "open-right"
        assert len(right.commits) == 2

    run_virtual(main)


@pytest.mark.parametrize("how", ["left", "lost"])
def test_a_state_without_an_agent_says_who_is_gone_and_what_to_do(how):
    async def main(runtime):
        network = Network(runtime.clock, team="rooms", lease=0.5)
        team = mdm.Team("rooms", ["a", "b"], drive="event", lease=0.5, max_age=1.0)
        a, b = await started(runtime, team, network, over_states, safe_action="stay")
        for robot in (a, b):
            robot.lab.set(True)
        await asyncio.sleep(1.0)
        assert a.ensemble.mode == "deciding"
        if how == "left":
            await runtime.stop(b.member)
            where = "has left"
        else:
            network.crash("b")
            where = "is lost"
        await asyncio.sleep(1.0)
        a.lab.set(False)  # the first step without it
        await asyncio.sleep(4.0)
        text = f"agent 'b' {where}, and a state is made of the factors of all: start it again"
        found = [fault.detail for fault in a.faults if fault.kind == "unknown_input"]
        assert found == [f"the state turned unknown: room_b (of b); {text}"]
        assert a.ensemble.causes[0].detail == found[0]
        assert a.ensemble.statistics().waiting == ()

    run_virtual(main)


def test_an_agent_that_waits_for_its_majority_names_those_who_are_not_there():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms", lease=0.5)
        team = mdm.Team("rooms", ["a", "b"], drive="event", quorum="majority", lease=0.5)
        a, b = await started(runtime, team, network, over_states)
        for robot in (a, b):
            robot.lab.set(True)
        await asyncio.sleep(1.0)
        assert (a.replica.awaited, b.replica.awaited) == ((), ())
        network.crash("b")
        await asyncio.sleep(4.0)
        assert a.replica.awaited == ("b",)

    run_virtual(main)
