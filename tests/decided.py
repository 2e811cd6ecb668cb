"""Ensembles under a script, and what they decide."""

from __future__ import annotations

import asyncio

from mdm import Ensemble
from mdm.policies import AlphaVectors
from mdm.problems import tiger
from mdm.testing import capture_decisions, probe, run_virtual


def nothing():
    pass


# open a door when surer than 0.9, else listen
VECTORS = AlphaVectors([[0.0, 0.0], [-90.0, 10.0], [10.0, -90.0]], [0, 1, 2])


def ensemble(**options):
    options = {"policy": VECTORS, "model": tiger(), "actions": dict.fromkeys(range(3), nothing)} | options
    return Ensemble("robot", **options)


def decided(steps, **options):
    """Return the decisions of an ensemble under a script of steps (each an action on the ensemble, or seconds)."""

    async def main(runtime):
        robot = ensemble(**options)
        faults = probe(runtime.faults)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for step in steps:
                if isinstance(step, int | float):
                    await asyncio.sleep(step)
                else:
                    step(robot)
        return decisions, [(fault.kind, fault.source) for fault in faults], robot

    return run_virtual(main)


def see(index):
    return lambda robot: robot.publish_observation(index)


def be(index):
    return lambda robot: robot.publish_state(index)
