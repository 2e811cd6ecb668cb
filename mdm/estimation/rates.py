"""Rates: how often a second one state follows another under an action, and how long it takes.

Of a process that decides when its state changes, no state follows itself: a matrix T with a diagonal is no measure of
its counts. They give a rate: jumps from i to j under an action, by the time spent in i under it. The time of stays that
another action or a command cut short counts; without it, intervals cover 75 to 88 % in place of 95 %.

Whether stays are exponential is asked by Moran's test (P. A. P. Moran, *The random division of an interval, Part II*,
1951; D. R. Cox and P. A. W. Lewis, *The Statistical Analysis of Series of Events*, 1966, section 6.3). Of exponential
stays, and of these alone whatever cuts them short, the times of exposure from one end to the next are exponential, too;
the test is of these. Where the test refuses them because they vary too little, an Erlang distribution of so many stages
as fit best takes their place.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.errors import ModelError
from mdm.estimation.rows import LEVEL, rate_intervals, support, without_staying
from mdm.models.durations import Durations

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mdm.estimation.chains import Kind, Stay
    from mdm.models.matrices import Matrix, Vector
    from mdm.models.mdp import MDP

_FEWEST = 5
"""The number of ends from which on stays are tested."""
_REFUSED = 0.01
"""The p-value below which stays are not taken for exponential."""
MOST_STAGES = 200
"""The stages of a stay that takes, as good as always, the same time."""


class Holding(msgspec.Struct, frozen=True):
    """How long a state lasts under an action, whatever follows.

    Attributes:
        exposure: The seconds spent in the state under the action, those of stays that were cut short too.
        ends: How many stays came to their end.
        mean: The expected seconds; not a number where no stay has ended.
        low: The lower end of the interval of the mean, as far as stays are exponential.
        high: The upper end.
        p_value: Of Moran's test; None where fewer than five stays have ended.
        stages: 1 where stays may be exponential, else the number of stages of the Erlang distribution that fits best.
    """

    exposure: float
    ends: int
    mean: float
    low: float
    high: float
    p_value: float | None
    stages: int = 1

    @property
    def is_exponential(self) -> bool:
        """Whether nothing speaks against stays of an exponential length."""
        return self.p_value is None or self.p_value >= _REFUSED


class Rates(msgspec.Struct, frozen=True):
    """The rates of jumps from a state under an action.

    Attributes:
        action: The action.
        state: The state.
        holding: How long the state lasts.
        symbols: The other states that the model lets follow, k of them.
        counts: How often each has followed, k numbers.
        rates: The rate of each a second, k numbers.
        low: The lower ends of the intervals.
        high: The upper ends of the intervals.
    """

    action: int
    state: int
    holding: Holding
    symbols: npt.NDArray[np.intp]
    counts: npt.NDArray[np.float64]
    rates: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]


def moran(times: Sequence[float] | Vector) -> float:
    """Return the two-sided p-value of Moran's test that times are exponential.

    With n times of mean m the statistic 2 n (log m - mean of log t) / (1 + (n + 1) / 6 n) is about chi-squared with
    n - 1 degrees of freedom: small where they vary too little, large where they vary too much. Times of 0 are left out.
    """
    from scipy.special import gammainc, gammaincc  # noqa: PLC0415 - slow to import

    values = np.asarray(times, dtype=np.float64)
    values = values[values > 0]
    count = len(values)
    if count < 2:
        return 1.0
    spread = 2 * count * (math.log(values.mean()) - float(np.log(values).mean()))
    statistic = spread / (1 + (count + 1) / (6 * count))
    freedom = (count - 1) / 2
    return float(min(1.0, 2 * min(gammainc(freedom, statistic / 2), gammaincc(freedom, statistic / 2))))


def erlang(ended: Vector, cut: Vector) -> tuple[float, int]:
    """Return the mean and the number of stages of the Erlang distribution that fits best.

    Args:
        ended: The lengths of stays that came to their end, none of them 0.
        cut: The lengths so far of those that did not, each of which counts by the probability of being longer.
    """
    best = (-math.inf, float(ended.mean()), 1)
    for stages in range(1, MOST_STAGES + 1):
        likelihood, mean = _best_mean(stages, ended, cut)
        if likelihood < best[0]:
            break
        best = likelihood, mean, stages
    return best[1], best[2]


def _best_mean(stages: int, ended: Vector, cut: Vector) -> tuple[float, float]:
    """Return the largest log likelihood of Erlang stays of so many stages, and the mean that has it."""
    logs, total, count = float(np.log(ended).sum()), float(ended.sum()), len(ended)
    if not len(cut):
        told = count * (stages * (math.log(stages * count / total) - 1) - math.lgamma(stages)) + (stages - 1) * logs
        return told, total / count
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import
    from scipy.special import gammaincc, gammaln  # noqa: PLC0415 - slow to import

    def cost(log_rate: float) -> float:
        rate = math.exp(log_rate)
        told = count * (stages * log_rate - float(gammaln(stages))) + (stages - 1) * logs - rate * total
        with np.errstate(divide="ignore"):
            return -(told + float(np.log(gammaincc(stages, rate * cut)).sum()))

    shortest, longest = math.log(stages * count / (total + float(cut.sum()) * stages)), math.log(stages * count / total)
    found = minimize_scalar(cost, bounds=(shortest - 3, longest + 1e-9), method="bounded", options={"xatol": 1e-9})
    return -float(found.fun), stages / math.exp(float(found.x))


def holding(stays: Iterable[Stay], *, level: float = LEVEL) -> Holding:
    """Return how long a state lasts, from its stays in their order."""
    ended, cut, gaps, gap = [], [], [], 0.0
    for stay in stays:
        gap += stay.seconds
        if stay.ended:
            ended.append(stay.seconds)
            gaps.append(gap)
            gap = 0.0
        else:
            cut.append(stay.seconds)
    exposure, count = math.fsum([*ended, *cut]), len(ended)
    if exposure <= 0:
        return Holding(0.0, count, math.nan, 0.0, math.inf, None)
    interval = rate_intervals([count], exposure, level=level)
    least = float(interval.low[0])
    low, high = 1 / float(interval.high[0]), 1 / least if least > 0 else math.inf
    mean = exposure / count if count else math.nan
    positive = np.array([seconds for seconds in ended if seconds > 0])
    if len(positive) < _FEWEST:
        return Holding(exposure, count, mean, low, high, None)
    p_value = moran(gaps)
    if p_value >= _REFUSED:
        return Holding(exposure, count, mean, low, high, p_value)
    fitted, stages = erlang(positive, np.array([seconds for seconds in cut if seconds > 0]))
    return Holding(exposure, count, mean if stages == 1 else fitted, low, high, p_value, stages)


def _by_row(stays: Iterable[Stay]) -> dict[tuple[int, int], list[Stay]]:
    rows: dict[tuple[int, int], list[Stay]] = defaultdict(list)
    for stay in stays:
        if stay.state is not None:
            rows[stay.action, stay.state].append(stay)
    return rows


def rates_of(model: MDP, stays: Iterable[Stay], *, level: float = LEVEL) -> tuple[Rates, ...]:
    """Return the rates of each state and action in which time was spent, by action and state.

    Args:
        model: Says which states may follow.
        stays: Those of chains of jumps.
        level: The probability of the intervals.
    """
    flat = model.flatten()
    result = []
    for (action, state), row in sorted(_by_row(stays).items()):
        held = holding(row, level=level)
        if held.exposure <= 0:
            continue
        symbols, probability = support(flat.transition_matrix(action), state)
        symbols, _ = without_staying(state, symbols, probability)
        followed = [stay.next_state for stay in row if stay.ended]
        counts = np.array([followed.count(symbol) for symbol in symbols.tolist()], dtype=np.float64)
        result.append(Rates(action, state, held, symbols, counts, *rate_intervals(counts, held.exposure, level=level)))
    return tuple(result)


def durations_of(
    model: MDP, stays: Iterable[Stay], kind: Kind, *, lasting: npt.NDArray[np.float64] | None = None
) -> Durations:
    """Return how long actions take, as `mdm.solve` and ``mdm solve --durations`` take it.

    A model that stays in a state with the probability p takes 1 / (1 - p) steps to leave it, on the average. So of
    jumps, which tell how long the state lasts, a step is the share 1 - p, in a single stage.

    A state in which an action was never seen to end lasts as long as the action does on the average; an action that was
    never seen to end, as long as any. Where states are hidden, each action has one duration for all of them.

    Args:
        model: The model in use, or one estimated from it, whose probabilities of staying are the same.
        stays: Those of chains.
        kind: Of the chains.
        lasting: How long states last, S x A, where an action was never seen to end; 0 where it is not known.

    Raises:
        ModelError: If no stay has ended, or none lasted any time.
    """
    listed = list(stays)
    whole = holding(listed)
    if not (whole.ends and whole.exposure > 0):
        raise ModelError("no action was seen to take time: there are no durations")
    actions = len(model.action_space)
    of_action: dict[int, list[Stay]] = defaultdict(list)
    for stay in listed:
        of_action[stay.action].append(stay)
    means, stages = np.full(actions, whole.mean), np.ones(actions)
    for action, row in of_action.items():
        held = holding(row)
        if _lasts(held):
            means[action], stages[action] = held.mean, held.stages
    if any(stay.state is None for stay in listed):
        return Durations(means, stages)
    table, counts = np.tile(means, (len(model.state_space), 1)), np.ones((len(model.state_space), actions))
    if lasting is not None:
        table = np.where(lasting > 0, lasting, table)
    for (action, state), row in _by_row(listed).items():
        held = holding(row)
        if _lasts(held):
            table[state, action], counts[state, action] = held.mean, held.stages
    if kind == "steps":
        return Durations(table, counts)
    leaves = 1 - staying_of(model)
    leaves[leaves <= 0] = 1  # it never leaves, however long its steps take
    return Durations(table * leaves, np.where(leaves < 1, 1, counts))


def staying_of(model: MDP) -> Vector:
    """Return the probability of staying in each state under each action, S x A."""
    flat = model.flatten()
    matrices = (flat.transition_matrix(action) for action in range(len(flat.action_space)))
    return np.stack([np.array(matrix.diagonal(), dtype=np.float64) for matrix in matrices], axis=1)


def _lasts(held: Holding) -> bool:
    return held.ends > 0 and held.mean > 0


def transitions_after(model: MDP, found: Iterable[Rates], step: float) -> Mapping[int, Matrix]:
    """Return P(s' | s, a) after a step of some seconds, expm(Q * step), for each action of which there are rates.

    Args:
        model: The model.
        found: The rates that were seen; those that were not are the model's to first order, (T - I) / step.
        step: The seconds that a time step of the model stands for.
    """
    from scipy.linalg import expm  # noqa: PLC0415 - slow to import

    flat, size = model.flatten(), len(model.state_space)
    by_action: dict[int, list[Rates]] = defaultdict(list)
    for each in found:
        by_action[each.action].append(each)
    result = {}
    for action, rows in by_action.items():
        matrix = flat.transition_matrix(action)
        dense = np.array(matrix.toarray() if flat.is_sparse else matrix)
        generator = (dense - np.eye(size)) / step
        for row in rows:
            generator[row.state] = 0
            generator[row.state, row.symbols] = row.rates
            generator[row.state, row.state] = -row.rates.sum()
        result[action] = np.asarray(expm(generator * step))
    return result
