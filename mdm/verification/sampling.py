"""Whether and when a policy of any kind reaches X, by simulation: for policies over beliefs.

A belief policy's chain has as many states as beliefs; so the number is estimated by independent episodes, with an exact
interval of a binomial share (C. Clopper and E. Pearson, *Biometrika* 26, 1934). An episode ends where X or Y holds, and
where the graph of the model says that X is impossible, or certain; those that have not ended at the longest step count
for both ends of the interval.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import betaincinv

from mdm.simulation.batch import EpisodeRunner
from mdm.simulation.sampler import BatchSampler

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from mdm.models import MDP

    Codes = npt.NDArray[np.int8]
    Indices = npt.NDArray[np.integer]

CONFIDENCE = 0.95
OPEN, HIT, MISS = 0, 1, 2
_TOGETHER = 2_000
"""States up to which beliefs are kept as a matrix."""
_CHUNK = 2_000


class Outcomes(NamedTuple):
    """How episodes ended.

    Args:
        codes: Of each `HIT`, `MISS` or, at the longest step, `OPEN`.
        times: The step of each.
    """

    codes: Codes
    times: Indices

    def share(self) -> tuple[float, float]:
        """Return the interval of the probability of `HIT`."""
        count, tail = len(self.codes), (1 - CONFIDENCE) / 2
        hits = int((self.codes == HIT).sum())
        most = hits + int((self.codes == OPEN).sum())
        low = 0.0 if hits == 0 else float(betaincinv(hits, count - hits + 1, tail))
        high = 1.0 if most == count else float(betaincinv(most + 1, count - most, 1 - tail))
        return low, high

    def steps(self) -> tuple[float, float]:
        """Return the interval of the expected steps until `HIT`, by a normal distribution; infinite where one misses.

        Episodes that have not ended leave no upper end.
        """
        if (self.codes == MISS).any():
            return math.inf, math.inf
        half = 1.959963985 * float(self.times.std()) / math.sqrt(len(self.times))
        mean = float(self.times.mean())
        return mean - half, math.inf if (self.codes == OPEN).any() else mean + half


def outcomes(
    model: MDP,
    policy: Any,
    until: Codes,
    *,
    longest: int,
    episodes: int | None,
    seed: int,
    progress: Callable[[int, int], object] | None = None,
) -> Outcomes:
    """Return how episodes end, by ``until``, S x (A + 1), as `Specification` has X; at last at the longest step.

    Episodes and progress are those of `mdm.evaluate`, but progress is told between batches alone.
    """
    takes = getattr(policy, "input", "belief")
    small = takes != "belief" or len(model.state_space) <= _TOGETHER
    batch = policy.batch(model) if small and hasattr(policy, "batch") else None
    count = episodes or (1_000 if batch is None else 10_000)
    parts: list[Outcomes] = []
    size = _CHUNK if batch is not None else 1
    streams = np.random.SeedSequence(seed).spawn(math.ceil(count / size))
    sampler = None if batch is None else BatchSampler(model, observed=model.pomdp is not None)
    blind = [] if sampler is None or takes == "state" else [sampler.nothing, model.false_negative]
    runner = EpisodeRunner(model, policy, endless=True) if batch is None else None
    for number, stream in enumerate(streams):
        if progress is not None and progress(number * size, count) is True:
            break
        if runner is None:
            its, random = min(size, count - number * size), np.random.default_rng(stream)
            parts.append(_together(sampler, batch, until, longest, its, random, blind))
        else:
            parts.append(_alone(runner, until, longest, stream))
    if not parts:
        return Outcomes(np.empty(0, dtype=np.int8), np.empty(0, dtype=np.int64))
    return Outcomes(*(np.concatenate([part[place] for part in parts]) for place in (0, 1)))


def _alone(runner: EpisodeRunner, until: Codes, longest: int, seed: np.random.SeedSequence) -> Outcomes:
    code, time = OPEN, 0
    for time, step in enumerate(runner(seed)):
        code = until[step.state, step.action]
        if code != OPEN or time >= longest:
            break
    else:
        code = OPEN  # the plan has ended, or nothing is observed any more
    return Outcomes(np.array([code], dtype=np.int8), np.array([time]))


def _together(
    sampler: Any, batch: Any, until: Codes, longest: int, count: int, random: np.random.Generator, blind: list[Any]
) -> Outcomes:
    """Run a batch of episodes, in which observations that are blind lead to no decision."""
    codes, times = np.zeros(count, dtype=np.int8), np.full(count, longest)
    states = sampler.first(random.random(count))
    actions, going = batch.begin(states, random.random(count)), np.arange(count)
    for time in range(longest + 1):
        found = until[states, actions]
        over = found != OPEN
        codes[going[over]], times[going[over]] = found[over], time
        if over.any():
            states, actions, going = states[~over], actions[~over], going[~over]
            batch.keep(~over)
        if not len(going) or time == longest:
            break
        numbers = random.random((3, len(going)))
        states, seen = sampler.move(states, actions, numbers)
        which = np.flatnonzero(~np.isin(seen, [each for each in blind if each is not None]))
        if len(which):
            actions[which] = batch.next(which, states[which], actions[which], seen[which], numbers[2, which])
    return Outcomes(codes, times)
