"""Teams of two agents in virtual time, whose links break and whose agents end: their commits, modes and faults."""

from __future__ import annotations

import asyncio
import random

import numpy as np

import mdm
from mdm import problems
from mdm.policies import AlphaVectors
from mdm.team import Committed, Network, Team
from mdm.testing import run_virtual

MODES = ("replicated", "centralised", "communicating")


class Agents:
    """The agents of a team.

    Args:
        runtime: Theirs.
        seed: Of the team, and of what befalls it.
    """

    def __init__(self, runtime, seed):
        self.draw, self._runtime, self.heard = random.Random(seed), runtime, []
        self._model = problems.dec_tiger()
        mode = MODES[seed % len(MODES)]
        self.names = ["ada", "bo"]
        more = {"controller": self.draw.choice(self.names)} if mode == "centralised" else {}
        more |= {"period": 0.1} if mode == "communicating" or self.draw.random() < 0.4 else {}
        self.network = Network(runtime.clock, team="pair", delay=self.draw.choice([0.0001, 0.002]))
        self._team = Team("pair", self.names, mode=mode, **more)
        self.members, self.ensembles = {}, {}

    def _policy(self):
        rewards = np.asarray(self._model.rewards)
        steps = [np.asarray(self._model.transition_matrix(action)) for action in range(rewards.shape[1])]
        vectors = [rewards[:, index] + 0.9 * step @ rewards.max(axis=1) for index, step in enumerate(steps)]
        return AlphaVectors(np.array(vectors), list(range(len(vectors))))

    async def begin(self, name):
        """Have an agent begin."""
        agent = self.names.index(name)
        actions = self._model.action_space.factors[agent].names
        self.ensembles[name] = mdm.Ensemble(
            "joint",
            policy=self._policy(),
            model=self._model,
            actions={action: lambda action=action: self.heard.append(f"{name} does {action}") for action in actions},
            safe_action=lambda: self.heard.append(f"{name} is safe"),
            agent=agent,
        )
        self.members[name] = self._team.member(name, self.ensembles[name], transport=self.network.transport(name))
        commits = self._runtime.channel(f"{name}/commits", Committed)
        commits.subscribe(lambda commit: self.heard.append(f"{name} {commit}"))
        await self._runtime.start(self.members[name])

    async def end(self, name):
        """Have an agent end, as where its machine is switched off."""
        self.network.crash(name)
        await self._runtime.stop(self.members.pop(name))

    async def befall(self):
        """Let something happen."""
        draw = self.draw
        chance, name = draw.random(), draw.choice(self.names)
        if chance < 0.05:
            self.network.partition(*({each} for each in self.names))
        elif chance < 0.12:
            self.network.heal()
        elif chance < 0.15 and name in self.members:
            await self.end(name)
        elif name not in self.members:
            await self.begin(name)
        else:
            observation = [draw.randrange(2) if each == name else None for each in self.names]
            self.ensembles[name].publish_observation(observation)


def seen(seed, _):
    """Return what the team of a seed does."""
    heard = []

    async def main(runtime):
        for channel in (runtime.modes, runtime.faults, runtime.decisions):
            channel.subscribe(lambda message: heard.append(str(message)))
        agents = Agents(runtime, seed)
        agents.heard = heard
        for name in agents.names:
            await agents.begin(name)
        await asyncio.sleep(0.5)
        for _ in range(40):
            await agents.befall()
            await asyncio.sleep(agents.draw.choice([0.0, 0.01, 0.05, 0.3]))
        agents.network.heal()
        await asyncio.sleep(3.0)

    try:
        run_virtual(main, log=False)
    except Exception as error:
        heard.append(f"{type(error).__name__}: {error}")
    return heard
