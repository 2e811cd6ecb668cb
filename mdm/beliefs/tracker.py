"""Belief tracking: Bayes' rule over the states of a POMDP.

After action a and observation o, b'(s') is proportional to O(o | a, s') times the sum over s of T(s' | s, a) b(s); the
normalising constant is P(o | b, a) (Kaelbling, Littman and Cassandra, *Planning and acting in partially observable
stochastic domains*, Artificial Intelligence 101, 1998, section 3.3).

A tracker chooses a filter for its model. Cost of an update: O(S^2) for small or dense models, O(non-zeros of T) for
large ones, or O(non-zeros of the support's rows of T) while the support is small.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mdm.beliefs.choice import chosen_filter
from mdm.beliefs.filter import Support
from mdm.errors import ModelError
from mdm.models.factored.flattening import first_states
from mdm.models.matrices import Vector, distribution

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from mdm.models.pomdp import POMDP
    from mdm.models.space import Symbol

_MOST_KEPT = 100_000
"""The most joint observations that are kept as agreeing with observations of which components are missing."""

Observed: TypeAlias = "Symbol | Sequence[str | int | None] | frozenset[int] | None"
"""A joint observation by index or name, its components (None for a missing one), the indices of those of which one was
observed, or None for no observation."""


class BeliefTracker:
    """Tracks the belief over the states of a POMDP, exactly.

    With event observations, b'(s') is proportional to the sum over s of P(s', o | s, a) b(s). An update accounts for
    all false negatives that may precede an observed event.

    Args:
        model: The POMDP.
        by_support: Whether ``current`` may be the belief's `Support`, for policies that accept it.

    Example::

        tracker = mdm.BeliefTracker(mdm.load_model("tiger.pomdp"))
        tracker.update("listen", "hear-left")  # 0.5
        tracker.belief  # [0.85, 0.15]
    """

    def __init__(self, model: POMDP, *, by_support: bool = False) -> None:
        if getattr(model, "observation_space", None) is None:
            raise ModelError(
                f"a belief is tracked by a POMDP, not by {model!r}: load its file, or give it observations"
            )
        self._space = model.observation_space
        self._actions = model.action_space
        self._states = model.state_space
        self._by_support = by_support
        self._size = len(model.state_space)
        self._num_actions = len(model.action_space)
        self._num_observations = len(model.observation_space)
        self._false_negative = model.false_negative
        if model.network is not None and model.stays_factored:
            self._start = Support(*first_states(model.network))
        else:
            initial = model.initial_belief
            (states,) = initial.nonzero()
            self._start = Support(states, initial[states])
        self._filter = chosen_filter(model)
        self._step = self._filter.step
        self._steps = self._filter.steps
        self._belief: Vector | None = None
        self._support: Support | None = None
        self._sizes = model.observation_space.shape
        self._agreeing: dict[tuple[int | None, ...], list[int]] = {}
        self._num_agreeing = 0
        self.reset()

    @property
    def belief(self) -> Vector:
        """The present belief: an immutable array of S numbers."""
        if self._belief is None:
            self._belief = self._filter.dense()
        return self._belief

    @property
    def current(self) -> Vector | Support:
        """The argument of a policy: the belief, or its support if ``by_support`` and `is_sparse` hold."""
        if not (self._by_support and self._filter.is_sparse):
            if self._belief is None:
                self._belief = self._filter.dense()
            return self._belief
        if self._support is None:
            self._support = self._filter.support()
        return self._support

    @property
    def support(self) -> Support:
        """The support of the present belief, in any order. If `is_sparse`, the cost does not grow with S."""
        return self._filter.support()

    @property
    def is_sparse(self) -> bool:
        """Whether the belief is held by its support: `support` is then cheaper than `belief`."""
        return self._filter.is_sparse

    def reset(self, belief: npt.ArrayLike | Support | None = None) -> None:
        """Begin from a belief, by default the model's initial one.

        Args:
            belief: S numbers that sum to 1, or a `Support`; or the name or index of a state that is certain.

        Raises:
            ModelError: If it is not a distribution over the states; the belief is unchanged.
        """
        if isinstance(belief, str | int):
            belief = Support(np.array([self._states.index(belief)]), np.ones(1))
        self._support = None
        if belief is None:
            self._belief = None
            self._filter.load(self._start)
        elif isinstance(belief, Support):
            self._filter.load(checked_support(belief, self._size))
            self._belief = None
        else:
            self._belief = distribution(belief, what="the belief", size=self._size)
            (states,) = self._belief.nonzero()
            self._filter.load(Support(states, self._belief[states]))

    def update(self, action: Symbol, observation: Observed) -> float:
        """Update the belief by an action and the observation after it.

        Args:
            action: The joint action, by index or name.
            observation: The joint observation, by index or name; or a component per agent, with None for a missing
                one, which is marginalised; or the set of indices of which one was observed; or None for a prediction
                by T alone.

        Returns:
            P(observation | belief, action); with false negatives, of the next detected event. If it is 0, the belief
            is unchanged.

        Raises:
            ModelError: If there is no such action or observation.
        """
        # Hot path: a fifth of a microsecond for 2 states by numba, a little more than one by numpy. A step that is
        # ready made takes .06 less than a call of the filter.
        if (
            observation.__class__ is int
            and action.__class__ is int
            and -1 < action < self._num_actions
            and -1 < observation < self._num_observations
        ):
            steps = self._steps
            probability = self._step(action, observation) if steps is None else steps[action][observation]()
        else:
            probability = self._other(action, observation)
        if probability > 0.0:
            self._belief = self._support = None
        return probability

    def update_all(self, steps: Iterable[tuple[int, Observed]]) -> float:
        """Update the belief by a sequence of actions and observations.

        Returns:
            The probability of all observations. If one is impossible, it is 0, and the belief is unchanged. (The
            probability of a very long sequence may also underflow to 0.)

        Raises:
            ModelError: If there is no such action or observation; the belief is unchanged.
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
        """Return the exact state of the tracker, for this process or another."""
        return [type(self._filter).__name__, self._filter.snapshot()]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot of a tracker of the same model.

        Raises:
            ModelError: If it was made by another filter, as where numba is not installed.
        """
        kind, held = snapshot
        if kind != type(self._filter).__name__:
            raise ModelError(
                f"the snapshot is of a {kind}, but the tracker has a {type(self._filter).__name__}: install numba in "
                f"both processes, or in neither"
            )
        self._filter.restore(held)
        self._belief = self._support = None

    def _other(self, action: Any, observation: Any) -> float:
        """Update by names, components, or no observation."""
        if action.__class__ is not int or not -1 < action < self._num_actions:
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
        """Return the joint observations that agree with the given components."""
        if isinstance(observation, frozenset) and observation:
            return sorted(self._space.index(symbol) for symbol in observation)
        if not isinstance(observation, tuple | list) or None not in observation:
            try:
                return [self._space.index(observation)]
            except (ModelError, TypeError) as error:
                raise ModelError(f"there is no observation {observation!r}: {error}") from None
        factors = self._space.factors
        if len(observation) != len(factors):
            raise ModelError(f"an observation has {len(factors)} components, not {len(observation)}")
        indices: list[int | None] = []
        for factor, size, component in zip(factors, self._sizes, observation, strict=True):
            if component is None or (component.__class__ is int and -1 < component < size):
                indices.append(component)
            else:
                indices.append(factor.index(component))
        given = tuple(indices)
        symbols = self._agreeing.get(given)
        if symbols is None:
            symbols = agreeing(self._sizes, given)
            self._num_agreeing += len(symbols)
            if self._num_agreeing > _MOST_KEPT:
                self._agreeing.clear()
                self._num_agreeing = len(symbols)
            self._agreeing[given] = symbols
        return symbols


def agreeing(sizes: Sequence[int], given: Sequence[int | None]) -> list[int]:
    """Return the joint symbols that agree with components, None for a missing one; the first is most significant."""
    symbols = [0]
    for size, component in zip(sizes, given, strict=True):
        places = range(size) if component is None else (component,)
        symbols = [symbol * size + place for symbol in symbols for place in places]
    return symbols


def checked_support(belief: Support, size: int) -> Support:
    """Return a valid support, exactly normalised.

    Raises:
        ModelError: If a state does not exist or is repeated, or the probabilities are not a distribution.
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
