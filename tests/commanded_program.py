"""A member of a team in a process of its own, which can be cut off from the others while whoever asks still reaches it.

Its argument is JSON: the agent, the agents with their endpoints, the mode, the lease, and the folder of its state. Each
line of its input is JSON: ``{"cut": true}`` keeps all messages of the team from it, and its own from the others. It
prints when an action begins, in nanoseconds of the machine's monotonic clock.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

from team_robots import over_beliefs
from teams import team as random_team

import mdm
from mdm.team import Team
from mdm.team.transport.session import Session


class Severed(Session):
    """A session that can be cut off from the other agents, but not from those who ask."""

    cut = False

    def put(self, key, body, *, priority="value"):
        return not self.cut and super().put(key, body, priority=priority)

    def subscribe(self, expression, handler):
        super().subscribe(expression, lambda sample: None if self.cut else handler(sample))

    async def ask(self, expression, body=b"", **options):
        return {} if self.cut else await super().ask(expression, body, **options)


class Robot:
    def act(self, name):
        return lambda: tell(began=time.monotonic_ns())


def tell(**event):
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


async def main():
    options = json.loads(sys.argv[1])
    agents = [tuple(each) for each in options["agents"]]
    more = {"mode": options["mode"], "state": options.get("state")}
    team = Team("team", agents, period=0.1, lease=options["lease"], **more)
    agent = options["agent"]
    place = team.names.index(agent)
    session = Severed(
        *("team", agent),
        listen=agents[place][1],
        connect=[endpoint for _, endpoint in agents[:place]],
        lease=team.lease,
    )

    ended = asyncio.Event()

    def order():
        line = sys.stdin.readline()
        if line:
            session.cut = json.loads(line)["cut"]
            tell(cut=session.cut)
        else:  # whoever started it is gone
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            ended.set()

    async with mdm.Runtime(log=None) as runtime:
        asyncio.get_running_loop().add_reader(sys.stdin.fileno(), order)
        ensemble = over_beliefs(random_team(7, agents=len(agents)))(Robot(), place)
        await runtime.start(team.member(agent, ensemble, transport=session))
        tell(running=agent)
        await ended.wait()


mdm.run(main)
