"""Both robots hear and decide the same, and open the right door more often, in two minutes of virtual time."""

import asyncio
import random
from contextlib import AsyncExitStack
from pathlib import Path

import mdm
from mdm.team import Committed, Network

FILE = Path(__file__).parent / "team.toml"


async def minutes():
    team = mdm.config.load_team(FILE)
    commits = {name: {} for name in team.names}
    async with AsyncExitStack() as stack:
        runtimes = {name: await stack.enter_async_context(mdm.Runtime(log=None)) for name in team.names}
        network = Network(runtimes["ada"].clock, team=team.name, seed=1)
        for name, runtime in runtimes.items():

            def keep(commit, own=commits[name]):
                own[commit.step] = commit

            await runtime.start(mdm.load_system(FILE, agent=name, transport=network.transport(name)))
            runtime.channel(f"{name}/commits", Committed).subscribe(keep)
        await asyncio.sleep(120)
    return commits


def test_both_decide_the_same():
    random.seed(1)
    commits = mdm.run(minutes, virtual=True)
    ada, bob = commits["ada"], commits["bob"]
    both = ada.keys() & bob.keys()
    assert len(both) > 100
    assert all(ada[step].digest == bob[step].digest for step in both)
    for name in ("ada", "bob"):  # each hears something of its own in nearly every step
        assert sum(name in ada[step].input for step in both) > 0.9 * len(both)
    done = [ada[step].action for step in both]
    assert done.count("open-right open-right") > 2 * done.count("open-left open-left")
