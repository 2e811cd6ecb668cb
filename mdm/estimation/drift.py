"""Drift: a bet against each row of the model, whose winnings are the evidence that it is wrong.

Who bets against a model that is right wins on the average nothing, whenever he looks: his capital is a martingale that
begins at 1, and reaches m with a probability of at most 1/m in all time (J. Ville, 1939; G. Shafer, *Testing by
betting*, Journal of the Royal Statistical Society A 184, 2021). So one may look after each transition, which a test for
a fixed number of them does not allow: at 5 % the G-test, looked at 3,000 times, gave a false alarm in half of the runs.

The bet follows the counts: of states that are known it is a mixture of all rows, Dirichlet(1/2) on the entries that the
model has; of observations the model's own prediction under the belief, each in the proportion in which it came more
often than predicted. A row that has drifted after a long time would hardly change its counts, so that a new bet begins
each 200 visits; the i-th has the share 1 / i (i + 1) of the capital, and the first and the last four go on.

An estimated model is a posterior: it predicts the mean over that, given all that has followed since. Rows count as n +
1 visits with Jeffreys' prior, shares of observations as so many predictions. Held against its mean alone, a row that
rests on a few visits is wrong in the end: of 200 robots with models estimated from 50 decisions 178 heard of it at odds
of 20, and 6 do now.

The alarm of a row is at the given odds times the number of rows that may be wrong: of robots whose model is right, one
in so many ever hears of any row. A decision costs a few microseconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.checks import is_number
from mdm.errors import ModelError
from mdm.estimation.chains import is_next, kind_of
from mdm.estimation.reestimation import WEIGHT
from mdm.estimation.rows import PRIOR, support, without_staying
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import num_entries

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.estimation.chains import Kind
    from mdm.messages import Decision
    from mdm.models.mdp import MDP
    from mdm.models.pomdp import POMDP

ODDS = 1000.0
"""The odds at which drift is told, by default."""
_FRESH = 200
_KEPT = 5


class Alarm(msgspec.Struct, frozen=True):
    """A row of the model is wrong, at the odds that were asked for.

    Attributes:
        action: The action.
        state: The state before it; None of observations, whose states are hidden.
        visits: How often something followed.
        odds: The odds against the row, of 1; infinite where something impossible followed.
        symbol: The state or observation of which most was lost or won: it came too often, or too seldom.
        share: How often it came, of 1.
        model: How often the model expected it.
    """

    action: int
    state: int | None
    visits: int
    odds: float
    symbol: int
    share: float
    model: float


class _Bet:
    """A bet that began at some visit; its winnings are kept as a logarithm."""

    __slots__ = ("counts", "expected", "weight", "won")

    def __init__(self, size: int, weight: float) -> None:
        self.weight = weight
        self.counts = [0.0] * size
        self.expected = [0.0] * size
        self.won = 0.0

    def take(self, place: int, model: Sequence[float], predicted: float, *, fixed: bool) -> None:
        counts = self.counts
        if fixed:  # the row is the same at each visit
            chance = (counts[place] + PRIOR) / (sum(counts) + PRIOR * len(counts))
        else:
            expected = self.expected
            shares = [p * (n + 1) / (e + 1) for p, n, e in zip(model, counts, expected, strict=True)]
            chance = shares[place] / math.fsum(shares)
            self.expected = [e + p for e, p in zip(expected, model, strict=True)]
        self.won += math.log(chance / predicted)
        counts[place] += 1


class Capital:
    """The capital of who bets against one row: begins at 1, and has the expectation 1 if the model is right.

    Args:
        size: The number of entries of the row.
        fixed: Whether the model's probabilities are the same at each visit.
        weight: How many visits they rest on; infinite where they were not estimated.

    Example:
        >>> capital = Capital(2)
        >>> for _ in range(20):
        ...     odds = capital.take(0, [0.5, 0.5])
        >>> round(odds)
        68142
    """

    __slots__ = ("_began", "_bets", "_fixed", "_size", "_weight", "counts", "expected", "visits")

    def __init__(self, size: int, *, fixed: bool = True, weight: float = math.inf) -> None:
        self._size = size
        self._weight = weight
        self._fixed = fixed
        self._bets: list[_Bet] = []
        self._began = 0
        self.visits = 0
        self.counts = [0] * size
        """How often each entry followed."""
        self.expected = [0.0] * size
        """How often the model expected each."""

    def take(self, place: int, model: Sequence[float]) -> float:
        """Bet on the next entry, given the probabilities by the model, none of which is 0; return the capital."""
        if self.visits % _FRESH == 0:
            self._began += 1
            self._bets.append(_Bet(self._size, 1 / (self._began * (self._began + 1))))
            if len(self._bets) > _KEPT:
                del self._bets[1]
        predicted = model[place] if self._weight == math.inf else self._predicted(place, model)
        self.visits += 1
        self.counts[place] += 1
        for entry, probability in enumerate(model):
            self.expected[entry] += probability
        for bet in self._bets:
            bet.take(place, model, predicted, fixed=self._fixed)
        return self.value

    def _predicted(self, place: int, model: Sequence[float]) -> float:
        """Return the probability of an entry by the posterior of the estimate, and the entries since."""
        if self._fixed:
            known = self._weight * model[place] + PRIOR + self.counts[place]
            return known / (self._weight + PRIOR * self._size + self.visits)
        shares = []
        for p, count, expected in zip(model, self.counts, self.expected, strict=True):
            prior = 1 + self._weight * (expected + p) / (self.visits + 1)
            shares.append(p * (count + prior) / (expected + prior))
        return shares[place] / math.fsum(shares)

    @property
    def value(self) -> float:
        """The capital; infinite where it is too large for a number."""
        rest = 1 / (self._began + 1)  # of the bets that have not begun
        return rest + math.fsum(bet.weight * (math.exp(bet.won) if bet.won < 700 else math.inf) for bet in self._bets)


class DriftTest:
    """Tests the rows of a model against the decisions of one ensemble, as they come.

    A row is told once. It knows no time and no channel: decisions in, alarms out.

    Args:
        model: The model in use.
        odds: Of so many runs with a model that is right, one has an alarm at most.
        kind: See `mdm.estimation.chains.Kind`; by default as its decisions tell.
        period: The nanoseconds between ticks of a fixed rate, across missed ones of which nothing is counted.

    Raises:
        ModelError: If the odds are not more than 1, or the model's steps are not known (`POMDP.waits`).

    Example::

        test = DriftTest(model, odds=1000)
        for decision in decisions:
            alarm = test.take(decision)
            if alarm is not None:
                ...
    """

    def __init__(self, model: MDP, *, odds: float = ODDS, kind: Kind | None = None, period: int | None = None) -> None:
        if not (is_number(odds) and 1 < odds < math.inf):
            raise ModelError(f"the odds of an alarm are more than 1, as 1000, not {odds!r}")
        self._model = model.flatten()
        self._visits = model.visits
        self._kind = kind
        self._period = period
        self._odds = float(odds)
        self._previous: Decision | None = None
        self._rows: dict[tuple[int, int | None], Capital] = {}
        self._supports: dict[tuple[int, int], tuple[list[int], list[float]]] = {}
        self._told: set[tuple[int, int | None, int | None]] = set()
        self._dynamics: Dynamics | None = None
        self._limit = math.nan

    def reset(self) -> None:
        """Forget all that was counted and told."""
        self._previous = None
        self._rows.clear()
        self._told.clear()

    def odds(self, action: int, state: int | None = None) -> float:
        """Return the odds against a row so far, or against an action's observations; 1 where it was not visited."""
        row = self._rows.get((action, state))
        return 1.0 if row is None else row.value

    def take(self, decision: Decision) -> Alarm | None:
        """Take the next decision; return an alarm where a row turns out to be wrong."""
        previous, self._previous = self._previous, decision
        if previous is None or not is_next(previous, decision, self._period):
            return None
        if decision.cause == "again":  # the action belongs to the step before
            self._previous = msgspec.structs.replace(previous, action=decision.action, epoch=decision.epoch)
            return None
        if decision.state is not None and previous.state is not None:
            return self._move(previous, decision)
        if isinstance(decision.observation, int) and previous.belief is not None:
            return self._observe(previous, decision.observation)
        return None

    # -- States --------------------------------------------------------------------------------------------------

    def _move(self, previous: Decision, decision: Decision) -> Alarm | None:
        state, action, following = previous.state, previous.action, decision.state
        assert state is not None
        assert following is not None
        jumps = (self._kind or kind_of(decision)) == "jumps"
        if jumps and state == following:
            return None
        if math.isnan(self._limit):
            self._limit = self._odds * max(self._uncertain(), 1)
        symbols, model = self._support(action, state, jumps=jumps)
        if following not in symbols:
            return self._impossible(action, state, following)
        if len(symbols) < 2:
            return None
        row = self._rows.get((action, state))
        if row is None:
            row = self._rows[action, state] = Capital(len(symbols), weight=self._weight(action, state, jumps=jumps))
        return self._judge(row, row.take(symbols.index(following), model), action, state, symbols)

    def _support(self, action: int, state: int, *, jumps: bool) -> tuple[list[int], list[float]]:
        found = self._supports.get((action, state))
        if found is None:
            symbols, model = support(self._model.transition_matrix(action), state)
            if jumps:
                symbols, model = without_staying(state, symbols, model)
            found = self._supports[action, state] = symbols.tolist(), model.tolist()
        return found

    def _weight(self, action: int, state: int | None = None, *, jumps: bool = False) -> float:
        """Return how many visits a row rests on, or an action's observations; infinite where none was estimated."""
        if self._visits is None:
            return math.inf
        visits = float(self._visits[:, action].sum() if state is None else self._visits[state, action])
        return WEIGHT + visits * (1 - float(self._model.transition_matrix(action)[state, state]) if jumps else 1)

    def _uncertain(self) -> int:
        """Return how many rows of T have more than one entry, at most."""
        actions, states = range(len(self._model.action_space)), len(self._model.state_space)
        return sum(min(states, num_entries(self._model.transition_matrix(action)) - states) for action in actions)

    # -- Observations --------------------------------------------------------------------------------------------

    def _observe(self, previous: Decision, observation: int) -> Alarm | None:
        if self._dynamics is None:
            pomdp: POMDP | None = self._model.pomdp
            if pomdp is None:
                raise ModelError("the decisions are on observations, but the model is an MDP, which has none")
            if pomdp.waits and self._period is None:
                raise ModelError("steps without a detection are not known, so that drift is not either")
            self._dynamics = Dynamics(pomdp)
            self._limit = self._odds * len(pomdp.action_space)
        assert previous.belief is not None
        action = previous.action
        predicted = self._dynamics.step(action, previous.belief[None]).sum(axis=2)[0]
        if predicted[observation] <= 0:
            return None  # which is a fault of its own
        model = (np.maximum(predicted, 0) / predicted.sum()).tolist()
        row = self._rows.get((action, None))
        if row is None:
            row = self._rows[action, None] = Capital(len(model), fixed=False, weight=self._weight(action))
        return self._judge(row, row.take(observation, model), action, None, range(len(model)))

    # -- Alarms --------------------------------------------------------------------------------------------------

    def _judge(self, row: Capital, odds: float, action: int, state: int | None, symbols: Sequence[int]) -> Alarm | None:
        if odds < self._limit or (action, state, None) in self._told:
            return None
        self._told.add((action, state, None))
        gaps = [abs(count - expected) for count, expected in zip(row.counts, row.expected, strict=True)]
        most = gaps.index(max(gaps))
        share, model = row.counts[most] / row.visits, row.expected[most] / row.visits
        return Alarm(action, state, row.visits, odds, symbols[most], share, model)

    def _impossible(self, action: int, state: int, following: int) -> Alarm | None:
        key = (action, state, following)
        if key in self._told:
            return None
        self._told.add(key)
        row = self._rows.get((action, state))
        visits = 1 if row is None else row.visits + 1
        return Alarm(action, state, visits, math.inf, following, 1 / visits, 0.0)
