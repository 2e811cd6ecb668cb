"""Robots of one ensemble, and the lives of their actions."""

from __future__ import annotations

import asyncio

from mdm import Ensemble
from mdm.messages import ActionLife
from mdm.policies import DeterministicPolicy
from mdm.testing import probe


def robot(actions, **options):
    return Ensemble("robot", policy=DeterministicPolicy(list(range(len(actions)))), actions=actions, **options)


def lives_of(runtime, path="robot"):
    return probe(runtime.channel(f"{path}/lives", ActionLife))


def told(lives):
    return [(life.action, life.status) for life in lives]


class Body:
    """An async action that tells when it begins and ends, and counts how many of its kind run at once."""

    running = 0
    most = 0

    def __init__(self, name, log, seconds=3600.0, cleanup=0.0, error=None):
        self.name, self.log, self.seconds, self.cleanup, self.error = name, log, seconds, cleanup, error

    async def __call__(self):
        self.log.append(f"{self.name} begins")
        try:
            await asyncio.sleep(self.seconds)
            if self.error is not None:
                raise self.error
        finally:
            await asyncio.sleep(self.cleanup)
            self.log.append(f"{self.name} ends")
