"""Replicated ensembles: every agent decides the same, whoever is missing."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from team_robots import Robot, history, over_beliefs, over_states, started, three, tigers, two
from teams import team as random_team

import mdm
from mdm import problems
from mdm.team.agreement import decode
from mdm.team.team import Team
from mdm.team.transport.network import Network, SimulatedTransport
from mdm.testing import run_virtual


def exact(model, belief, action, components):
    """The belief after a joint action and the components that came: the others are summed over, one by one."""
    space = model.observation_space
    after = np.zeros(len(belief))
    for joint in range(len(space)):
        if all(given is None or given == mine for given, mine in zip(components, space.unravel(joint), strict=True)):
            for end in range(len(belief)):
                chance = model.observation(action, end, joint)
                if chance:
                    after[end] += chance * sum(
                        belief[start] * model.transition(action, start, end) for start in range(len(belief))
                    )
    return after / after.sum()


@pytest.mark.parametrize("drive", ["period", "event"])
def test_a_team_decides_as_one_process_with_the_joint_observations(drive):
    model = problems.dec_tiger()
    random = np.random.default_rng(1)
    seen = [tuple(model.observation_space.unravel(int(o))) for o in random.integers(4, size=12)]

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = tigers(period=1.0) if drive == "period" else tigers()
        robots = await started(runtime, team, network, over_beliefs(model))
        await asyncio.sleep(0.5)
        for left, right in seen:
            robots[0].observe(left, None)
            robots[1].observe(None, right)
            await asyncio.sleep(1.0)
        return robots

    left, right = run_virtual(main)
    assert history(left) == history(right)
    assert left.did == right.did  # they do the same in this problem
    alone = mdm.Controller(left.ensemble.controller.policy, model)
    steps = [alone.start()]
    beliefs = [alone.belief]
    for joint in seen:
        # An event of one agent is a step of its own, in which the other has observed nothing.
        parts = [joint] if drive == "period" else [(joint[0], None), (None, joint[1])]
        for part in parts:
            steps.append(alone.observe(part))
            beliefs.append(alone.belief)
    assert left.actions() == [step.action_name for step in steps]
    np.testing.assert_array_equal(left.beliefs, beliefs)
    np.testing.assert_array_equal(right.beliefs, beliefs)


def test_three_agents_decide_as_one_process():
    model = three()
    random = np.random.default_rng(5)
    seen = [tuple(model.observation_space.unravel(int(o))) for o in random.integers(8, size=8)]

    async def main(runtime):
        network = Network(runtime.clock, team="fire", delay=(0.001, 0.02))
        team = Team("fire", ["one", "two", "three"], period=1.0)
        robots = await started(runtime, team, network, over_beliefs(model))
        await asyncio.sleep(0.5)
        for parts in seen:
            for place, robot in enumerate(robots):
                robot.observe(*(part if each == place else None for each, part in enumerate(parts)))
            await asyncio.sleep(1.0)
        return robots

    robots = run_virtual(main)
    alone = mdm.Controller(robots[0].ensemble.controller.policy, model)
    steps = [alone.start(), *(alone.observe(parts) for parts in seen)]
    for place, robot in enumerate(robots):
        assert history(robot) == history(robots[0])
        assert robot.actions() == [step.action_name for step in steps]
        own = model.action_space.factors[place].names
        assert robot.did == [own[model.action_space.unravel(step.action)[place]] for step in steps]


@pytest.mark.parametrize("build", [problems.dec_tiger, three])
def test_what_a_missing_teammate_sees_is_summed_over(build):
    model = build()
    names = ["one", "two", "three"][: model.num_agents]
    random = np.random.default_rng(2)
    seen = [
        tuple(model.observation_space.unravel(int(o))) for o in random.integers(len(model.observation_space), size=9)
    ]

    async def main(runtime):
        network = Network(runtime.clock, team="team")
        team = Team("team", names, period=1.0)
        robots = await started(runtime, team, network, over_beliefs(model))
        await asyncio.sleep(0.5)
        for step, parts in enumerate(seen):
            if step == 3:
                network.crash(names[-1])
            for place, robot in enumerate(robots):
                robot.observe(*(part if each == place else None for each, part in enumerate(parts)))
            await asyncio.sleep(1.0)
        return robots[:-1]

    robots = run_virtual(main)
    assert all(history(robot) == history(robots[0]) for robot in robots)
    commits = robots[0].commits
    belief, action = model.initial_belief, model.action_space.index(commits[0].action)
    gone = 0
    for commit, told in zip(commits[1:], robots[0].beliefs[1:], strict=True):
        components = [
            model.observation_space.factors[place].index(commit.input[name]) if name in commit.input else None
            for place, name in enumerate(names)
        ]
        gone += names[-1] in commit.missing
        belief = exact(model, belief, action, components)
        np.testing.assert_allclose(told, belief, atol=1e-12)
        action = model.action_space.index(commit.action)
    assert gone >= 5
    assert robots[0].kinds() == ["lost_teammate"]


def test_events_at_any_agent_make_a_step_of_states():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms")
        a, b = await started(runtime, Team("rooms", ["a", "b"]), network, over_states)
        await asyncio.sleep(0.5)
        a.lab.set(False)
        await asyncio.sleep(0.5)
        assert not a.did  # nobody knows where b is
        b.lab.set(True)
        await asyncio.sleep(0.5)
        assert (a.did, b.did) == (["stay"], ["go"])
        a.lab.set(True)
        await asyncio.sleep(0.5)
        assert (a.did, b.did) == (["stay", "go"], ["go", "go"])
        assert history(a) == history(b)

    run_virtual(main)


def test_a_state_that_was_seen_before_the_link_was_open_is_told(monkeypatch):
    opening = SimulatedTransport.open

    async def slow(self):
        await asyncio.sleep(0.5)
        await opening(self)

    monkeypatch.setattr(SimulatedTransport, "open", slow)

    async def main(runtime):
        network = Network(runtime.clock, team="rooms")
        a, b = await started(runtime, Team("rooms", ["a", "b"]), network, over_states)
        a.lab.set(False)
        for lab in (False, True):  # the first is proposed, the second cannot be yet
            await asyncio.sleep(0.1)
            b.lab.set(lab)
        assert b.replica.own == (1,)
        await asyncio.sleep(1.0)
        assert (a.did[-1], b.did[-1]) == ("stay", "go")
        assert history(a) == history(b)

    run_virtual(main)


def test_states_at_a_fixed_rate_are_decided_on_at_each_tick():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms")
        a, b = await started(runtime, Team("rooms", ["a", "b"], period=1.0), network, over_states)
        a.lab.set(False)
        b.lab.set(True)
        await asyncio.sleep(4.5)
        assert a.did == ["stay"] * 4
        assert b.did == ["go"] * 4

    run_virtual(main)


def test_the_last_state_of_a_lost_agent_counts_for_its_time():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms", lease=0.5)
        team = Team("rooms", ["a", "b"], max_age=2.0)
        a, b = await started(runtime, team, network, over_states)
        a.lab.set(False)
        b.lab.set(True)
        await asyncio.sleep(1.0)
        network.crash("b")
        await asyncio.sleep(1.0)
        a.lab.set(True)
        await asyncio.sleep(0.1)
        assert a.commits[-1].action == "go go"
        await asyncio.sleep(3.0)
        assert a.ensemble.control.blind
        assert a.ensemble.state.unknown() == ("room_b (of b)",)

    run_virtual(main)


def test_a_start_a_stop_and_a_reset_concern_all():
    async def main(runtime):
        left, right = await two(runtime)
        await asyncio.sleep(0.5)
        left.ensemble.stop()
        assert left.ensemble.mode == "stopped"  # at once
        await asyncio.sleep(0.5)
        assert right.ensemble.mode == "stopped"
        left.observe("hear-left", None)
        await asyncio.sleep(0.5)
        right.ensemble.start()
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"
        right.observe(None, "hear-left")
        await asyncio.sleep(0.5)
        left.ensemble.reset()
        await asyncio.sleep(0.5)
        assert [commit.command for commit in right.commits] == ["begin", "stop", "start", None, "reset"]
        assert history(left) == history(right)
        assert left.ensemble.controller.epoch == right.ensemble.controller.epoch == 1

    run_virtual(main)


def test_an_agent_that_is_safe_goes_on_deciding_and_does_what_is_decided_when_released():
    async def main(runtime):
        def build(robot, agent):
            async def listen():
                await asyncio.sleep(0.1)
                if robot.broken:
                    raise RuntimeError("no ear")
                robot.did.append("listen")

            robot.broken = False
            ensemble = over_beliefs(problems.dec_tiger())(robot, agent, safe_action=robot.act("SAFE"))
            return mdm.Ensemble(
                "joint",
                policy=ensemble.controller.policy,
                model=problems.dec_tiger(),
                actions={"listen": listen, "open-left": robot.act("open-left"), "open-right": robot.act("open-right")},
                agent=agent,
                safe_action=robot.act("SAFE"),
            )

        left, right = await two(runtime, build)
        left.broken = True
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == "safe"
        assert right.ensemble.mode == "deciding"
        left.broken = False
        left.ensemble.release()
        await asyncio.sleep(0.5)
        assert left.did == ["SAFE", "listen"]
        left.broken = True
        left.ensemble.reset()
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == "safe"
        right.observe(None, "hear-left")
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == "deciding"  # a failed action: back with the next input
        assert left.did[-1] == "open-right"
        assert history(left) == history(right)

    run_virtual(main)


def test_a_snapshot_that_cannot_be_taken_is_told_once():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", network, over_beliefs(problems.dec_tiger())).start(runtime)
        await asyncio.sleep(1.0)
        for _ in range(20):
            left.replica.restore(b"garbage")
            await asyncio.sleep(0.05)
        assert left.kinds() == ["snapshot"]
        sound = left.replica.snapshot()
        left.replica.restore(sound)
        left.replica.restore(b"garbage")
        assert left.kinds() == ["snapshot"] * 2

    run_virtual(main)


def test_ensembles_that_cannot_be_replicated_are_refused():
    model = problems.dec_tiger()

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")

        def refused(words, team=None, agent=0, **options):
            class Nobody:
                act = staticmethod(lambda name: lambda: None)

            ensemble = over_beliefs(model)(Nobody(), agent, **options)
            with pytest.raises(mdm.ConfigError, match=words):
                (team or tigers()).member("left", ensemble, transport=network.transport("left"))

        refused("has a drive of its own", drive=2.0)
        refused("acts for the model's agent 1, but 'left' is agent 0", agent=1)
        refused("has a deadline, from its stimulus to its decision", deadline=0.1)
        refused("on_no_observation", on_no_observation="repeat")
        refused("has 2 agents .* but team 'tigers' has 3", Team("tigers", ["left", "right", "third"]))

    run_virtual(main)


def test_a_step_costs_as_many_messages_as_the_page_says():
    async def main(runtime):
        network = Network(runtime.clock, team="fire")
        team = Team("fire", ["one", "two", "three"], period=0.1)
        robots = await started(runtime, team, network, over_beliefs(random_team(7, agents=3)))
        await asyncio.sleep(1.05)

        def sent():
            traffic = [robot.member.link.transport.statistics().sent for robot in robots]
            return sum(t.messages for each in traffic for key, t in each.items() if "/agreement/" in key)

        before = sent()
        await asyncio.sleep(2.0)
        assert sent() - before == 20 * (3 + 2 * 2)

    run_virtual(main)


def test_stochastic_policies_need_the_same_seed():
    model = problems.dec_tiger()

    async def main(runtime, seeds):

        def build(robot, agent):
            policy = mdm.policies.RandomPolicy(9, 2)
            return over_beliefs(model, policy)(robot, agent, seed=seeds[agent])

        left, right = await two(runtime, build, period=0.5)
        await asyncio.sleep(5.0)
        return left, right

    left, right = run_virtual(lambda runtime: main(runtime, (4, 4)))
    assert history(left) == history(right)
    assert len(left.commits) > 8
    left, right = run_virtual(lambda runtime: main(runtime, (4, 5)))
    assert "refused" in right.kinds()


def test_copies_stay_the_same_where_the_team_stops_and_starts_while_an_agent_is_safe():
    async def main(runtime):
        def build(robot, agent):
            async def safe():
                robot.did.append("SAFE")
                await asyncio.sleep(5.0)

            return over_beliefs(problems.dec_tiger())(robot, agent, safe_action=safe)

        left, right = await two(runtime, build)
        await asyncio.sleep(0.5)
        left.ensemble.safety.endanger("mine", "why not", runtime.clock.now())
        await asyncio.sleep(0.5)
        assert left.ensemble.mode == "safe"
        right.ensemble.stop()
        await asyncio.sleep(0.5)
        right.ensemble.start()
        await asyncio.sleep(0.5)
        right.observe(None, "hear-left")
        await asyncio.sleep(6.0)
        assert history(left) == history(right)
        assert right.did[-1] == "open-right"
        left.ensemble.release()
        await asyncio.sleep(1.0)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"
        assert left.did == ["listen", "SAFE", "open-right"]

    run_virtual(main)


def test_who_observes_at_once_says_by_that_that_a_step_was_applied():
    class Observing(list):
        more = 4

        def append(self, action):
            super().append(action)
            if self.more:
                self.more -= 1
                asyncio.get_running_loop().call_soon(right.observe, None, "hear-left")

    async def main(runtime):
        nonlocal right
        left, right = await two(runtime)
        await asyncio.sleep(1.0)
        right.did = Observing()
        said = []
        put = right.transport.put

        def seen(key, body, **options):
            if "/agreement/" in key:
                said.append(type(decode(body)).__name__)
            return put(key, body, **options)

        right.transport.put = seen
        right.observe(None, "hear-left")
        await asyncio.sleep(1.0)
        assert said == ["Component"] * 5 + ["Applied"]
        assert len(right.did) == 5
        assert history(left) == history(right)

    right = None
    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_an_agent_s_own_callback_does_not_wait_until_others_are_told(mode):
    async def main(runtime):
        left, _ = await two(runtime, mode=mode)
        await asyncio.sleep(1.0)
        left.did.clear()
        put, acted = left.member.link.transport.put, []

        def seen(key, body, **options):
            if "joint" in key:
                acted.append(tuple(left.did))
            return put(key, body, **options)

        left.member.link.transport.put = seen
        left.observe("hear-left", None)
        await asyncio.sleep(0.01)
        assert acted[0] == tuple(left.did) == ("open-right",)

    run_virtual(main)
