"""A member of a team in a process of its own: prints each joint step that it applies as JSON, until it is ended.

Its argument is JSON: the agent, the agents with their endpoints, the period or none, the share of messages that are
dropped on arrival, by a seed, and the file for its decisions.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys

from team_robots import over_beliefs
from teams import team as random_team

import mdm
from mdm.team import Committed, Team
from mdm.team.transport.session import Session


class Lossy(Session):
    """A session that drops a share of what arrives."""

    def __init__(self, *given, loss, seed, **options):
        super().__init__(*given, **options)
        self.loss, self.random = loss, random.Random(seed)

    def subscribe(self, expression, handler):
        def some(sample):
            if self.random.random() >= self.loss:
                handler(sample)

        super().subscribe(expression, some)


class Robot:
    did = ()

    def act(self, name):
        return lambda: None


async def main():
    options = json.loads(sys.argv[1])
    agents = [tuple(each) for each in options["agents"]]
    team = Team("team", agents, period=options["period"], lease=1.0)
    agent = options["agent"]
    place = team.names.index(agent)
    ensemble = over_beliefs(random_team(7, agents=len(agents)))(Robot(), place)
    session = Lossy(
        *("team", agent),
        listen=agents[place][1],
        connect=[endpoint for _, endpoint in agents[:place]],
        loss=options["loss"],
        seed=options["seed"],
    )
    member = team.member(agent, ensemble, transport=session, decisions=options["decisions"])
    chance = random.Random(options["seed"])
    async with mdm.Runtime(log=None) as runtime:
        runtime.channel(f"{agent}/commits", Committed).subscribe(tell)
        await runtime.start(member)
        while True:
            await asyncio.sleep(0.05)
            seen = [None] * len(agents)
            seen[place] = chance.randrange(2)
            ensemble.publish_observation(tuple(seen))


def tell(commit):
    sys.stdout.buffer.write(commit.line())
    sys.stdout.flush()


mdm.run(main)
