"""Factors: what is known of rows that were never visited, where the model is a network.

A factored model says with one number what happens in many states: a fire goes out with the same probability whoever
waits elsewhere. So what was counted in the states that were visited is the best guess for those that were not, and a
policy that is solved anew does not go where the old model's number was never put to the test. Rows of a factor to which
the model gives the same distribution are pooled, from the same value of the factor. Between changes of the state these
are rates, of which each factor has its own (U. Nodelman, C. R. Shelton and D. Koller, *Continuous time Bayesian
networks*, Uncertainty in Artificial Intelligence, 2002).

A row of the old model weighs as much as one visit, or as the seconds of one of its time steps. How long these are is
told by the record: as long as the model needs to leave its states as often as they were left.

The new model is a network as well, with the structure of the old one, a table for each factor over its parents and its
own value. Rates become the probabilities after a step, expm(Q * step), while the other factors are as before it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from mdm.estimation.reestimation import WEIGHT
from mdm.estimation.rows import support
from mdm.models.factored.model import FactoredMDP, FactoredPOMDP
from mdm.models.factored.two_slice import Node, Table, TwoSliceNetwork

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from mdm.estimation.chains import Kind, Stay
    from mdm.models.factored.two_slice import Potential
    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP

__all__ = ["Pool", "pool_of"]

_LARGEST = 200_000
"""States times actions up to which rows are made from factors."""

_Key = tuple[int, int, tuple[float, ...]]
"""A factor, its value before, and its distribution by the model."""


def pool_of(model: MDP, stays: Iterable[Stay], kind: Kind) -> Pool | None:
    """Return what stays tell of the factors of a model; None where it has no network of factors that are independent.

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
        """Return the network whose tables are made from what was counted.

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
