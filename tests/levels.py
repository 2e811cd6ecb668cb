"""Ensembles that are below others, and those above them."""

from __future__ import annotations

import asyncio

from mdm import Ensemble
from mdm.policies import DeterministicPolicy


async def forever():
    await asyncio.sleep(1e6)


def leaf(name, **options):
    options = {"policy": DeterministicPolicy([0, 1]), "actions": {"Work": forever, "Rest": lambda: None}} | options
    return Ensemble(name, **options)


def above(name, *children, **options):
    """An ensemble whose action i runs child i, and whose last action does nothing."""
    actions = {child.name: child for child in children} | {"Idle": lambda: None}
    policy = DeterministicPolicy(list(range(len(actions))))
    return Ensemble(name, **{"policy": policy, "actions": actions} | options)
