"""Decisions to estimate from: written by hand, and of simulated robots."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from mdm import Ensemble, Runtime, World, run
from mdm.messages import Decision
from mdm.testing import capture_decisions, run_virtual

SECOND = 1_000_000_000


def nothing():
    pass


def decision(time, epoch, cause, state=None, action=0, **others):
    """Return a decision; its time is in seconds."""
    told = {"observation": None, "belief": None, "action_name": f"a{action}", "reward": None, "ensemble": "robot"}
    told |= others
    return Decision(time=round(time * SECOND), epoch=epoch, cause=cause, state=state, action=action, **told)


def visits(states, *, actions=None, times=None, cause="state", first="start", **others):
    """Return the decisions of one chain of states, a second each by default."""
    actions = [0] * len(states) if actions is None else actions
    times = range(len(states)) if times is None else times
    rows = enumerate(zip(times, states, actions, strict=True))
    return [
        decision(time, epoch, first if epoch == 0 else cause, state, action, **others)
        for epoch, (time, state, action) in rows
    ]


def heard(actions, symbols, **others):
    """Return the decisions of one chain of observations, each after the action before; the first follows from none."""
    pairs = enumerate(zip(actions, [None, *symbols], strict=True))
    return [
        decision(epoch, epoch, "observation" if epoch else "start", None, action, observation=symbol, **others)
        for epoch, (action, symbol) in pairs
    ]


def lived(model, policy, seconds, *, seed=1, world=None, **options):
    """Return what an ensemble decides in a world for some seconds of virtual time."""

    async def main(runtime):
        actions = dict.fromkeys(model.action_space.factors[0].names, nothing)
        robot = Ensemble("robot", policy=policy, model=model, actions=actions, **options)
        with capture_decisions(runtime) as decisions:
            await runtime.start(World(robot, seed=seed, **({"period": 1.0} if world is None else world)))
            await runtime.start(robot)
            await runtime.clock.sleep(seconds)
        return decisions

    return run_virtual(main)


def ran(path, model, *, world=False, seconds=30, **options):
    """Record a robot in virtual time, in a world, or whose state changes each third second; return its decisions."""

    async def main():
        async with Runtime(record=path, log=False) as runtime:
            actions = dict.fromkeys(model.action_space.factors[0].names, nothing)
            robot = Ensemble("robot", **({"policy": [0, 0], "model": model, "actions": actions} | options))
            with capture_decisions(runtime) as decisions:
                if world:
                    await runtime.start(World(robot, seed=1, period=1.0))
                await runtime.start(robot)
                for number in range(0 if world else seconds // 3):
                    robot.publish_state(number % 2)
                    await runtime.clock.sleep(3)
                if world:
                    await runtime.clock.sleep(seconds)
                robot.stop()
                await runtime.clock.sleep(5)
            return decisions

    return run(main, virtual=True)


def wandering(matrix, count, *, seed=0):
    """Return the states of a Markov chain."""
    random = np.random.default_rng(seed)
    levels = np.cumsum(matrix, axis=1).tolist()
    states = [0]
    for number in random.random(count - 1).tolist():
        states.append(bisect_right(levels[states[-1]], number))
    return states
