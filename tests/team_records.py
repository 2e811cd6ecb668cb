"""Teams that run on a simulated network, each agent with a record of its own, and are replayed together."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from types import SimpleNamespace

import numpy as np
from team_robots import Robot, over_beliefs

import mdm
from mdm.recording import Record, Recorder
from mdm.replay import replay_together, transports_of
from mdm.team import Network


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


def recorded(team, model, folder, seed, policy=None, **ways):
    """Run a team for some seconds, each agent in a runtime of its own; return what each sent."""
    folder.mkdir(exist_ok=True)
    random = np.random.default_rng(seed)

    async def main():
        messages = {}
        async with AsyncExitStack() as runtimes:
            world = await runtimes.enter_async_context(mdm.Runtime(log=False, watchdog=None, signals=False))
            network = Network(world.clock, team=team.name, seed=seed, **ways)
            robots = [Robot(team, name, network, over_beliefs(model, policy)) for name in team.names]
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


def repeated(team, model, folder, policy=None, as_recorded=None, names=None, **options):
    """Replay what a team recorded, maybe with another policy; return what became of it, and what each sent."""
    names = names or team.names
    records = {name: Record(folder / f"{name}.mcap") for name in names}
    carriers = {name: transports_of(record) for name, record in records.items()}
    messages = {name: sent(carriers[name][name]) for name in names}
    members = {
        name: Robot(
            team, name, SimpleNamespace(transport=carriers[name].__getitem__), over_beliefs(model, policy)
        ).member
        for name in names
    }
    return replay_together(records, members, carriers, as_recorded=as_recorded, **options), messages
