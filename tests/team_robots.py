"""Teams of robots on a simulated network, in virtual time."""

from __future__ import annotations

import functools

import numpy as np

import mdm
from mdm import problems
from mdm.models import MDP, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.team.decisions import Committed
from mdm.team.team import Team
from mdm.team.transport.network import Network


class Robot:
    """One agent of a team, with what it did, was told to do, and reported."""

    def __init__(self, team, name, network, build, *, member=lambda name: {}, **options):
        self.name = name
        self.did = []
        self.commits = []
        self.beliefs = []
        self.faults = []
        self.ensemble = build(self, team.names.index(name), **options)
        self.member = team.member(name, self.ensemble, transport=network.transport(name), **member(name))

    @property
    def replica(self):
        return self.member.layers[self.ensemble.name]

    @property
    def transport(self):
        return self.member.link.transport

    @property
    def role(self):
        return self.replica.statistics().role

    async def start(self, runtime):
        self.runtime = runtime
        runtime.channel(f"{self.name}/commits", Committed).subscribe(self._on_commit)
        runtime.faults.subscribe(self._on_fault)
        await runtime.start(self.member)
        return self

    async def start_alone(self, runtime):
        """Start, and go on without teammates that were never met, as a person has said."""
        await self.start(runtime)
        self.ensemble.start()
        return self

    def _on_commit(self, commit):
        self.commits.append(commit)
        self.beliefs.append(self.ensemble.controller.belief)

    def _on_fault(self, fault):
        if fault.source.split("/")[0] == self.name:
            self.faults.append(fault)

    def kinds(self):
        return [fault.kind for fault in self.faults]

    def observe(self, *components):
        self.ensemble.publish_observation(components)

    def act(self, name):
        return lambda: self.did.append(name)

    def actions(self):
        return [commit.action for commit in self.commits]


async def started(runtime, team, network, build, *, names=None, **options):
    """Return the robots of a team, or some of them, running."""
    robots = [Robot(team, name, network, build, **options) for name in names or team.names]
    for robot in robots:
        await robot.start(runtime)
    return robots


def decider(model):
    """A policy over beliefs that is quick to make: the value of an action, and then of knowing the state."""
    rewards = np.asarray(model.rewards)
    vectors = [
        rewards[:, action] + 0.9 * np.asarray(model.transition_matrix(action)) @ rewards.max(axis=1)
        for action in range(len(model.action_space))
    ]
    return AlphaVectors(np.array(vectors), list(range(len(vectors))))


def over_beliefs(model, policy=None, **options):
    """How the ensemble of each robot of a model is made."""
    policy = decider(model) if policy is None else policy

    def build(robot, agent, **more):
        names = model.action_space.factors[agent].names
        return mdm.Ensemble(
            "joint",
            policy=policy,
            model=model,
            actions={name: robot.act(name) for name in names},
            agent=agent,
            **(options | more),
        )

    return build


def rooms():
    """Two robots, each in the hall or in the lab."""
    states = Space([Factor("room_a", ["hall", "lab"]), Factor("room_b", ["hall", "lab"])])
    actions = Space([Factor("a", ["stay", "go"]), Factor("b", ["stay", "go"])])
    return MDP([np.full((4, 4), 0.25)] * 4, np.zeros((4, 4)), discount=0.9, states=states, actions=actions)


def over_states(robot, agent, **options):
    """The ensemble of a robot of `rooms`: each robot in the lab goes."""
    manager = mdm.PredicateManager()
    robot.lab = manager.sensor("InLab")
    manager.sensor("OtherInLab")
    own, other = ("room_a", "room_b") if agent == 0 else ("room_b", "room_a")
    owners = {"room_a": "a", "room_b": "b"}
    return mdm.Ensemble(
        "joint",
        policy=DeterministicPolicy([0, 1, 2, 3]),
        model=rooms(),
        predicates=manager,
        states=[
            mdm.StateFactor(own, {"lab": "InLab"}, owner=owners[own]),
            mdm.StateFactor(other, {"lab": "OtherInLab"}, owner=owners[other]),
        ],
        actions={name: robot.act(name) for name in ("stay", "go")},
        agent=agent,
        **options,
    )


def history(robot, *, since=0):
    """What the steps were, without when they were applied."""
    return [
        (c.term, c.step, c.input, c.missing, c.command, c.action, c.digest) for c in robot.commits if c.step > since
    ]


def tigers(**options):
    return Team("tigers", ["left", "right"], **options)


async def two(runtime, build=None, **options):
    """Return the two robots of such a team, running; without ``build`` they listen for tigers."""
    network = Network(runtime.clock, team="tigers")
    return await started(runtime, tigers(**options), network, build or over_beliefs(problems.dec_tiger()))


@functools.cache
def three():
    """Three fire fighters, who hear flames where they are: one model for all, which nobody changes."""
    return problems.fire_fighting(2, 3, 2)
