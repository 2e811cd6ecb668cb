"""Re-estimation: the model in use, with counts in place of assumptions.

A row of the old model weighs as much as one visit: its estimate is (n_j + p_j) / (n + 1). So rows that were never
visited stay as they are, rows that were visited often are their frequencies, and all that the old model holds possible
stays possible: beliefs meet no observation of probability 0 that they did not meet before.

A factored model gives one number for many states: a fire goes out with the same probability whoever waits elsewhere. So
the counts of the states that were visited are the best guess for those that were not, and a policy that is solved again
does not go where the old model's number was never put to the test. Rows of a factor to which the model gives the same
distribution are pooled (`Pool`), from the same value of the factor. Between changes of the state these are rates, of
which each factor has its own (U. Nodelman, C. R. Shelton and D. Koller, *Continuous time Bayesian networks*,
Uncertainty in Artificial Intelligence, 2002). A row of the old model then weighs as much as the seconds of one of its
time steps: as long as the model needs to leave its states as often as they were left. The new model is a network as
well, with the structure of the old one, a table for each factor over its parents and its own value. Rates become the
probabilities after a step, expm(Q * step), while the other factors are as before it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from copy import copy
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt

from mdm.estimation.rows import support
from mdm.models.factored.model import FactoredMDP, FactoredPOMDP
from mdm.models.factored.two_slice import Node, Table, TwoSliceNetwork
from mdm.models.matrices import Vector, csr, is_compressed, read_only
from mdm.models.mdp import MDP
from mdm.models.pomdp import POMDP

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from mdm.estimation.chains import Kind, Stay
    from mdm.estimation.rows import Row
    from mdm.models.factored.two_slice import Potential
    from mdm.models.matrices import Matrix

WEIGHT = 1.0
"""The visits that a row of the old model weighs as much as."""
_LARGEST = 200_000
"""States times actions up to which rows are made from factors."""

_Key = tuple[int, int, tuple[float, ...]]
"""A factor, its value before, and its distribution by the model."""

Changes = dict[int, list[tuple[int, npt.NDArray[np.intp], Vector]]]
"""Other rows of T, by action: the state, those that follow, and their probabilities."""


def blended(row: Row) -> Vector:
    """Return the probabilities of a row in the new model."""
    result: Vector = (row.counts + WEIGHT * row.model) / (row.counts.sum() + WEIGHT)
    return result


def reestimated(model: MDP, transitions: Iterable[Row], observations: Iterable[Row] = ()) -> MDP:
    """Return a model with the rows that were estimated, and all else of the old one; flat, and of the same kind.

    Rows of jumps, which leave out staying, share the part of the old row that is left for them.

    Args:
        model: The model in use, whose rows weigh as much as one visit.
        transitions: Rows of T.
        observations: Rows of O.
    """
    flat = model.flatten()
    changes: Changes = {}
    for row in transitions:
        matrix = flat.transition_matrix(row.action)
        before = np.array([matrix[row.state, symbol] for symbol in row.symbols.tolist()])
        share = float(before.sum())
        if share > 0:
            new = share * blended(msgspec.structs.replace(row, model=before / share))
            changes.setdefault(row.action, []).append((row.state, row.symbols, new))
    seen = None if flat.pomdp is None or flat.event_observations else _seen(flat.pomdp, observations)
    actions = range(len(flat.action_space))
    matrices = [_with_rows(flat.transition_matrix(action), changes.get(action, [])) for action in actions]
    return replaced(flat, matrices, seen)


def _seen(model: POMDP, rows: Iterable[Row]) -> list[Matrix]:
    changes: Changes = {}
    for row in rows:
        changes.setdefault(row.action, []).append((row.state, row.symbols, blended(row)))
    actions = range(len(model.action_space))
    return [_with_rows(model.observation_matrix(action), changes.get(action, [])) for action in actions]


def _with_rows(matrix: Matrix, changes: Sequence[tuple[int, npt.NDArray[np.intp], Vector]]) -> Matrix:
    """Return a matrix with other numbers at some places of some rows."""
    if not changes:
        return matrix
    if is_compressed(matrix):
        other = csr(matrix).tolil()
        for row, columns, values in changes:
            other[row, columns] = values
        return other.tocsr()
    dense = np.array(matrix)
    for row, columns, values in changes:
        dense[row, columns] = values
    return dense


def replaced(flat: MDP, transitions: Sequence[Matrix], observations: Sequence[Matrix] | None) -> MDP:
    """Return a flat model with other matrices; observations of events stay as they are."""
    names: dict[str, Any] = {
        "discount": flat.discount,
        "states": flat.state_space,
        "actions": flat.action_space,
        "initial_belief": flat.initial_belief,
        "available": flat.available,
        "sparse": flat.is_sparse,
    }
    if flat.pomdp is None:
        return _earning(flat, MDP(transitions, flat.rewards, outcome_rewards=flat.outcome_rewards, **names))
    seen: Any = observations
    if observations is None:
        count = range(len(flat.pomdp.observation_space))
        seen = [[flat.pomdp.event_matrix(a, o) for o in count] for a in range(len(flat.action_space))]
    result = POMDP(
        transitions,
        seen,
        flat.rewards,
        observation_names=flat.pomdp.observation_space,
        event_observations=observations is None,
        outcome_rewards=flat.outcome_rewards,
        **names,
    )
    return _earning(flat, result.with_false_negatives(flat.false_negative))


def possible(model: MDP, number: int) -> Iterator[MDP]:
    """Yield models that records leave possible: an estimated one, with rows drawn from its posterior.

    A row has the Dirichlet distribution of which it is the mean, by the visits that it rests on and the weight of the
    old model. Of a network these are the rows of each factor; those that are equal are drawn as one.
    """
    assert model.visits is not None
    flat, generator = model.flatten(), np.random.default_rng(0)
    matrices = [flat.transition_matrix(action) for action in range(len(flat.action_space))]
    sizes = [len(flat.state_space)] if model.network is None else [len(each) for each in flat.state_space.factors]
    rows = np.concatenate([m.toarray() if is_compressed(m) else m for m in matrices]).reshape(-1, *sizes)
    for _ in range(number):
        new = np.ones(rows.shape)
        for axis, size in enumerate(sizes, 1):
            own = rows.sum(axis=tuple({*range(1, rows.ndim)} - {axis})).round(12)
            means, places = own, np.arange(len(own))
            if model.network is not None:
                means, places = np.unique(own, axis=0, return_inverse=True)
            weights = np.zeros((len(means), 1))
            np.maximum.at(weights[:, 0], places.ravel(), WEIGHT + model.visits.T.ravel())
            drawn = np.where(means > 0, np.maximum(generator.gamma(means * weights), 1e-300), 0)
            shape = [-1, *(size if other == axis else 1 for other in range(1, rows.ndim))]
            new *= (drawn / drawn.sum(axis=1, keepdims=True))[places.ravel()].reshape(shape)
        yield replaced(flat, list(new.reshape(len(matrices), *[len(flat.state_space)] * 2)), None)


def _earning(old: MDP, new: MDP) -> MDP:
    """Return a new model with the expectations of the old one's rewards of outcomes."""
    new = new.timed_as(old)
    if old.outcome_rewards is None:
        return new
    rewards = np.array(new.rewards)
    for state, action in np.ndindex(*rewards.shape):
        symbols, row = support(new.transition_matrix(action), state)
        rewards[state, action] = expected_reward(new, action, state, symbols, row)
    other = copy(new)
    vars(other)["_rewards"] = read_only(rewards)
    return other


def expected_reward(model: MDP, action: int, state: int, symbols: npt.NDArray[np.intp], row: Vector) -> float:
    """Return R(s, a) of rewards of outcomes, where so probable states follow."""
    outcomes, pomdp, total = model.outcome_rewards, model.pomdp, 0.0
    assert outcomes is not None
    for following, probability in zip(symbols.tolist(), row.tolist(), strict=True):
        if pomdp is None:
            total += probability * outcomes.at(action, state, following, None)
            continue
        chances = pomdp.observation(action, following, state=state)
        told = np.flatnonzero(chances).tolist()
        total += probability * math.fsum(chances[o] * outcomes.at(action, state, following, o) for o in told)
    return total


# -- Factors -----------------------------------------------------------------------------------------------------------


def pool_of(model: MDP, stays: Iterable[Stay], kind: Kind) -> Pool | None:
    """Return the counts of a model's factors in some stays; None where they are not independent, or it has none.

    Args:
        model: The model.
        stays: Those of chains.
        kind: Of the chains.
    """
    network = model.network
    if network is None or len(network.states.factors) < 2 or type(model) not in {FactoredMDP, FactoredPOMDP}:
        return None
    if any(len([node for node in each.scope if node.role == "next_state"]) > 1 for each in network.transitions):
        return None
    if len(model.state_space) * len(model.action_space) > _LARGEST:
        return None
    listed = list(stays)
    matrix = model.flatten().transition_matrix
    leaving = math.fsum(stay.seconds * (1 - float(matrix(stay.action)[stay.state, stay.state])) for stay in listed)
    ended = sum(stay.ended for stay in listed)
    if not ended or (kind == "jumps" and leaving <= 0):
        return None
    return Pool(model, network, listed, kind, leaving / ended)


class Pool:
    """The counts of a network's factors, pooled over states and actions.

    Args:
        model: The model.
        network: Its network.
        stays: Those of chains.
        kind: Of the chains.
        step: The seconds of the model's time step.

    Attributes:
        step: The seconds of the model's time step.
    """

    def __init__(self, model: MDP, network: TwoSliceNetwork, stays: Sequence[Stay], kind: Kind, step: float) -> None:
        self.step = step
        self._model = model
        self._flat = model.flatten()
        self._network = network
        self._kind = kind
        self._sizes = [len(factor) for factor in network.states.factors]
        self._counts: dict[_Key, Vector] = defaultdict(lambda: np.zeros(0))
        self._exposure: dict[_Key, float] = defaultdict(float)
        for stay in stays:
            if stay.state is not None:
                self._take(stay)

    def _digits(self, state: int) -> list[int]:
        return [int(digit) for digit in np.unravel_index(state, self._sizes)]

    def _keys(self, action: int, state: int) -> list[_Key]:
        """Return the rows of all factors at a state and an action."""
        before = self._digits(state)
        actions = np.unravel_index(action, [len(factor) for factor in self._network.actions.factors])
        given = {Node("state", place): np.array([digit]) for place, digit in enumerate(before)}
        given |= {Node("action", place): np.array([digit]) for place, digit in enumerate(actions)}
        keys = []
        for place, potential in enumerate(self._network.transitions):
            row = potential.rows(given, 1, Node("next_state", place), self._sizes[place])[0]
            keys.append((place, before[place], tuple(row.tolist())))
        return keys

    def _take(self, stay: Stay) -> None:
        assert stay.state is not None
        after = None if stay.next_state is None or not stay.ended else self._digits(stay.next_state)
        for key in self._keys(stay.action, stay.state):
            place, value, row = key
            if key not in self._counts:
                self._counts[key] = np.zeros(len(row))
            self._exposure[key] += stay.seconds
            if after is not None and (self._kind == "steps" or after[place] != value):
                self._counts[key][after[place]] += 1

    def _chances(self, key: _Key) -> Vector:
        """Return the distribution of a factor after a step; of jumps, how often a step each other value follows."""
        place, value, row = key
        model = np.array(row)
        counts = self._counts.get(key, np.zeros(self._sizes[place])) * (model > 0)
        if self._kind == "steps":
            return np.asarray((counts + WEIGHT * model) / (counts.sum() + WEIGHT))
        result = (counts + WEIGHT * model) * self.step / (self._exposure.get(key, 0.0) + WEIGHT * self.step)
        result[value] = 1.0  # it stays as it is, while another changes
        return np.asarray(result)

    def weights(self, action: int, state: int) -> tuple[npt.NDArray[np.intp], Vector]:
        """Return the states that may follow, and their weights: of jumps, how often they follow in a step."""
        symbols, _ = support(self._flat.transition_matrix(action), state)
        if self._kind == "jumps":
            symbols = symbols[symbols != state]
        digits = np.unravel_index(symbols, self._sizes)
        weights = np.ones(len(symbols))
        for key, after in zip(self._keys(action, state), digits, strict=True):
            weights *= self._chances(key)[after]
        return symbols, weights

    def model(self, step: float | None = None) -> MDP:
        """Return the network whose tables are made from the counts.

        Args:
            step: Of jumps, the seconds of its time step; by default the model's.
        """
        old = self._network
        tables = [self._table(place, each, step or self.step) for place, each in enumerate(old.transitions)]
        new = TwoSliceNetwork(
            old.states,
            old.actions,
            old.observations,
            initial=old.initial,
            transitions=tables,
            observation=old.observation,
            utilities=old.utilities,
            fully_observed=old.fully_observed,
            event_observations=old.event_observations,
        )
        made = type(self._model)(new, discount=self._model.discount, sparse=self._model.sparse)  # type: ignore[call-arg, arg-type]
        return made.with_false_negatives(self._model.false_negative).timed_as(self._model)

    def _table(self, place: int, potential: Potential, step: float) -> Table:
        """Return the distribution of a factor over its parents, its own value, and its next value."""
        from scipy.linalg import expm  # noqa: PLC0415 - slow to import

        own, child, size = Node("state", place), Node("next_state", place), self._sizes[place]
        scope = [*(node for node in potential.scope if node not in {own, child}), own]
        sizes = [len(self._network.factor(node)) for node in scope]
        grid = [axis.ravel() for axis in np.indices(sizes)]
        rows = potential.rows(dict(zip(scope, grid, strict=True)), len(grid[0]), child, size).reshape(-1, size, size)
        new = np.empty(rows.shape)
        for number, before in enumerate(rows):  # by own value, of the same parents
            after = np.array([self._chances((place, value, tuple(row.tolist()))) for value, row in enumerate(before)])
            if self._kind == "jumps":
                np.fill_diagonal(after, 0.0)
                rates = after / self.step
                after = np.where(before > 0, expm(step * (rates - np.diag(rates.sum(axis=1)))), 0.0)
            new[number] = after / after.sum(axis=1, keepdims=True)
        return Table([*scope, child], new.reshape(*sizes, size))

    def visits(self) -> Vector:
        """Return on how many changes each state and action rests, by the factor that has the fewest: S x A."""
        result = np.zeros((len(self._flat.state_space), len(self._flat.action_space)))
        for state, action in np.ndindex(*result.shape):
            result[state, action] = min(self._counts.get(key, np.zeros(1)).sum() for key in self._keys(action, state))
        return result

    def lasting(self) -> Vector:
        """Return how long each state lasts under each action by the rates of its factors, S x A; 0 for ever."""
        flat = self._flat
        result = np.zeros((len(flat.state_space), len(flat.action_space)))
        for state, action in np.ndindex(*result.shape):
            total = float(self.weights(action, state)[1].sum())
            result[state, action] = self.step / total if total > 0 else 0.0
        return result
