"""Simulation: the mean discounted return of a policy in its model, through the real decision loop in virtual time."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Unpack

import numpy as np

from mdm.actors import Ensemble
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.runtime import Runtime, run
from mdm.simulation.batch import Evaluation
from mdm.simulation.world import World

if TYPE_CHECKING:
    from mdm.actors import ControlOptions
    from mdm.loading import GivenModel, GivenPolicy

__all__ = ["simulate", "steps_for"]

REST = 1e-4


def steps_for(discount: float) -> int:
    """Return after how many decisions the rest of an episode weighs less than 1e-4 of the whole.

    Raises:
        ConfigError: If the discount is 1: the rest never weighs less.
    """
    if discount >= 1:
        raise ConfigError("with a discount of 1 an episode needs an end: give a horizon or the number of steps")
    return max(1, math.ceil(math.log(REST) / math.log(discount)))


def simulate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int,
    steps: int | None = None,
    **options: Unpack[ControlOptions],
) -> Evaluation:
    """Run episodes of a policy in its model, through the real decision loop, and return what they were worth.

    It runs an ensemble against a `World` in a program of its own, so call it from outside asyncio.

    Args:
        model: The world, and what beliefs are tracked by; or the path of its file.
        policy: What decides; see `Controller`.
        episodes: How many to run.
        steps: Decisions in each episode; by default, and at most, as many as the policy's plan has, or where it has no
            end, as leave out less than 1e-4 of the discounted weight.
        options: Of the control layer, see `ControlOptions`; its ``seed`` is that of the world, too: the same seed gives
            the same result, and without one it is drawn.

    Raises:
        ConfigError: If sizes do not fit, or episodes have no end.
    """
    if episodes < 1:
        raise ConfigError(f"a simulation needs at least 1 episode, not {episodes}")
    world_model = model_of(model)
    decides = policy_of(policy, world_model)
    given = options.pop("seed", None)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if given is None else given
    if given is not None and hasattr(decides, "seed"):
        options["seed"] = given
    planned: int | None = getattr(decides, "horizon", None)
    if planned is not None:
        count = planned if steps is None else min(steps, planned)
    else:
        count = steps_for(world_model.discount) if steps is None else steps
    options["horizon"] = count
    returns: list[float] = []
    moves = 0
    began = time.perf_counter()

    async def main() -> None:
        async with Runtime(log=None) as runtime:
            ensemble = Ensemble(
                "ensemble",
                policy=decides,
                model=world_model,
                actions=dict.fromkeys(range(len(world_model.action_space.factors[0])), _nothing),
                **options,
            )

            def finished(value: float) -> None:
                nonlocal moves
                returns.append(value)
                moves += world.moves
                if len(returns) == episodes:
                    runtime.shut_down()
                    ensemble.stop()

            world = World(ensemble, seed=seed, period=0.0, finished=finished)
            await runtime.start(world)
            await runtime.start(ensemble)
            await runtime.wait()

    run(main, virtual=True)
    values = np.array(returns[:episodes])
    values.setflags(write=False)
    return Evaluation.of(values, count, seed, moves, time.perf_counter() - began)


def _nothing() -> None:
    """What an action does in a world that knows of it by its message."""
