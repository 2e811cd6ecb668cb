"""Simulation: the mean discounted return of a policy in its model, through the real decision loop in virtual time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.actors import Ensemble
from mdm.errors import ConfigError
from mdm.runtime import Runtime, run
from mdm.simulation.world import World

if TYPE_CHECKING:
    from mdm.actors import Drive
    from mdm.actors.control_layer import OnImpossible
    from mdm.models import MDP, POMDP
    from mdm.policies import Controller, Policy

__all__ = ["SimulationResult", "simulate", "steps_for"]

REST = 1e-4


class SimulationResult(msgspec.Struct, frozen=True):
    """What a simulation found.

    Attributes:
        episodes: How many were run.
        steps: Decisions in each.
        mean: The mean of the episodes' discounted returns.
        standard_error: Of the mean; 0 where there was one episode.
        returns: Each episode's return.
    """

    episodes: int
    steps: int
    mean: float
    standard_error: float
    returns: tuple[float, ...]


def steps_for(discount: float) -> int:
    """Return after how many decisions the rest of an episode weighs less than 1e-4 of the whole.

    Raises:
        ConfigError: If the discount is 1: the rest never weighs less.
    """
    if discount >= 1:
        raise ConfigError("with a discount of 1 an episode needs an end: give a horizon or the number of steps")
    return max(1, math.ceil(math.log(REST) / math.log(discount)))


def simulate(
    model: MDP | POMDP,
    policy: Policy | Controller,
    *,
    episodes: int,
    seed: int | None = None,
    steps: int | None = None,
    drive: Drive | None = None,
    on_impossible: OnImpossible = "predict",
    on_no_observation: str = "predict",
) -> SimulationResult:
    """Run episodes of a policy in its model and return what they were worth.

    It runs an ensemble against a `World` in a program of its own, so call it from outside asyncio.

    Args:
        model: The world, and what beliefs are tracked by; after its false negatives the action goes on.
        policy: What decides.
        episodes: How many to run.
        seed: The same seed gives the same result.
        steps: Decisions in each episode; by default, and at most, as many as the policy's plan has, or where it has no
            end, as leave out less than 1e-4 of the discounted weight.
        drive: When to decide; on events by default.
        on_impossible: See `ControlLayer`.
        on_no_observation: See `ControlLayer`.

    Raises:
        ConfigError: If sizes do not fit, or episodes have no end.
    """
    if episodes < 1:
        raise ConfigError(f"a simulation needs at least 1 episode, not {episodes}")
    planned: int | None = getattr(policy, "horizon", None)
    if planned is not None:
        count = planned if steps is None else min(steps, planned)
    else:
        count = steps_for(model.discount) if steps is None else steps
    returns: list[float] = []

    async def main() -> None:
        async with Runtime(log=None) as runtime:

            def finished(value: float) -> None:
                returns.append(value)
                if len(returns) == episodes:
                    runtime.shut_down()
                    ensemble.stop()

            ensemble = Ensemble(
                "ensemble",
                policy=policy,
                model=model,
                actions=dict.fromkeys(range(len(model.action_space.factors[0])), _nothing),
                drive=drive,
                horizon=count,
                on_impossible=on_impossible,
                on_no_observation=on_no_observation,
            )
            await runtime.start(World(ensemble, seed=seed, period=0.0, finished=finished))
            await runtime.start(ensemble)
            await runtime.wait()

    run(main, virtual=True)
    values = np.array(returns[:episodes])
    error = float(values.std(ddof=1) / math.sqrt(episodes)) if episodes > 1 else 0.0
    return SimulationResult(episodes, count, float(values.mean()), error, tuple(values.tolist()))


def _nothing() -> None:
    """What an action does in a world that knows of it by its message."""
