"""Policies over beliefs as alpha vectors: the value function is the maximum of linear functions of the belief.

V(b) = max over vectors of alpha . b, and the action is that of the maximal vector (R. D. Smallwood and E. J. Sondik,
*The optimal control of partially observable Markov processes over a finite horizon*, Operations Research 21, 1973).
A choice costs one product of the N x S matrix with the belief; of a large matrix only of the columns of the support.

Masked vectors are each defined on a subset of the states. One is applicable to a belief if its subset contains the
support; the maximal applicable vector decides (T. Smith and R. Simmons, *Focused real-time dynamic programming for
MDPs: squeezing more out of a heuristic*, AAAI 2006, on the solver ZMDP). A choice costs two products of sparse matrices
with a vector.

For mixed observability there is a set of vectors over the hidden part y for each observed value x. A state is (x, y),
x observed and y hidden; x and a belief over y are enough to decide (S. C. W. Ong, S. W. Png, D. Hsu and W. S. Lee,
*Planning under uncertainty for robotic tasks with mixed observability*, International Journal of Robotics Research 29,
2010). A choice costs one product of the vectors of x with the belief.
"""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self

import numpy as np

from mdm.beliefs import Support
from mdm.beliefs.batch import grouped, product
from mdm.compilation import can_compile, is_sparing
from mdm.errors import ModelError
from mdm.models.matrices import csr, numbers
from mdm.policies.batch import BeliefBatch
from mdm.policies.policy import BeliefPolicy, Scores, listed, whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.policies.batch import Batch
    from mdm.policies.policy import Arrays, Packed

_LARGE = 20_000
"""The number of entries from which it pays to look for the support."""


class _Vectors(BeliefPolicy):
    """The base of policies that compare the values of vectors at a belief."""

    vectors: Any
    actions: list[int]

    def _at(self, belief: Any) -> npt.NDArray[np.float64]:
        """Return the value of each vector at a belief; -inf for one that is not applicable."""
        raise NotImplementedError

    def value(self, belief: npt.NDArray[np.float64] | Support) -> float:
        """Return the expected discounted return from a belief; -inf if no vector is applicable.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        return float(self._at(belief).max())

    def q_values(self, belief: npt.NDArray[np.float64] | Support) -> npt.NDArray[np.float64]:
        """Return the value of each action at a belief; -inf for an action without applicable vectors.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        values = np.full(self.num_actions, -np.inf)
        np.maximum.at(values, self.actions, self._at(belief))
        return values

    def scores(self, belief: npt.NDArray[np.float64] | Support, /) -> Scores:
        """Return the values of its actions at a belief."""
        return Scores("value", self.q_values(belief))

    def facts(self) -> dict[str, int | None]:
        """Return its sizes by name."""
        return {**super().facts(), "vectors": len(self.vectors)}

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        return None if model.pomdp is None else BeliefBatch(self, model.pomdp)


class AlphaVectors(_Vectors):
    """Chooses the action of the maximal vector at a belief; of equal ones, the lowest action.

    A belief is an array of S numbers, or its `Support`, at a cost that does not grow with S.

    Args:
        vectors: N x S.
        actions: The N vectors' actions.
        num_actions: The number of actions; by default one more than the largest.

    Raises:
        ModelError: If shapes do not fit or a number is not finite.

    Example::

        policy = mdm.policies.AlphaVectors([[1, -1], [0, 0]], actions=[1, 0])
        policy.action([0.9, 0.1])  # 1
        policy.value([0.9, 0.1])  # 0.8
    """

    kind: ClassVar[str] = "alpha"
    form = "alpha vectors"
    by_support = True
    named: tuple[str, ...] = ()
    """The actions as a file names them that was read without the model, which alone knows their indices."""

    def mismatch(self, model: MDP) -> str | None:
        """Return why the policy does not fit a model, as a sentence; None if it fits."""
        if self.named:
            return f"its file names actions ({', '.join(self.named)}): load it with the model, load_policy(path, model)"
        return super().mismatch(model)

    def __init__(self, vectors: npt.ArrayLike, actions: Sequence[int], num_actions: int | None = None) -> None:
        matrix = numbers(vectors, "the array of alpha vectors")
        if matrix.ndim != 2 or 0 in matrix.shape:
            raise ModelError(f"alpha vectors are a vectors x states array, not one of shape {matrix.shape}")
        if len(actions) != len(matrix):
            raise ModelError(f"there are {len(matrix)} alpha vectors, but {len(actions)} actions for them")
        if not np.isfinite(matrix).all():
            vector = int((~np.isfinite(matrix)).any(axis=1).argmax())
            raise ModelError(f"alpha vector {vector} has a number that is not finite")
        for vector, action in enumerate(actions):
            if not hasattr(action, "__index__") or action < 0:
                raise ModelError(f"alpha vector {vector} is for action {action}; actions are whole numbers from 0 on")
        self.num_actions = int(max(actions)) + 1 if num_actions is None else num_actions
        if max(actions) >= self.num_actions:
            raise ModelError(
                f"alpha vector {int(np.argmax(actions))} is for action {max(actions)}, but the actions are "
                f"0 to {self.num_actions - 1}"
            )
        self.num_states = matrix.shape[1]
        # Sorted by action, so that the first maximum has the lowest action.
        order = np.argsort(np.asarray(actions), kind="stable")
        # A row per state, so that the rows of a support are contiguous.
        self._by_state = np.ascontiguousarray(matrix[order].T)
        self._by_state.setflags(write=False)
        self.vectors = self._by_state.T
        self._is_large = matrix.size >= _LARGE
        self._at_belief, self._at_support = _at_belief, _at_support
        if self._is_large and not is_sparing() and can_compile():
            from mdm.policies.alpha_kernels import at_belief, at_support  # noqa: PLC0415 - numba is slow to import

            self._at_belief, self._at_support = at_belief, at_support
            one = Support(np.zeros(1, np.intp), np.ones(1))
            for belief in (one, one.dense(self.num_states), np.zeros(self.num_states)):
                self._at(belief)  # compiled now, not at the first choice; also for writeable arrays
        self.actions: list[int] = [int(actions[index]) for index in order]

    def action(self, belief: npt.NDArray[np.float64] | Support) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states.
        """
        # Hot path: array methods cost half of numpy's functions.
        if self._is_large or belief.__class__ is Support:
            return self.actions[self._at(belief).argmax()]
        try:
            best: int = self.vectors.dot(belief).argmax()
        except ValueError:
            self._refuse(belief)
        return self.actions[best]

    def actions_at(self, beliefs: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
        """Return the action for each belief, N x S."""
        chosen: npt.NDArray[np.intp] = np.asarray(self.actions)[product(beliefs, self.vectors.T).argmax(axis=1)]
        return chosen

    def for_first_states(self, count: int) -> AlphaVectors:
        """Return its vectors for the first so many states."""
        return AlphaVectors(self.vectors[:, :count], self.actions, self.num_actions)

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        return {"actions": self.num_actions}, {"vectors": self.vectors, "actions": whole(self.actions)}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        return cls(arrays["vectors"], listed(arrays["actions"]), sizes["actions"])

    def _at(self, belief: Any) -> npt.NDArray[np.float64]:
        """Return the value of each vector at a belief."""
        values: npt.NDArray[np.float64]
        try:
            if isinstance(belief, Support):
                values = self._at_support(self._by_state, *belief)
            elif self._is_large:
                belief = np.ascontiguousarray(belief, np.float64)
                if belief.shape != (self.num_states,):
                    self._refuse(belief)
                values = self._at_belief(self._by_state, belief)
            else:
                values = self.vectors.dot(belief)
        except (ValueError, IndexError):
            self._refuse(belief)
        return values

    def _refuse(self, belief: npt.NDArray[np.float64] | Support) -> NoReturn:
        if isinstance(belief, Support):
            raise ModelError(
                f"the policy is for beliefs over {self.num_states} states, and this belief has a state beyond them"
            ) from None
        shape = np.shape(belief)
        raise ModelError(f"the policy is for beliefs of {self.num_states} numbers, not of shape {shape}") from None


def _at_belief(by_state: npt.NDArray[np.float64], belief: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the values of N vectors, given as S x N, at a belief."""
    (states,) = belief.nonzero()
    if len(states) * 4 < len(belief):  # for a larger support, copying the rows costs more than it saves
        return _at_support(by_state, states, belief[states])
    values: npt.NDArray[np.float64] = belief.dot(by_state)
    return values


def _at_support(
    by_state: npt.NDArray[np.float64], states: npt.NDArray[np.intp], weights: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the values of N vectors at a belief, given by its support."""
    if states.min(initial=0) < 0:  # a negative index
        raise IndexError
    values: npt.NDArray[np.float64] = weights.dot(by_state.take(states, 0))
    return values


_SUPPORT = 1e-10
"""Smaller probabilities are rounding errors, not part of the support."""


class MaskedAlphaVectors(_Vectors):
    """Chooses the action of the maximal vector among those defined on all of a belief's support.

    Args:
        vectors: N vectors, each as a mapping from states to values.
        actions: The N vectors' actions.
        num_states: S; by default one more than the largest state.
        num_actions: The number of actions; by default one more than the largest.

    Raises:
        ModelError: If sizes do not fit, a state or action does not exist, or a number is not finite.

    Example::

        policy = mdm.policies.MaskedAlphaVectors([{0: 5.0}, {0: 0.0, 1: 0.0}], actions=[1, 0])
        policy.action([1.0, 0.0]), policy.action([0.9, 0.1])  # 1, 0
    """

    kind: ClassVar[str] = "masked"
    form = "alpha vectors with masks"

    def __init__(
        self,
        vectors: Sequence[Mapping[int, float]],
        actions: Sequence[int],
        num_states: int | None = None,
        num_actions: int | None = None,
    ) -> None:
        if not len(vectors) or not all(vectors):
            raise ModelError("masked alpha vectors need at least one vector, and each at least one state")
        if len(actions) != len(vectors):
            raise ModelError(f"there are {len(vectors)} alpha vectors, but {len(actions)} actions for them")
        self.num_states = max(map(max, vectors)) + 1 if num_states is None else num_states
        self.num_actions = max(actions) + 1 if num_actions is None else num_actions
        for index, (vector, action) in enumerate(zip(vectors, actions, strict=True)):
            if not 0 <= action < self.num_actions:
                raise ModelError(
                    f"alpha vector {index} is for action {action}, but the actions are 0 to {self.num_actions - 1}"
                )
            if not (min(vector) >= 0 and max(vector) < self.num_states):
                raise ModelError(f"alpha vector {index} has a state outside 0 to {self.num_states - 1}")
            if not np.isfinite(list(vector.values())).all():
                raise ModelError(f"alpha vector {index} has a number that is not finite")
        # Sorted by action, so that the first maximum has the lowest action.
        order = sorted(range(len(actions)), key=actions.__getitem__)
        self.vectors: tuple[dict[int, float], ...] = tuple(dict(sorted(vectors[index].items())) for index in order)
        self.actions: list[int] = [int(actions[index]) for index in order]
        # The vectors and their masks (1 for defined) as sparse N x S matrices.
        data = np.array([value for vector in self.vectors for value in vector.values()], dtype=np.float64)
        states = np.array([state for vector in self.vectors for state in vector])
        starts, shape = np.cumsum([0, *map(len, self.vectors)]), (len(self.vectors), self.num_states)
        self._values: Any = csr((data, states, starts), shape)
        self._states: Any = csr((np.ones(len(data)), states, starts), shape)

    def action(self, belief: npt.NDArray[np.float64]) -> int:
        """Return the action for a belief.

        Raises:
            ModelError: If the belief is not over the policy's states, or no vector is defined on all of its support.
        """
        values = self._at(belief)
        best = int(values.argmax())
        if values[best] == -np.inf:
            raise ModelError("no alpha vector of the policy is defined on all of the belief's support")
        return self.actions[best]

    def packed(self) -> Packed:
        """Return its sizes and arrays."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "starts": np.cumsum([0, *map(len, self.vectors)], dtype=np.int64),
            "states": whole(chain.from_iterable(self.vectors)),
            "values": np.array([value for vector in self.vectors for value in vector.values()], dtype=np.float64),
            "actions": whole(self.actions),
        }
        return {"actions": self.num_actions, "states": self.num_states}, arrays

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        states, values = listed(arrays["states"]), arrays["values"].ravel().tolist()
        parts = pairwise(listed(arrays["starts"]))
        vectors = [dict(zip(states[a:b], values[a:b], strict=True)) for a, b in parts]
        return cls(vectors, listed(arrays["actions"]), sizes["states"], sizes["actions"])

    def _at(self, belief: Any) -> npt.NDArray[np.float64]:
        """Return the vectors' values at a belief; -inf for inapplicable ones."""
        if np.shape(belief) != (self.num_states,):
            raise ModelError(f"the policy is for beliefs of {self.num_states} numbers, not of shape {np.shape(belief)}")
        support = np.asarray(belief) > _SUPPORT
        values: npt.NDArray[np.float64] = self._values.dot(belief)
        values[self._states.dot(support) < support.sum()] = -np.inf
        return values


_SURE = 1 - 1e-9
"""The probability from which an observed value counts as certain."""
_OPEN = -1


class MixedAlphaVectors(_Vectors):
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
        return {**BeliefPolicy.facts(self), "vectors": sum(len(each.vectors) for each in self.sets if each is not None)}

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
                    f"the policy is for beliefs over {self.num_states} states, and this belief has a state beyond them"
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
