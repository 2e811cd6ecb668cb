"""Records of teams: joint decisions count once, and silence is no chance."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack

import numpy as np
import pytest
from records import Writing, decision
from sentences import refused
from team_robots import Robot, over_beliefs

import mdm
from mdm import ModelError
from mdm.estimation import chains_of_records, open_records, statistics
from mdm.recording import Recorder
from mdm.stimuli import Joined, Stimulus
from mdm.team import Network, OnChange, Team

TIGER = mdm.problems.dec_tiger(discount=0.9)
COUNT = 40


def ran(folder, team, joints):
    """Record what a team's agents decide; each sees its part of a joint observation a second."""

    async def main():
        async with AsyncExitStack() as runtimes:
            world = await runtimes.enter_async_context(mdm.Runtime(log=False, watchdog=None, signals=False))
            network = Network(world.clock, team=team.name, seed=1)
            robots = [Robot(team, name, network, over_beliefs(TIGER)) for name in team.names]
            for robot in robots:
                record = Recorder(folder / f"{robot.name}.mcap")
                runtime = mdm.Runtime(log=False, watchdog=None, signals=False, record=record)
                await robot.start(await runtimes.enter_async_context(runtime))
            await asyncio.sleep(2.5)
            for joint in joints:
                for place, robot in enumerate(robots):
                    robot.observe(*(value if own == place else None for own, value in enumerate(joint)))
                await asyncio.sleep(1)

    mdm.run(main, virtual=True)
    return [folder / f"{name}.mcap" for name in team.names]


@pytest.fixture(scope="module")
def tigers(tmp_path_factory):
    """Return what a communicating team saw, and its records: each shares what is another than before."""
    joints = np.random.default_rng(2).integers(2, size=(COUNT, 2)).tolist()
    team = Team("tigers", ["left", "right"], mode="communicating", period=1.0, communication=OnChange())
    return joints, ran(tmp_path_factory.mktemp("tigers"), team, joints)


@pytest.mark.parametrize("name", ["joint", "left/joint"])
def test_what_a_communicating_team_saw_is_in_the_records_of_all_its_agents(tigers, name):
    joints, paths = tigers
    chains = chains_of_records(open_records(paths), name, TIGER)
    (chain,) = chains.chains
    assert [list(each.observation) for each in chain.decisions[1:]] == joints
    assert chains.unused == ()


def test_a_record_of_a_communicating_team_that_is_missing_is_named(tigers):
    _, paths = tigers
    with refused(ModelError):
        chains_of_records(open_records(paths[:1]), None, TIGER)
    with refused(ModelError):
        chains_of_records(open_records(paths), "joint")


def written(path, rows):
    """Write a record whose first message is a stimulus."""
    record = Writing(path)
    for topic, message in rows:
        record.write(topic, message, Stimulus if topic == "stimuli" else None)
    return record.close()


def of_agent(agent, actions, seen, *, mode, epochs=None):
    """Return an agent's record as written: what it did, and its component of what was seen."""
    facts = {"team's agents": "ada, bob", "team's mode": mode, "configuration of ensemble 'joint'": "x"}
    rows = [("stimuli", Joined(0, agent, 1, facts))]
    for number, (action, observation) in enumerate(zip(actions, seen, strict=True)):
        told = {"state": None, "observation": observation, "action": action, "cause": "tick", "epoch": number}
        told |= {} if epochs is None else {"epoch": epochs[number]}
        rows.append(("decisions", decision(number, ensemble=f"{agent}/joint", **told)))
    return rows


def test_each_agent_tells_its_own_component_of_actions_and_observations(tmp_path):
    """A joint action is 3 times ada's plus bob's; what each takes for the other's is not what that did."""
    paths = [
        written(tmp_path / "ada.mcap", of_agent("ada", [0, 3, 8], [None, (1, None), 2], mode="communicating")),
        written(
            tmp_path / "bob.mcap", of_agent("bob", [1, 8, 0], [None, (None, 0), (None, None)], mode="communicating")
        ),
    ]
    (chain,) = chains_of_records(open_records(paths), "joint", TIGER).chains
    assert [each.action for each in chain.decisions] == [1, 5, 6]
    assert [each.observation for each in chain.decisions] == [(None, None), (1, 0), (1, None)]
    assert (
        "in 1 of 2 steps a part" in statistics(chains_of_records(open_records(paths), "joint", TIGER), TIGER).notes[1]
    )


def test_nothing_is_counted_across_a_tick_that_an_agent_lacks(tmp_path):
    rows = of_agent("ada", [0] * 6, [None] * 6, mode="communicating", epochs=[0, 1, 2, 0, 1, 2])
    other = of_agent("bob", [0] * 6, [None] * 6, mode="communicating")
    del other[-1]
    paths = [written(tmp_path / f"{place}.mcap", each) for place, each in enumerate((rows, other))]
    chains = chains_of_records(open_records(paths), "joint", TIGER)
    assert [len(chain.decisions) for chain in chains.chains] == [3, 2]
    with refused(ModelError):
        chains_of_records(open_records([*paths, written(tmp_path / "again.mcap", other)]), "joint", TIGER)


def test_joint_decisions_that_a_team_agreed_on_count_once(tmp_path):
    rows = of_agent("ada", [0, 0, 0], [0, 1, 2], mode="replicated")
    fewer = of_agent("bob", [0, 0], [0, 1], mode="replicated")
    paths = [written(tmp_path / f"{place}.mcap", each) for place, each in enumerate((fewer, rows))]
    chains = chains_of_records(open_records(paths), "joint", TIGER)
    assert (chains.decisions, chains.unused) == (3, (f"{paths[0]}: bob/joint",))
