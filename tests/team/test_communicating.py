"""Communicating teams: each agent decides on what it knows, and what others say counts for its step, however late."""

from __future__ import annotations

import asyncio

import msgspec
import numpy as np
import pytest
from patience import PATIENCE
from sentences import refused
from team_robots import Robot, decider, over_beliefs, over_states, started
from transports import endpoint

import mdm
from mdm import problems
from mdm.errors import ConfigError
from mdm.team import Always, Budget, Knowledge, Never, OnChange, Team, ValueOfCommunication
from mdm.team.communicating import Update, encode
from mdm.team.transport.network import Network
from mdm.team.transport.router import Packer
from mdm.testing import run_virtual

PERIOD = 1.0
TIGER = problems.dec_tiger()


def tigers(communication=None, **options):
    options = {"mode": "communicating", "period": PERIOD, "communication": communication} | options
    return Team("tigers", ["left", "right"], **options)


def seen(count, *, model=TIGER, seed=3):
    """Return what the agents of a team observe, step by step."""
    space = model.observation_space
    return [tuple(space.unravel(int(each))) for each in np.random.default_rng(seed).integers(len(space), size=count)]


async def observe(robots, joints):
    """Have all observe before each tick, from the one after the present step on."""
    for joint in joints:
        await asyncio.sleep(PERIOD / 4)
        for place, robot in enumerate(robots):
            if robot is not None:
                robot.observe(*(value if place == own else None for own, value in enumerate(joint)))
        await asyncio.sleep(3 * PERIOD / 4)


async def until_step_0(robots):
    """Wait until a fifth of a period after the decision of step 0."""
    while not all(decisions(robot) for robot in robots):
        await asyncio.sleep(PERIOD / 20)
    now = robots[0].runtime.clock.now() / 1e9
    await asyncio.sleep(now // PERIOD * PERIOD + PERIOD / 5 - now)


async def two(runtime, build=None, **options):
    """Return two robots at step 0, on a network with these options."""
    network = Network(runtime.clock, team="tigers", **options)
    robots = await started(runtime, tigers(), network, build or over_beliefs(TIGER))
    await until_step_0(robots)
    return robots


def decisions(robot):
    return [commit for commit in robot.commits if commit.command is None]


def actions(robot):
    return [commit.action for commit in decisions(robot)]


def components(robots, model=TIGER):
    """Return the joint actions that were really decided: of each agent its own component."""
    space = model.action_space
    joints = zip(*([space.unravel(space.index(action)) for action in actions(robot)] for robot in robots), strict=True)
    return [tuple(each[agent] for agent, each in enumerate(joint)) for joint in joints]


def lose(robot, lost):
    """Have what a robot shares at some steps be lost on the way."""
    talker = robot.replica
    say = talker._send

    def say_or_lose(experiences=()):
        return bool(experiences and lost(talker.steps.present, talker.ensemble.agent)) or say(experiences)

    talker._send = say_or_lose


def talk(communication, joints, *, delay=0.01, loss=0.0, lost=None, model=TIGER, names=("left", "right"), **options):
    """Run a team through what its agents observe, and return its robots."""

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", delay=0.001)
        team = Team("tigers", names, mode="communicating", period=PERIOD, communication=communication, **options)
        robots = await started(runtime, team, network, over_beliefs(model))
        for robot in robots if lost is not None else ():
            lose(robot, lost)
        await until_step_0(robots)
        network.loss, network._delay = loss, (delay, delay)
        await observe(robots, joints)
        await asyncio.sleep(PERIOD / 2)  # by when the last step is decided, and the next has not begun
        return robots

    return run_virtual(main)


def simulated(communication, joints, *, delay=0, lost=lambda step, agent: False, model=TIGER):
    """Return the components that agents decide by the rules of the simulation, without network and clock."""
    policy = decider(model)
    agents = [Knowledge(policy, model, agent, communication()) for agent in range(model.num_agents)]
    under_way, result = {}, []
    for step in range(len(joints) + 1):
        if step:
            for agent, value in zip(agents, joints[step - 1], strict=True):
                agent.observe(value)
        asked = set(range(len(agents)))
        heard = deliver(agents, under_way.pop(step, []))
        while asked:
            for history in [said for each in sorted(asked) if (said := agents[each].share(step * PERIOD))]:
                if not lost(step, history.agent):
                    under_way.setdefault(step + delay, []).append(history)
            heard = deliver(agents, under_way.pop(step, []))
            asked = heard
        result.append(tuple(agent.decide() and agent.component for agent in agents))
    return result


def deliver(agents, histories):
    heard = set()
    for history in histories:
        for agent in agents:
            if agent.agent != history.agent:
                agent.hear(history)
                heard.add(agent.agent)
    return heard


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.4])
def test_sharing_always_without_loss_decides_as_one(delay):
    joints = seen(12)
    robots = talk(Always(), joints, delay=delay)
    alone = mdm.Controller(decider(TIGER), TIGER)
    names = [alone.start().action_name] + [alone.observe(joint).action_name for joint in joints]
    assert [actions(robot) for robot in robots] == [names, names]
    left, right = (robot.replica.statistics() for robot in robots)
    assert (left.sent, left.heard, left.late, left.held) == (12, 12, 0, 0)
    assert left.role == right.role == "talking"
    assert left.step == right.step == 12
    assert decisions(robots[0])[-1].missing == ()
    assert left.digest == right.digest


def test_three_agents_decide_as_one():
    model = problems.fire_fighting(houses=2, team=3, fire_levels=2)
    joints = seen(6, model=model)
    robots = talk(Always(), joints, model=model, names=("a", "b", "c"))
    alone = mdm.Controller(decider(model), model)
    names = [alone.start().action_name] + [alone.observe(joint).action_name for joint in joints]
    assert [actions(robot) for robot in robots] == [names] * 3


def test_who_says_nothing_is_not_waited_for_and_decides_alone():
    joints = seen(8)
    robots = talk(Never(), joints)
    assert [robot.replica.statistics().sent for robot in robots] == [0, 0]
    assert components(robots) == simulated(Never, joints)
    last = decisions(robots[0])[-1]
    assert last.missing == ("right",)
    assert list(last.input) == ["left"]
    assert last.time % 1e9 == 0


@pytest.mark.parametrize(
    "communication",
    [Always, OnChange, lambda: Budget(0.5), lambda: ValueOfCommunication(0.5)],
    ids=["always", "on_change", "budget", "value"],
)
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_agents_decide_as_in_the_simulation(communication, delay):
    joints = seen(15, seed=5)
    # A message of k steps' delay arrives shortly before the tick of the k-th step after its own.
    robots = talk(communication(), joints, delay=delay * PERIOD - 0.1 if delay else 0.01)
    assert components(robots) == simulated(communication, joints, delay=delay)
    if delay == 3:
        assert robots[0].replica.statistics().late > 0


@pytest.mark.parametrize("delay", [0, 2])
def test_agents_decide_as_in_the_simulation_where_messages_are_lost(delay):
    joints = seen(15, seed=6)
    chances = np.random.default_rng(1).random((16, 2)) < 0.4

    def lost(step, agent):
        return chances[step, agent]

    robots = talk(Always(), joints, delay=delay * PERIOD - 0.1 if delay else 0.01, lost=lost)
    assert components(robots) == simulated(Always, joints, delay=delay, lost=lost)
    if not delay:
        assert components(robots) != simulated(Always, joints)


def test_who_shares_what_is_worth_it_sends_less():
    joints = seen(20)
    always, choosing = (
        sum(robot.replica.statistics().sent for robot in talk(communication, joints))
        for communication in (Always(), ValueOfCommunication(1.0))
    )
    assert 0 < choosing < always == 40


def test_what_is_lost_is_summed_over():
    joints = seen(10)
    robots = talk(Always(), joints, loss=1.0)
    assert components(robots) == simulated(Never, joints)
    assert all(commit.missing == ("right",) for commit in decisions(robots[0])[1:])
    assert robots[0].replica.statistics().sent == 10
    assert robots[0].replica.statistics().heard == 0


def test_commands_are_for_all_and_a_new_episode_begins_anew():
    async def main(runtime):
        left, right = await two(runtime, loss=0.2, seed=2)
        await observe([left, right], seen(3))
        right.ensemble.stop()
        await asyncio.sleep(3.0)
        assert [robot.ensemble.mode for robot in (left, right)] == ["stopped", "stopped"]
        count = len(decisions(left))
        await asyncio.sleep(3.0)
        assert len(decisions(left)) == count
        left.ensemble.start()
        await asyncio.sleep(3.5)  # some of the first words may be lost
        assert [robot.ensemble.mode for robot in (left, right)] == ["deciding", "deciding"]
        for robot in (left, right):
            assert decisions(robot)[-1].term[:2] == (3, "left")
            assert decisions(robot)[-1].step == 2
        right.ensemble.reset()
        left.ensemble.reset()  # two at once
        await asyncio.sleep(4.5)
        assert decisions(left)[-1].term == decisions(right)[-1].term
        assert decisions(left)[-1].step == decisions(right)[-1].step == 3
        commands = [commit.command for commit in left.commits if commit.command]
        assert commands[commands.index("stop") :][:3] == ["stop", "start", "start"]

    run_virtual(main)


@pytest.mark.parametrize("horizon", [None, 4])
def test_a_late_joiner_takes_part_in_the_present_step(horizon):
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", network, over_beliefs(TIGER, horizon=horizon)).start(runtime)
        await until_step_0([left])
        await observe([left, None], seen(5))
        right = await Robot(tigers(), "right", network, over_beliefs(TIGER, horizon=horizon)).start(runtime)
        await observe([left, right], seen(7, seed=4))
        await asyncio.sleep(PERIOD / 2)
        assert decisions(right)[-1].term == decisions(left)[-1].term
        assert decisions(right)[-1].step == decisions(left)[-1].step == 12
        epochs = [robot.ensemble.controller.epoch for robot in (left, right)]
        assert epochs[0] == epochs[1]
        if horizon is not None:  # and by now an episode of the model has begun in which both know everything
            assert decisions(right)[-1].digest == decisions(left)[-1].digest
        assert decisions(right)[-1].missing == ()

    run_virtual(main)


def test_who_crashes_is_lost_and_takes_part_again_when_it_comes_back():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        team = tigers(lease=0.5)

        def build(robot, agent):
            safe = {"safe_action": robot.act("SAFE"), "on_lost_teammate": "safe_action"}
            return over_beliefs(TIGER)(robot, agent, **safe)

        left, right = await started(runtime, team, network, build)
        await until_step_0([left, right])
        await observe([left, right], seen(3))
        network.crash("right")
        await asyncio.sleep(2.0)
        await runtime.stop(right.member)
        assert left.kinds() == ["lost_teammate"]
        assert left.ensemble.mode == "safe"
        assert left.did[-1] == "SAFE"
        assert decisions(left)[-1].missing == ("right",)
        back = await Robot(team, "right", network, build).start(runtime)
        await asyncio.sleep(2.5)
        assert left.ensemble.mode == "deciding"
        assert left.did[-1] != "SAFE"
        assert decisions(back)[-1].term == decisions(left)[-1].term
        assert decisions(back)[-1].step == decisions(left)[-1].step
        assert decisions(left)[-1].missing == ()

    run_virtual(main)


def test_what_was_really_done_is_told():
    async def main(runtime):
        def build(robot, agent):
            return over_beliefs(TIGER)(robot, agent, safe_action="open-left")

        left, right = await two(runtime, build)
        await observe([left, right], seen(2))
        told = []
        network_word = right.replica._receive
        right.replica._receive = lambda agent, experiences: (told.extend(experiences), network_word(agent, experiences))
        left.ensemble.safety.endanger("test", "a test", runtime.clock.now())
        await asyncio.sleep(3.0)
        assert left.ensemble.mode == "safe"
        opened = TIGER.action_space.factors[0].index("open-left")
        assert [each.action for each in told][1:] == [opened] * (len(told) - 1)
        assert told[0].action is None  # it began within a step, in which something else was done before

    run_virtual(main)


def test_a_loop_that_hangs_goes_on_at_the_present_step():
    async def main(runtime):
        left, right = await two(runtime)
        left.replica._on_tick, kept = lambda tick: None, left.replica._on_tick
        for ticker in list(left.replica._Actor__timers):
            ticker.cancel()
        await asyncio.sleep(3.0)
        left.replica._on_tick = kept
        left.replica.every(1 / PERIOD, left.replica._on_tick)
        await asyncio.sleep(2.0)
        assert decisions(left)[-1].step == decisions(right)[-1].step
        assert left.replica.knowledge.step == decisions(left)[-1].step

    run_virtual(main)


def test_another_configuration_is_not_heard():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", network, over_beliefs(TIGER)).start(runtime)
        right = await Robot(tigers(), "right", network, over_beliefs(TIGER, horizon=2)).start(runtime)
        await asyncio.sleep(5.0)
        assert (left.role, right.role) == ("talking", "refused")
        assert right.kinds() == ["refused"]
        assert right.faults[0].detail == "right cannot take part in the team: horizon is 2 at right and None at left"
        assert right.did == right.commits == []
        right.ensemble.reset()
        await asyncio.sleep(1.0)
        assert decisions(left)[-1].missing == ("right",)
        assert decisions(left)[-1].term[0] == 1


def test_who_returns_with_another_configuration_takes_no_part_and_says_why():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left, right = await started(runtime, tigers(), network, over_beliefs(TIGER))
        await asyncio.sleep(5.0)
        await runtime.stop(left.member)
        back = await Robot(tigers(max_age=7.0), "left", network, over_beliefs(TIGER)).start(runtime)
        await asyncio.sleep(10.0)
        assert back.commits == []
        assert back.role == "refused"
        details = [fault.detail for fault in back.faults if fault.kind == "refused"]
        assert details == ["left cannot take part in the team: team's max_age is 7 s at left and 1 s at right"]
        assert right.role == "talking"

    run_virtual(main)


def test_garbage_is_counted():
    async def main(runtime):
        left, right = await two(runtime)
        right.member.link.send("mdm/tigers/right/joint/update", b"garbage", priority="step")
        word = right.replica._send
        word((mdm.team.Experience(1, 99, 0),))
        word((mdm.team.Experience(1, 0, 0), mdm.team.Experience(1, 0, 1)))
        word((mdm.team.Experience(5000, 0, 0),))
        word((mdm.team.Experience(-5, 0, 0),))
        await asyncio.sleep(0.2)
        found = left.replica.statistics()
        assert (found.malformed, found.refused, found.too_late) == (2, 2, 1)
        assert sorted(left.kinds()) == ["history", "incredible", "word"]
        await asyncio.sleep(3.0)
        assert left.ensemble.mode == "deciding"

    run_virtual(main)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"period": None}, "give a period"),
        ({"quorum": "majority"}, "a quorum is for replicated teams"),
        ({"communication": "always"}, "needs a method share"),
        ({"mode": "replicated", "communication": Always()}, "is for communicating teams"),
    ],
)
def test_settings_that_mean_nothing_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        tigers(**options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"deadline": 0.1}, "leave its deadline out"),
        ({"on_impossible": "safe_action", "safe_action": "listen"}, "on_impossible is 'predict', 'keep' or 'reset'"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, said):
    async def main(runtime):
        with pytest.raises(ConfigError, match=said):
            Robot(tigers(), "left", Network(runtime.clock, team="tigers"), over_beliefs(TIGER), **options)

    run_virtual(main)


def test_a_command_before_the_first_tick_begins_now():
    async def main(runtime):
        await asyncio.sleep(3e5 + 1)
        network = Network(runtime.clock, team="tigers")
        left, _ = await started(runtime, tigers(period=5.0), network, over_beliefs(TIGER))
        await asyncio.sleep(0.1)
        left.ensemble.reset()
        left.ensemble.start()
        await asyncio.sleep(30.0)
        assert 4 <= left.replica.statistics().step <= 6
        assert left.ensemble.summary().endswith("a step of the team every 5 s")

    run_virtual(main)


def test_ensembles_that_cannot_talk_are_refused():
    async def main(runtime):
        network = Network(runtime.clock, team="rooms")
        team = Team("rooms", ["a", "b"], mode="communicating", period=1.0)
        with refused(ConfigError):
            Robot(team, "a", network, over_states)

    run_virtual(main)


class Sessions:
    """Real sessions on loopback, in place of a network."""

    def __init__(self, team):
        self.team = team

    def transport(self, agent):
        from mdm.team.transport.session import Session

        place = self.team.names.index(agent)
        ends = [each.endpoint for each in self.team.agents]
        return Session(self.team.name, agent, listen=ends[place], connect=ends[:place])


def test_agents_talk_over_real_sessions():
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    team = Team("tigers", [("left", endpoint()), ("right", endpoint())], mode="communicating", period=0.1)
    robots = []

    def known():
        """Return the steps that both decided on with everything known."""
        full = [
            {commit.step: (commit.term, commit.action, commit.digest) for commit in decisions(robot) if full_of(commit)}
            for robot in robots
        ]
        return [(full[0][step], full[1][step]) for step in full[0].keys() & full[1].keys()]

    def full_of(commit):
        return commit.step and not commit.missing and len(commit.input) == 2

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            robots.extend(await started(runtime, team, Sessions(team), over_beliefs(TIGER)))
            random = np.random.default_rng(1)
            async with asyncio.timeout(PATIENCE):
                while len(known()) < 10:
                    for place, robot in enumerate(robots if all(map(decisions, robots)) else ()):
                        robot.observe(*(int(random.integers(2)) if own == place else None for own in range(2)))
                    await asyncio.sleep(0.02)

    mdm.run(main)
    assert all(left == right for left, right in known())
    assert robots[0].replica.statistics().heard > 0


@pytest.mark.parametrize("changed", [{"running": False}, {"token": "x"}, {"stops": {"left": 1}}])
def test_two_in_episodes_that_another_made_unlike_agree_and_do_not_shout_at_each_other(changed):
    async def main(runtime):
        robots = left, right = await two(runtime)
        new = msgspec.structs.replace(left.replica.episode, number=7)
        for owner, hearer, episode in ((left, right, new), (right, left, msgspec.structs.replace(new, **changed))):
            word = Update(episode, owner.replica._configuration, (), owner.replica.stops.last)
            packer, key = Packer(owner.name, owner.transport.incarnation, runtime.clock.now), owner.replica._key
            packer.sent[key] = [hearer.transport.unpacker._last[key].number, 0]
            hearer.transport.arrive(key, packer.pack(key, encode(word)))
        before = sum(robot.transport.statistics().sent[robot.replica._key].messages for robot in robots)
        await asyncio.sleep(2 * PERIOD)
        said = sum(robot.transport.statistics().sent[robot.replica._key].messages for robot in robots)
        assert said < before + 20
        assert left.replica.episode == right.replica.episode
        assert left.ensemble.mode == right.ensemble.mode
        left.ensemble.start()
        await asyncio.sleep(3 * PERIOD)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"

    run_virtual(main)


@pytest.mark.parametrize(
    ("episode", "stops", "words"),
    [
        ({"number": 10**9}, {}, "is of episode 1000000000, which cannot be yet"),
        ({"number": 7, "by": "mallory"}, {}, "is of an episode that 'mallory' began, who is none of the team"),
        (
            {"number": 7, "origin": 10**9},
            {},
            "is of an episode that begins at tick 1000000000, more than a lease ahead",
        ),
        ({"number": 7, "stops": {"left": 10**15}}, {}, "reports a stop that cannot have been yet"),
        ({"number": 7}, {"left": 10**15}, "reports a stop that cannot have been yet"),
    ],
)
def test_what_no_agent_says_of_episodes_and_stops_is_dropped(episode, stops, words):
    async def main(runtime):
        left, right = await two(runtime)
        before = left.replica.episode
        word = Update(msgspec.structs.replace(before, **episode), left.replica._configuration, (), stops)
        right.member.link.send(right.replica._key, encode(word), priority="step")
        await asyncio.sleep(0.2)
        assert left.replica.episode == before
        assert left.replica.stops.last == {}
        assert left.replica.statistics().malformed == 1
        [told] = [fault.detail for fault in left.faults if fault.kind == "incredible"]
        assert words in told
        await asyncio.sleep(3 * PERIOD)
        assert left.ensemble.mode == right.ensemble.mode == "deciding"

    run_virtual(main)
