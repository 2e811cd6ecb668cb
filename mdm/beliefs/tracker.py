"""Belief tracking: Bayes' rule over the states of a POMDP.

After action a and observation o, b'(s') is proportional to O(o | a, s') times the sum over s of T(s' | s, a) b(s); what
it is divided by is P(o | b, a) (Kaelbling, Littman and Cassandra, *Planning and acting in partially observable
stochastic domains*, Artificial Intelligence 101, 1998, section 3.3).

The way it is computed is chosen when a tracker is built. Cost of an update: O(S^2) for small or dense models,
O(non-zeros of T) for large ones, and for these as long as a belief gives weight to few states alone, O(non-zeros of
their rows of T).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mdm.beliefs.choice import chosen_filter, is_vast
from mdm.beliefs.filter import Support
from mdm.errors import ModelError
from mdm.models.factored.flattening import first_states
from mdm.models.factored.model import FactoredPOMDP
from mdm.models.matrices import Vector, distribution

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from mdm.models.pomdp import POMDP
    from mdm.models.space import Symbol

__all__ = ["BeliefTracker"]

Observed: TypeAlias = "Symbol | Sequence[str | int | None] | None"
"""A joint observation by index or name, its components with None where one is missing, or None: nothing is known."""


class BeliefTracker:
    """Tracks the belief over the states of a POMDP, exactly.

    With observations that are events, b'(s') is proportional to the sum over s of P(s', o | s, a) b(s). Where the model
    has false negatives, any number of them may precede each event that is observed: an update takes them all into
    account.

    Args:
        model: The POMDP.
        by_support: Whether ``current`` may be the belief's `Support`, for policies that choose by it.

    Example::

        tracker = mdm.BeliefTracker(mdm.load_model("tiger.pomdp"))
        tracker.update("listen", "hear-left")  # 0.5, the observation's probability
        tracker.belief  # [0.85, 0.15]
    """

    def __init__(self, model: POMDP, *, by_support: bool = False) -> None:
        self._space = model.observation_space
        self._actions = model.action_space
        self._by_support = by_support
        self._size = len(model.state_space)
        self._num_actions = len(model.action_space)
        self._num_observations = len(model.observation_space)
        self._false_negative = model.false_negative
        self._start = _first(model)
        self._filter = chosen_filter(model)
        self._step = self._filter.step
        self._belief: Vector | None = None
        self._support: Support | None = None
        self.reset()

    @property
    def belief(self) -> Vector:
        """The present belief: S numbers, read-only; an array that was handed out never changes."""
        if self._belief is None:
            self._belief = self._filter.dense()
        return self._belief

    @property
    def current(self) -> Vector | Support:
        """What a policy is asked with: the belief, by its support where that was asked for and is how it is held."""
        if not (self._by_support and self._filter.is_sparse):
            return self.belief
        if self._support is None:
            self._support = self._filter.support()
        return self._support

    @property
    def support(self) -> Support:
        """The states that the present belief gives weight to, in no particular order, and their probabilities.

        Its cost does not grow with S where `is_sparse`.
        """
        return self._filter.support()

    @property
    def is_sparse(self) -> bool:
        """Whether the present belief is held by its support: it is then cheaper to ask for than `belief`."""
        return self._filter.is_sparse

    def reset(self, belief: npt.ArrayLike | Support | None = None) -> None:
        """Begin from a belief (S numbers that sum to 1, or a `Support`), or from the model's initial one.

        Raises:
            ModelError: If it is not a distribution over the states; the belief stays as it was.
        """
        self._support = None
        if belief is None:
            self._belief = None
            self._filter.load(self._start)
        elif isinstance(belief, Support):
            self._filter.load(_checked(belief, self._size))
            self._belief = None
        else:
            self._belief = distribution(belief, what="the belief", size=self._size)
            (states,) = self._belief.nonzero()
            self._filter.load(Support(states, self._belief[states]))

    def update(self, action: Symbol, observation: Observed) -> float:
        """Take an action and what was observed after it.

        Args:
            action: The joint action, by index or name.
            observation: The joint observation, by index or name; a component per agent, None where one is missing (its
                symbols are summed over); or None where nothing is known (prediction only: one step of T).

        Returns:
            P(observation | belief, action); with false negatives, of the next event that is detected. Where it is 0,
            the belief stays as it was.

        Raises:
            ModelError: If there is no such action or observation.
        """
        # Hot path: half a microsecond for 2 states by numba, a little more than one by numpy.
        if (
            observation.__class__ is int
            and action.__class__ is int
            and -1 < action < self._num_actions
            and -1 < observation < self._num_observations
        ):
            probability = self._step(action, observation)
        else:
            probability = self._other(action, observation)
        if probability > 0:
            self._belief = self._support = None
        return probability

    def update_all(self, steps: Iterable[tuple[int, Observed]]) -> float:
        """Take several actions, each with what was observed after it.

        Returns:
            The probability of all these observations. Where one of them is impossible it is 0, and the belief stays as
            it was before the first. (That of a very long sequence may be too small for a number, and 0 for that.)

        Raises:
            ModelError: If there is no such action or observation; the belief stays as it was before the first.
        """
        before, belief = self._filter.support(), self._belief
        product = 1.0
        try:
            for action, observation in steps:
                probability = self.update(action, observation)
                if not probability > 0:
                    break
                product *= probability
            else:
                return product
        except BaseException:
            self._filter.load(before)
            self._belief, self._support = belief, None
            raise
        self._filter.load(before)
        self._belief, self._support = belief, None
        return 0.0

    def expected(self, values: Vector) -> float:
        """Return the expectation of a function of the state, given as S numbers."""
        current = self.current
        if isinstance(current, Support):
            return float(values.take(current.states).dot(current.probabilities).item())
        return float(values.dot(current).item())

    def snapshot(self) -> Any:
        """Return what it takes to go on from here, bit by bit, in this process or another."""
        return [type(self._filter).__name__, self._filter.snapshot()]

    def restore(self, snapshot: Any) -> None:
        """Go on from a snapshot of a tracker of the same model.

        Raises:
            ModelError: If it was made where beliefs are tracked in another way (with numba, and without).
        """
        kind, held = snapshot
        if kind != type(self._filter).__name__:
            raise ModelError(
                f"the snapshot is of a {kind}, but the belief is tracked by a {type(self._filter).__name__}"
            )
        self._filter.restore(held)
        self._belief = self._support = None

    def _other(self, action: Any, observation: Any) -> float:
        """Take what is no plain index."""
        try:
            action = self._actions.index(action)
        except (ModelError, TypeError) as error:
            raise ModelError(f"there is no action {action!r}: {error}") from None
        if observation is None:
            return self._filter.predict(action)
        symbols = self._symbols(observation)
        if self._false_negative is not None and len(symbols) > 1:
            symbols = [symbol for symbol in symbols if symbol != self._false_negative]
        return self._step(action, symbols[0]) if len(symbols) == 1 else self._filter.step_any(action, symbols)

    def _symbols(self, observation: Any) -> list[int]:
        """Return the joint observations that an observation may stand for."""
        if not isinstance(observation, tuple | list) or None not in observation:
            try:
                return [self._space.index(observation)]
            except (ModelError, TypeError) as error:
                raise ModelError(f"there is no observation {observation!r}: {error}") from None
        factors = self._space.factors
        if len(observation) != len(factors):
            raise ModelError(f"an observation has {len(factors)} components, not {len(observation)}")
        chosen = np.ix_(
            *(
                range(len(factor)) if component is None else [factor.index(component)]
                for factor, component in zip(factors, observation, strict=True)
            )
        )
        symbols: list[int] = np.arange(self._num_observations).reshape(self._space.shape)[chosen].ravel().tolist()
        return symbols


def _first(model: POMDP) -> Support:
    """Return the initial belief by its support."""
    if isinstance(model, FactoredPOMDP) and is_vast(model):
        return Support(*first_states(model.network))
    initial = model.initial_belief
    (states,) = initial.nonzero()
    return Support(states, initial[states])


def _checked(belief: Support, size: int) -> Support:
    """Return a belief by its support, if it is one, exactly normalised.

    Raises:
        ModelError: If a state does not exist or comes twice, or the probabilities are not a distribution.
    """
    states = np.asarray(belief.states)
    whole = states.ndim == 1 and len(states) > 0 and states.dtype.kind in "iu"
    if not whole or states.min() < 0 or states.max() >= size:
        raise ModelError(f"the belief's support is not among the {size} states")
    if len(np.unique(states)) < len(states):
        raise ModelError("the belief's support has a state twice")
    probabilities = distribution(belief.probabilities, what="the belief", size=len(states))
    kept = probabilities > 0
    return Support(states[kept].astype(np.intp), probabilities[kept])
