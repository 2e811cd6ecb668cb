"""The mean discounted return of a policy in its model, by the real decision loop in virtual time."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Unpack

import numpy as np

from mdm.actors import Ensemble
from mdm.checks import check_seed, is_whole
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.models.units import check_steps
from mdm.runtime import Runtime, run
from mdm.simulation.batch import Evaluation
from mdm.simulation.world import World

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mdm.actors import ControlOptions
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.recording import Recorder

REST = 1e-4


def steps_for(discount: float) -> int:
    """Return the number of decisions after which the discounted weight of the rest is below 1e-4.

    Raises:
        ConfigError: If the discount is 1.
    """
    if discount >= 1:
        raise ConfigError("with a discount of 1 an episode needs an end: give a horizon or decisions (--steps)")
    return max(1, math.ceil(math.log(REST) / math.log(discount)))


def simulate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int,
    steps: int | None = None,
    progress: Callable[[int, int], object] | None = None,
    record: str | Path | Recorder | None = None,
    **options: Unpack[ControlOptions],
) -> Evaluation:
    """Run episodes of a policy in its model through the real decision loop, and return their value.

    It runs an ensemble and a `World` in an event loop of its own: call it from outside asyncio.

    Args:
        model: The model of the world and of belief tracking, or the path of its file.
        policy: The policy; see `Controller`.
        episodes: The number of episodes.
        steps: Decisions per episode, at most those of the policy's plan. By default as many as the plan has, or until
            the discounted weight of the rest is below 1e-4.
        progress: Called after each episode with how many have ended, and of how many; where it returns True, the
            result is of these.
        record: A file, such as ``simulated.mcap``, to which all is recorded, with the world's true states and a second
            of virtual time from decision to decision; or a `mdm.recording.Recorder` of one.
        options: Options of the control layer, see `ControlOptions`. The ``seed`` is also the world's: the same seed
            gives the same result; by default it is random.

    Raises:
        ConfigError: If sizes do not fit, or episodes have no end.
        ModelError: If the model's discount is of a second: each action takes a step here.

    Example::

        result = mdm.simulate("tiger.pomdp", "tiger.vf", episodes=20, seed=1)
        result.episodes  # 20
        result.interval  # the 95 % confidence interval of the value
    """
    if not (is_whole(episodes) and episodes >= 1):
        raise ConfigError(f"a simulation needs at least 1 episode, not {episodes}")
    given = options.get("seed")
    check_seed(given)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if given is None else given
    model = model_of(model)
    check_steps(model)
    ensemble = simulated(model, policy, steps=steps, **options)
    count = ensemble.controller.horizon or 0
    returns: list[float] = []
    moves = 0
    began = time.perf_counter()

    async def main() -> None:
        async with Runtime(log=None, record=record) as runtime:

            def finished(value: float) -> None:
                nonlocal moves
                returns.append(value)
                moves += world.moves
                enough = progress is not None and progress(len(returns), episodes) is True
                if enough or len(returns) == episodes:
                    runtime.shut_down()
                    ensemble.stop()

            world = World(ensemble, seed=seed, period=0.0 if record is None else 1.0, finished=finished)
            await runtime.start(world)
            await runtime.start(ensemble)
            await runtime.wait()

    run(main, virtual=True)
    values = np.array(returns[:episodes])
    values.setflags(write=False)
    return Evaluation.of(values, count, seed, moves, time.perf_counter() - began)


def simulated(
    model: GivenModel, policy: GivenPolicy, *, steps: int | None = None, **options: Unpack[ControlOptions]
) -> Ensemble:
    """Return the ensemble that a simulation runs, as a replay of its record needs it: see `simulate`."""
    world_model = model_of(model)
    decides = policy_of(policy, world_model)
    if not hasattr(decides, "seed"):
        options.pop("seed", None)  # it is the world's alone
    planned: int | None = getattr(decides, "horizon", None)
    if planned is not None:
        options["horizon"] = planned if steps is None else min(steps, planned)
    else:
        options["horizon"] = steps_for(world_model.discount) if steps is None else steps
    actions = dict.fromkeys(range(len(world_model.action_space.factors[0])), _nothing)
    return Ensemble("ensemble", policy=decides, model=world_model, actions=actions, **options)


def _nothing() -> None:
    """Do nothing: the world takes actions from messages."""
