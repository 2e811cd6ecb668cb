"""A team that ran on a simulated network, replayed together: it decides the same, and each agent sends the same."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from types import SimpleNamespace

import numpy as np
import pytest
from records import Writing
from team_robots import Robot, over_beliefs, three

import mdm
from mdm.recording import Record, Recorder
from mdm.recording.stimuli import Said, Stimulus
from mdm.replay import replay_together, transports_of
from mdm.team import Network, Team


def sent(transport):
    """Return a list of all that a transport sends from now on."""
    messages, put = [], transport.put

    def listened(key, body, **options):
        goes = put(key, body, **options)
        if goes and "/beat" not in key and "/farewell" not in key:
            messages.append((key, bytes(body)))
        return goes

    transport.put = listened
    return messages


def recorded(team, model, folder, seed, **ways):
    """Run a team for some seconds, each agent in a runtime of its own; return what each sent."""
    random = np.random.default_rng(seed)

    async def main():
        messages = {}
        async with AsyncExitStack() as runtimes:
            world = await runtimes.enter_async_context(mdm.Runtime(log=False, watchdog=None, signals=False))
            network = Network(world.clock, team=team.name, seed=seed, **ways)
            robots = [Robot(team, name, network, over_beliefs(model)) for name in team.names]
            for robot in robots:
                record = Recorder(folder / f"{robot.name}.mcap")
                runtime = mdm.Runtime(log=False, watchdog=None, signals=False, record=record)
                messages[robot.name] = sent(robot.transport)
                await robot.start(await runtimes.enter_async_context(runtime))
            await asyncio.sleep(1.0)
            for _ in range(12):
                agent = int(random.integers(len(robots)))
                size = len(model.observation_space.factors[agent].names)
                parts = [None] * len(robots)
                parts[agent] = int(random.integers(size))
                robots[agent].observe(*parts)
                await asyncio.sleep(float(random.choice([0.0, 0.01, 0.3])))
            await asyncio.sleep(1.0)
            return {name: [*said] for name, said in messages.items()}

    return mdm.run(main, virtual=True)


def repeated(team, model, folder):
    """Replay what a team recorded; return what became of it, and what each sent."""
    records = {name: Record(folder / f"{name}.mcap") for name in team.names}
    carriers = {name: transports_of(record) for name, record in records.items()}
    messages = {name: sent(carriers[name][name]) for name in team.names}
    members = {
        name: Robot(team, name, SimpleNamespace(transport=carriers[name].__getitem__), over_beliefs(model)).member
        for name in team.names
    }
    return replay_together(records, members, carriers), messages


TEAMS = [
    {},
    {"period": 0.1},
    {"mode": "centralised"},
    {"mode": "centralised", "period": 0.1},
    {"mode": "communicating", "period": 0.1},
]


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.parametrize("options", TEAMS)
@pytest.mark.parametrize("ways", [{"delay": 0.001}, {"delay": (0.001, 0.03), "loss": 0.1}])
def test_each_agent_sends_what_it_sent(tmp_path, seed, options, ways):
    """Of some messages several come at once, and what is said of the first may be said with what the second brings."""
    model, team = three(), Team("fire", ["one", "two", "three"], **options)
    live = recorded(team, model, tmp_path, seed, **ways)
    together, again = repeated(team, model, tmp_path)
    assert together.same, (together.unlike[:1], [each.differences[:1] for each in together.agents.values()])
    assert all(each.recorded == each.replayed > 5 for each in together.agents.values())
    assert together.received > 50
    for name, messages in live.items():
        assert again[name][: len(messages)] == messages


@pytest.mark.parametrize("options", TEAMS)
def test_observations_that_a_record_lacks_are_messages_that_its_agent_has_not_sent(tmp_path, options):
    """They are found where others received them, who go on with what their records say."""
    model, team = three(), Team("fire", ["one", "two", "three"], **options)
    recorded(team, model, tmp_path, 1)
    kept = Record(tmp_path / "two.mcap")
    shorter = Writing(tmp_path / "shorter.mcap", kept.head)
    for name, facts in kept.metadata.items():
        if name.startswith("ensemble "):
            shorter.writer.metadata(name, facts)
    for each in kept.messages(["stimuli", "decisions"]):
        if not isinstance(each.message, Said):
            shorter.write(each.topic, each.message, Stimulus if each.topic == "stimuli" else None)
    shorter.close().replace(tmp_path / "two.mcap")
    together, _ = repeated(team, model, tmp_path)
    assert not together.same
    assert together.unlike
    assert {each.owner for each in together.unlike} >= {"two"}
