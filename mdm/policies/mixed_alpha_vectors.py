"""Policies for mixed observability: a set of alpha vectors over the hidden part y for each observed value x.

A state is (x, y), x observed and y hidden; x and a belief over y are enough to decide (S. C. W. Ong, S. W. Png, D. Hsu
and W. S. Lee, *Planning under uncertainty for robotic tasks with mixed observability*, International Journal of
Robotics Research 29, 2010). A choice costs one product of the vectors of x with the belief.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mdm.beliefs import Support
from mdm.beliefs.batch import grouped
from mdm.errors import ModelError
from mdm.policies.alpha_vectors import AlphaVectors
from mdm.policies.batch import BeliefBatch
from mdm.policies.policy import BeliefPolicy, Scores, listed, whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

__all__ = ["MixedAlphaVectors"]

_SURE = 1 - 1e-9
"""The probability from which an observed value counts as certain."""
_OPEN = -1


class MixedAlphaVectors(BeliefPolicy):
    """Chooses by the vectors of the observed value x; if a belief leaves x open, by a vote.

    A belief is over states (x, y): an array of S numbers, or its `Support`, at a cost that does not grow with S. If its
    support has a single x, the action is that of the maximal vector of x. Otherwise each x votes with its probability
    for its best action; the greatest sum wins, of equal ones the lowest action (action voting: A. R. Cassandra, L. P.
    Kaelbling and J. A. Kurien, *Acting under uncertainty*, IROS 1996). The value is then the expectation over x of the
    value given x, an upper bound of the value of the chosen action.

    Args:
        vectors: N x Y, values of the hidden part.
        actions: The N vectors' actions.
        observed: The N vectors' x.
        num_actions: The number of actions; by default one more than the largest.
        states: X x Y, the index of each state; by default x is the most significant digit.

    Raises:
        ModelError: If shapes do not fit, an index does not exist, or a number is not finite.

    Example::

        # Two observed values, two hidden ones: action 0 is right for x = 0, action 1 for x = 1.
        policy = mdm.policies.MixedAlphaVectors([[1, 0], [0, 1]], actions=[0, 1], observed=[0, 1])
        policy.action([0, 0, 0.5, 0.5])  # 1
    """

    kind: ClassVar[str] = "mixed"
    form = "alpha vectors per observed state"
    by_support = True

    def __init__(
        self,
        vectors: npt.ArrayLike,
        actions: Sequence[int],
        observed: Sequence[int],
        num_actions: int | None = None,
        *,
        states: npt.ArrayLike | None = None,
    ) -> None:
        checked = AlphaVectors(vectors, actions, num_actions)
        self.num_actions = checked.num_actions
        width = checked.num_states
        if len(observed) != len(actions) or min(observed) < 0:
            raise ModelError(f"each of {len(actions)} alpha vectors needs the index of an observed value")
        given = np.arange((max(observed) + 1) * width).reshape(-1, width) if states is None else states
        self.states: npt.NDArray[np.intp] = np.array(given, dtype=np.intp)
        ordered = np.sort(self.states, axis=None)
        if self.states.ndim != 2 or not np.array_equal(ordered, np.arange(self.states.size)):
            raise ModelError("the layout of states is an observed x hidden array with each state's index exactly once")
        self.states.setflags(write=False)
        if self.states.shape[1] != width:
            raise ModelError(f"the vectors have {width} values, but there are {self.states.shape[1]} hidden states")
        if max(observed) >= len(self.states):
            raise ModelError(f"there is no observed value {max(observed)}; the {len(self.states)} count from 0")
        self.num_states = self.states.size
        self._places = np.argsort(self.states, axis=None)
        array, of = np.asarray(vectors, dtype=np.float64), np.asarray(observed)
        self.sets: tuple[AlphaVectors | None, ...] = tuple(
            AlphaVectors(
                array[of == x], [actions[index] for index in np.flatnonzero(of == x).tolist()], self.num_actions
            )
            if (of == x).any()
            else None
            for x in range(len(self.states))
        )
        """The vectors of each observed value; None if it has none."""

    def action(self, belief: npt.NDArray[np.float64] | Support) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states, or no observed value of its support has vectors.
        """
        votes, _ = self._votes(belief)
        if not votes.any():
            raise ModelError("the policy has no alpha vectors for the observed values of the belief")
        return int(votes.argmax())

    def scores(self, belief: npt.NDArray[np.float64] | Support, /) -> Scores:
        """Return the values of its actions at a belief, or, where that leaves x open, the votes for them."""
        votes, count = self._votes(belief)
        return Scores("value", self.q_values(belief)) if count == 1 else Scores("vote", votes)

    def _votes(self, belief: npt.NDArray[np.float64] | Support) -> tuple[npt.NDArray[np.float64], int]:
        """Return the probability that votes for each action, and the number of observed values in the support."""
        votes, count = np.zeros(self.num_actions), 0
        for vectors, part in self._parts(belief):
            count += 1
            if vectors is not None:
                votes[vectors.action(part)] += part.probabilities.sum()
        return votes, count

    def value(self, belief: npt.NDArray[np.float64] | Support) -> float:
        """Return the expected discounted return from a belief, if x is observed before the first action.

        It is -inf if an observed value of the support has no vectors.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        parts = self._parts(belief)
        return float(sum(-np.inf if vectors is None else vectors.value(part) for vectors, part in parts))

    def q_values(self, belief: npt.NDArray[np.float64] | Support) -> npt.NDArray[np.float64]:
        """Return the value of each action at a belief, the same for all x; -inf if an x has no vector of it."""
        values = np.zeros(self.num_actions)
        for vectors, part in self._parts(belief):
            values += -np.inf if vectors is None else vectors.q_values(part)
        return values

    def actions_at(self, beliefs: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
        """Return the action for each belief, N x S."""
        result = np.full(len(beliefs), _OPEN)
        shown = np.empty(self.num_states, dtype=np.intp)
        shown[self.states] = np.arange(len(self.states))[:, None]
        for rows, x in grouped(shown[beliefs.argmax(axis=1)]):
            vectors, parts = self.sets[x], beliefs[np.ix_(rows, self.states[x])]
            sure = parts.sum(axis=1) > _SURE
            if vectors is not None and sure.any():
                result[rows[sure]] = vectors.actions_at(parts[sure])
        for row in np.flatnonzero(result == _OPEN):  # a vote, or an error for lack of vectors
            result[row] = self.action(beliefs[row])
        return result

    def facts(self) -> dict[str, int | None]:
        """Return its sizes by name."""
        return {**super().facts(), "vectors": sum(len(each.vectors) for each in self.sets if each is not None)}

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else BeliefBatch(self, model.pomdp)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        sets = [(x, vectors) for x, vectors in enumerate(self.sets) if vectors is not None]
        arrays: dict[str, npt.NDArray[Any]] = {
            "vectors": np.concatenate([vectors.vectors for _, vectors in sets]),
            "actions": whole(chain.from_iterable(vectors.actions for _, vectors in sets)),
            "observed": whole(x for x, vectors in sets for _ in vectors.actions),
            "layout": self.states.astype(np.int64),
        }
        return {"actions": self.num_actions}, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        actions, observed = listed(arrays["actions"]), listed(arrays["observed"])
        return cls(arrays["vectors"], actions, observed, sizes["actions"], states=arrays["layout"])

    def _parts(self, belief: npt.NDArray[np.float64] | Support) -> Iterator[tuple[AlphaVectors | None, Support]]:
        """Yield the vectors of each observed value of the support, and the weights of its hidden part."""
        if isinstance(belief, Support):
            states, weights = belief
            if len(states) and not (states.min() >= 0 and states.max() < self.num_states):
                raise ModelError(
                    f"the policy is for beliefs over {self.num_states} states: a state of the belief is none of them"
                )
        else:
            if np.shape(belief) != (self.num_states,):
                raise ModelError(
                    f"the policy is for beliefs of {self.num_states} numbers, not of shape {np.shape(belief)}"
                )
            belief = np.asarray(belief)
            (states,) = belief.nonzero()
            weights = belief[states]
        observed, hidden = np.divmod(self._places[states], self.states.shape[1])
        first = observed[:1]
        if (observed == first).all():  # the usual case
            for x in first.tolist():
                yield self.sets[x], Support(hidden, weights)
            return
        for x in np.unique(observed).tolist():
            chosen = observed == x
            yield self.sets[x], Support(hidden[chosen], weights[chosen])
