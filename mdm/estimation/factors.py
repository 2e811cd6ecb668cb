"""Factors: what is known of rows that were never visited, where the model is a network.

A factored model says with one number what happens in many states: a fire goes out with the same probability whoever
waits elsewhere. So what was counted in the states that were visited is the best guess for those that were not, and a
policy that is solved anew does not go where the old model's number was never put to the test. Rows of a factor to which
the model gives the same distribution are pooled, from the same value of the factor. Between changes of the state these
are rates, of which each factor has its own (U. Nodelman, C. R. Shelton and D. Koller, *Continuous time Bayesian
networks*, Uncertainty in Artificial Intelligence, 2002).

A row of the old model weighs as much as one visit, or as the seconds of one of its time steps. How long these are is
told by the record: as long as the model needs to leave its states as often as they were left.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from mdm.estimation.reestimation import WEIGHT, rewritten
from mdm.estimation.rows import support
from mdm.models.factored.two_slice import Node

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from mdm.estimation.chains import Kind, Stay
    from mdm.estimation.rates import Rates
    from mdm.models.factored.two_slice import TwoSliceNetwork
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
    if network is None or len(network.states.factors) < 2:
        return None
    if any(len([node for node in each.scope if node.role == "next_state"]) > 1 for each in network.transitions):
        return None
    if len(model.state_space) * len(model.action_space) > _LARGEST:
        return None
    listed = list(stays)
    leaving = math.fsum(stay.seconds * _leaving(model, stay) for stay in listed)
    ended = sum(stay.ended for stay in listed)
    if not ended or (kind == "jumps" and leaving <= 0):
        return None
    return Pool(model, network, listed, kind, leaving / ended)


def _leaving(model: MDP, stay: Stay) -> float:
    matrix = model.flatten().transition_matrix(stay.action)
    return 1 - float(matrix[stay.state, stay.state])


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

    def model(self) -> MDP:
        """Return the model whose rows are made from the factors; of jumps, its probabilities of staying are the old."""
        changes: dict[int, list[tuple[int, npt.NDArray[np.intp], Vector]]] = {}
        for action in range(len(self._flat.action_space)):
            matrix = self._flat.transition_matrix(action)
            for state in range(len(self._flat.state_space)):
                symbols, weights = self.weights(action, state)
                if weights.sum() > 0:
                    rest = 1 - float(matrix[state, state]) if self._kind == "jumps" else 1.0
                    changes.setdefault(action, []).append((state, symbols, rest * weights / weights.sum()))
        return rewritten(self._flat, changes)

    def lasting(self) -> Vector:
        """Return how long each state lasts under each action by the rates of its factors, S x A; 0 for ever."""
        flat = self._flat
        result = np.zeros((len(flat.state_space), len(flat.action_space)))
        for state, action in np.ndindex(*result.shape):
            total = float(self.weights(action, state)[1].sum())
            result[state, action] = self.step / total if total > 0 else 0.0
        return result

    def generators(self, found: Iterable[Rates]) -> dict[int, Vector]:
        """Return Q of each action, S x S: jumps by the time exposed, beside a step of the rates of the factors."""
        seen = {(each.action, each.state): each for each in found}
        size = len(self._flat.state_space)
        result = {}
        for action in range(len(self._flat.action_space)):
            generator = np.zeros((size, size))
            for state in range(size):
                symbols, weights = self.weights(action, state)
                rates = weights / self.step
                if (row := seen.get((action, state))) is not None:
                    counts = np.zeros(size)
                    counts[row.symbols] = row.counts
                    rates = (counts[symbols] + weights) / (row.holding.exposure + self.step)
                generator[state, symbols] = rates
                generator[state, state] = -rates.sum()
            result[action] = generator
        return result
