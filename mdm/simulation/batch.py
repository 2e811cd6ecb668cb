"""The value of a policy in its model, by Monte Carlo simulation of batches of episodes, without the decision loop.

The estimate is the mean discounted return of independent episodes; its error falls with the square root of their
number. Policies of known kinds run as arrays, at millions of steps a second for small models: the states of a batch
are sampled together, and its beliefs are a matrix. Other policies, and beliefs over more than 2,000 states, run one
episode at a time. `simulate` runs the real decision loop, ten to a hundred times slower.

Random numbers belong to an episode and a time step, not to a policy. With the same seed, the difference of two policies
that run in batches is known far better than either value (common random numbers), and so is that of two which run one
episode at a time; a policy of each kind have different ones.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.checks import check_seed, is_whole
from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.models.durations import discounts_in_time, paid_in_time
from mdm.models.matrices import Vector
from mdm.models.units import check_steps
from mdm.policies import mismatch
from mdm.simulation.episodes import EpisodeBatch, limits, one_by_one
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP, Durations

__all__ = ["Evaluation", "evaluate"]

_TOGETHER = 2_000
"""States up to which beliefs are kept as a matrix."""
_CHUNK = 10_000
_FIRST = 1_000
"""Episodes of the first part, which is known before the others."""
_NUMBERS = 4_000_000
_NORMAL = 1.959963985
"""Standard deviations within which 95 % of a normal distribution lie."""


class Evaluation(msgspec.Struct, frozen=True):
    """The result of simulated episodes of a policy.

    Attributes:
        mean: The mean of the discounted returns; not a number where no episode has ended.
        standard_error: The standard error of the mean; 0 for a single episode.
        returns: The return of each episode.
        steps: The longest episode: in decisions if their number was given, else in time steps.
        seed: The seed, for the same episodes again.
        moves: The number of simulated time steps.
        seconds: The time of the simulation.
    """

    mean: float
    standard_error: float
    returns: Vector
    steps: int
    seed: int
    moves: int
    seconds: float

    @classmethod
    def of(cls, returns: Vector, steps: int, seed: int, moves: int, seconds: float) -> Evaluation:
        """Return the result of some returns; of none, it is not a number."""
        if not len(returns):
            return cls(math.nan, math.nan, returns, steps, seed, moves, seconds)
        error = float(returns.std(ddof=1)) / math.sqrt(len(returns)) if len(returns) > 1 else 0.0
        return cls(float(returns.mean()), error, returns, steps, seed, moves, seconds)

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return len(self.returns)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the policy's value."""
        return self.mean - _NORMAL * self.standard_error, self.mean + _NORMAL * self.standard_error

    def __repr__(self) -> str:
        low, high = self.interval
        episodes = counted(self.episodes, "episode")
        return f"Evaluation({self.mean:.6g}, between {low:.6g} and {high:.6g} by 95 %, {episodes})"

    @property
    def steps_a_second(self) -> float:
        """Time steps per second."""
        return self.moves / self.seconds if self.seconds > 0 else math.inf


def evaluate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int | None = None,
    steps: int | None = None,
    seed: int | None = None,
    durations: Durations | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Evaluation:
    """Estimate the value of a policy at the start of its model.

    An episode ends after ``steps`` decisions; by default at the end of the policy's plan, or once the discounted weight
    of the rest is below a millionth. It ends early in states without further rewards. False negatives, and events
    without an observation, lead to no decision: the action goes on, each time step with its reward. A policy over
    states decides at every time step.

    Args:
        model: The model of the world and of belief tracking, or the path of its file.
        policy: A policy of any kind, see `Controller`. A plan with values begins at its best node.
        episodes: The number of episodes; by default 10,000, or 1,000 if they run one at a time.
        steps: Decisions per episode.
        seed: The same seed gives the same result; by default it is random.
        durations: How long actions take, and what they earn by time. Times are not drawn: what comes after an action
            counts by the expectation of the discount. By default all take one time step.
        progress: Called at each time step with how many episodes have ended, and of how many; where it returns True,
            the result is of those that are known by then, which may be none.

    Raises:
        ConfigError: If the policy does not fit the model, or episodes have no end.
        ModelError: If the durations do not fit the model, or its discount is of a second and there are none.

    Example::

        result = mdm.evaluate("tiger.pomdp", "tiger.vf", episodes=2000, seed=1)
        result.episodes  # 2000
        result.mean, result.interval  # the value, and its 95 % confidence interval
    """
    model = model_of(model)
    policy = policy_of(policy, model)
    _check(model, policy, episodes, steps)
    check_seed(seed)
    discounts = None
    if durations is None:
        check_steps(model)
    else:
        discounts = discounts_in_time(model, durations)
        model = paid_in_time(model, durations)
    ends = limits(model, policy, steps, None if discounts is None else float(discounts.max()))
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    takes = getattr(policy, "input", "belief")
    small = takes != "belief" or len(model.state_space) <= _TOGETHER
    batch = policy.batch(model) if small and hasattr(policy, "batch") else None
    began = time.perf_counter()
    if batch is None:
        count = 1_000 if episodes is None else episodes
        returns, moves = one_by_one(
            model, policy, ends, episodes=count, seed=seed, discounts=discounts, progress=progress
        )
    else:
        run = EpisodeBatch(model, batch, ends, observed=takes != "state", discounts=discounts)
        chunk = min(_CHUNK, max(_TOGETHER, _NUMBERS // len(model.state_space)))
        returns, moves = _in_chunks(run, 10_000 if episodes is None else episodes, chunk, seed, progress)
    seconds = time.perf_counter() - began
    return Evaluation.of(returns, int(min(ends)), seed, moves, seconds)


def _check(model: MDP, policy: Any, episodes: int | None, steps: int | None) -> None:
    if episodes is not None and not (is_whole(episodes) and episodes >= 1):
        raise ConfigError(f"an evaluation needs at least 1 episode, not {episodes}")
    if steps is not None and not (is_whole(steps) and steps >= 1):
        raise ConfigError(f"an episode needs at least 1 step, not {steps}")
    if getattr(policy, "input", "state") != "state" and model.pomdp is None:
        raise ConfigError("the policy needs observations, but the model is an MDP, which has none")
    wrong = mismatch(policy, model)
    if wrong is not None:
        raise ConfigError(wrong)


def _in_chunks(
    run: EpisodeBatch, episodes: int, chunk: int, seed: int, progress: Callable[[int, int], object] | None
) -> tuple[Vector, int]:
    """Run episodes in parts that fit into memory, each with its own random numbers.

    The first parts are smaller, so that something is known soon. They are the same whatever the policy.
    """
    sizes: list[int] = []
    while (left := episodes - sum(sizes)) > 0:
        sizes.append(min(left, chunk, _FIRST * 4 ** len(sizes)))
    streams = np.random.SeedSequence(seed).spawn(len(sizes))
    parts: list[tuple[Vector, int]] = []
    ended = 0

    def ends(more: int) -> bool:
        return progress is not None and progress(ended + more, episodes) is True

    for size, stream in zip(sizes, streams, strict=True):
        part = run(size, np.random.default_rng(stream), ends)
        if part is None:
            break
        parts.append(part)
        ended += size
    returns = np.concatenate([part for part, _ in parts]) if parts else np.empty(0)
    returns.setflags(write=False)
    return returns, sum(moves for _, moves in parts)
