"""What a policy is worth in its model, by simulation of thousands of episodes at once, without the decision loop.

The estimate is the mean discounted return of independent episodes (the Monte Carlo method); its error falls with the
square root of their number. Policies of known kinds run in step, as arrays, at millions of steps a second for small
models: states are drawn for all episodes at once, and beliefs are a matrix with a row for each. Policies of other
kinds, and beliefs over more than 2,000 states, go one episode after the other. For the loop as a robot runs it, ten
to a hundred times slower, take `simulate`.

Random numbers belong to an episode and a step of time, not to a policy: with the same seed two policies meet the same
luck, and their difference is far better known than either (common random numbers).
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ConfigError
from mdm.loading import model_of, policy_of
from mdm.models import POMDP
from mdm.models.matrices import Vector
from mdm.policies import mismatch
from mdm.simulation.episodes import EpisodeBatch, limits, one_by_one

if TYPE_CHECKING:
    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models import MDP

__all__ = ["Evaluation", "evaluate"]

_TOGETHER = 2_000
"""States up to which beliefs are kept as a matrix."""
_CHUNK = 10_000
_NUMBERS = 4_000_000
_NORMAL = 1.959963985
"""Standard deviations within which 95 % of a normal distribution lie."""


class Evaluation(msgspec.Struct, frozen=True):
    """What simulated episodes of a policy were worth.

    Attributes:
        mean: The mean of their discounted returns.
        standard_error: Of the mean; 0 where there was one episode.
        returns: Each episode's return.
        steps: How long an episode may be: decisions where their number was given, else steps of time.
        seed: With it the same episodes come again.
        moves: Steps of time that were simulated, in all.
        seconds: What that took.
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
        """Return what the episodes' returns come to."""
        error = float(returns.std(ddof=1)) / math.sqrt(len(returns)) if len(returns) > 1 else 0.0
        return cls(float(returns.mean()), error, returns, steps, seed, moves, seconds)

    @property
    def episodes(self) -> int:
        """How many episodes were run."""
        return len(self.returns)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of what the policy is worth."""
        return self.mean - _NORMAL * self.standard_error, self.mean + _NORMAL * self.standard_error

    def __repr__(self) -> str:
        low, high = self.interval
        return f"Evaluation({self.mean:.6g}, between {low:.6g} and {high:.6g} by 95 %, {self.episodes} episodes)"

    @property
    def steps_a_second(self) -> float:
        """How fast it went."""
        return self.moves / self.seconds if self.seconds > 0 else math.inf


def evaluate(
    model: GivenModel,
    policy: GivenPolicy,
    *,
    episodes: int | None = None,
    steps: int | None = None,
    seed: int | None = None,
) -> Evaluation:
    """Estimate what a policy is worth at the start of its model.

    An episode ends after ``steps`` decisions; by default where what remains weighs less than a millionth or the plan
    of a controller has its end. It ends early where nothing more can be earned. The model's false
    negatives, and events without an observation, lead to no decision: the action goes on, each step of time with its
    reward. A policy over states decides at every step.

    Args:
        model: The model, or the path of its file; beliefs are tracked by it, too.
        policy: A policy of any kind, see `Controller`; a controller begins in its best node where it knows its values.
        episodes: How many; by default 10,000, or 1,000 where they go one by one.
        steps: Decisions in each.
        seed: The same seed gives the same result; without one it is drawn.

    Raises:
        ConfigError: If the policy does not go with the model, or episodes have no end.
    """
    model = model_of(model)
    policy = policy_of(policy, model)
    _check(model, policy, episodes, steps)
    ends = limits(model, policy, steps)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    takes = getattr(policy, "input", "belief")
    small = takes != "belief" or len(model.state_space) <= _TOGETHER
    batch = policy.batch(model) if small and hasattr(policy, "batch") else None
    began = time.perf_counter()
    if batch is None:
        count = 1_000 if episodes is None else episodes
        returns, moves = one_by_one(model, policy, ends, episodes=count, seed=seed)
    else:
        run = EpisodeBatch(model, batch, ends, observed=takes != "state")
        chunk = min(_CHUNK, max(_TOGETHER, _NUMBERS // len(model.state_space)))
        returns, moves = _in_chunks(run, 10_000 if episodes is None else episodes, chunk, seed)
    seconds = time.perf_counter() - began
    return Evaluation.of(returns, int(min(ends)), seed, moves, seconds)


def _check(model: MDP, policy: Any, episodes: int | None, steps: int | None) -> None:
    if episodes is not None and episodes < 1:
        raise ConfigError(f"an evaluation needs at least 1 episode, not {episodes}")
    if steps is not None and steps < 1:
        raise ConfigError(f"an episode needs at least 1 step, not {steps}")
    if getattr(policy, "input", "state") != "state" and not isinstance(model, POMDP):
        raise ConfigError("the policy goes by what is observed, but the model is an MDP, which has no observations")
    wrong = mismatch(policy, model)
    if wrong is not None:
        raise ConfigError(wrong)


def _in_chunks(run: EpisodeBatch, episodes: int, chunk: int, seed: int) -> tuple[Vector, int]:
    """Run episodes in parts that the memory holds, each with numbers of its own."""
    sizes = [min(chunk, episodes - first) for first in range(0, episodes, chunk)]
    streams = np.random.SeedSequence(seed).spawn(len(sizes))
    parts = [run(size, np.random.default_rng(stream)) for size, stream in zip(sizes, streams, strict=True)]
    returns = np.concatenate([part for part, _ in parts])
    returns.setflags(write=False)
    return returns, sum(moves for _, moves in parts)
