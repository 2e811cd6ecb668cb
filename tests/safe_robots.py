"""Robots with a safe action, and a log of what they do."""

from __future__ import annotations

import asyncio

import numpy as np

from mdm import Ensemble, PredicateManager, StateFactor, bind
from mdm.models import POMDP
from mdm.policies import DeterministicPolicy


async def forever():
    await asyncio.sleep(1e6)


class Log(list):
    """Calls, in their order."""

    def plain(self, name):
        return lambda: self.append(name)

    def slow(self, name, seconds=1.0):
        async def work():
            self.append(f"{name} begins")
            try:
                await asyncio.sleep(seconds)
            finally:
                self.append(f"{name} ends")

        return work


def certain(actions=1):
    """A model in which, in the state that is certain after a step, observation 1 is impossible."""
    return POMDP(
        [np.array([[0.0, 1.0], [0.0, 1.0]])] * actions,
        [np.array([[1.0, 0.0], [1.0, 0.0]])] * actions,
        np.zeros((2, actions)),
        discount=0.9,
        initial_belief=[0.75, 0.25],
    )


def robot(log, name="robot", **options):
    given = {"policy": DeterministicPolicy([0, 1]), "actions": {"A": log.plain("A"), "B": log.plain("B")}}
    return Ensemble(name, **(given | {"safe_action": log.plain("SAFE")} | options))


def sensed(log, *, max_age=None, supervision="escalate", **options):
    manager = PredicateManager()
    sensor = manager.sensor("S", max_age=max_age)
    factors = [StateFactor("s", ["S"])]
    return robot(log, predicates=manager, states=factors, supervision=supervision, **options), manager, sensor


def two_levels(log, *actions, safe_action, safe_below=None, cleanup=0.0, below=None, **options):
    """An ensemble whose sensor grows old after a second, one below it that works, and that sensor."""
    manager = PredicateManager()
    sensor = manager.sensor("S", max_age=1.0)

    async def work():
        log.append("Work begins")
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(cleanup)
            log.append("Work ends")

    below = below or Ensemble("below", policy=[0], actions={"Work": bind(work, grace=5.0)}, safe_action=safe_below)
    top = Ensemble(
        "top",
        policy=DeterministicPolicy([0, 0], 2),
        actions={action: below if action == "Below" else log.plain(action) for action in actions},
        predicates=manager,
        states=[StateFactor("s", ["S"])],
        safe_action=safe_action,
        **options,
    )
    return top, below, sensor
