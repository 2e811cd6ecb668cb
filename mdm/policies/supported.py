"""Shields of policies over beliefs, of searches and of finite-state controllers: see `mdm.shield`.

The support of the belief alone decides which actions are allowed. Of these the policy's own goes first, then the best
by its scores, or by the values of known states where it has none. One that is also to reach a goal may take only
actions that bring it nearer: by the steps that random allowed actions would still take, as the belief expects them.
This expectation falls at each decision, so that the goal is reached with probability 1. A decision costs a look-up of
the support, and a product of its probabilities with the gains of its states.

A support is made of the probabilities above 0 of the tracked belief; those that a tracker rounds to 0 are not in it.
One that was not met beforehand, as after a missing observation, is taken for the smallest known one that contains it.
Where there is none, and where nothing is safe, actions are allowed that would reach X least probably if the state were
seen from the next step on.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from mdm.beliefs import Drawn
from mdm.models import POMDP
from mdm.models.matrices import csr
from mdm.policies.batch import BeliefBatch
from mdm.policies.finite_state_controller import FiniteStateController
from mdm.policies.policy import BeliefPolicy, observable
from mdm.policies.shielded import Shielded

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.policies.batch import Batch

    Mask = npt.NDArray[np.bool_]
    Indices = npt.NDArray[np.integer]

_ROUNDING = 1e-9
_WISHES = 1_000


class SupportMask:
    """The actions that supports allow.

    Args:
        starts: Where the states of each support begin, and N: K + 1.
        states: Their states behind each other, N, those of each support in ascending order.
        allowed: The actions of each, K x A.
        gain: How much nearer to the goal an action brings each state of a support, N x A; None where that is not asked.
        risk: The least probability of reaching X by each action in each state, S x A.
        values: The values of known states, S x A.
    """

    def __init__(
        self, starts: Indices, states: Indices, allowed: Mask, gain: Vector | None, risk: Vector, values: Vector
    ) -> None:
        self.starts, self.states, self.allowed = starts, states, allowed
        self.gain, self.risk, self.values = gain, risk, values
        keys = (states[a:b].tobytes() for a, b in pairwise(starts))
        self._numbers: dict[bytes, int] = {key: number for number, key in enumerate(keys)}

    def at(self, states: Indices, weights: Vector) -> Mask:
        """Return which actions are allowed at each of n beliefs of one support: n x A, given their n x M weights."""
        if (number := self._numbers.get(states.tobytes(), -1)) < 0:
            number = self._around(states)
        if number < 0 or not self.allowed[number].any():
            risk = weights @ self.risk[states]
            return np.asarray(risk <= risk.min(axis=1, keepdims=True) + _ROUNDING)
        allowed = np.broadcast_to(self.allowed[number], (len(weights), self.allowed.shape[1]))
        if self.gain is None:
            return allowed
        first, last = self.starts[number], self.starts[number + 1]
        gain = weights @ self.gain[first + np.searchsorted(self.states[first:last], states)]
        gain = np.where(allowed, gain, -np.inf)
        return np.asarray(gain >= np.minimum(gain.max(axis=1, keepdims=True), 0))

    def _around(self, states: Indices) -> int:
        """Return the smallest known support that contains some states and allows an action; -1 where there is none."""
        inside = np.add.reduceat(np.isin(self.states, states), self.starts[:-1]) == len(states)
        (found,) = np.nonzero(inside & self.allowed.any(axis=1))
        return int(found[np.diff(self.starts)[found].argmin()]) if len(found) else -1


class ShieldedBelief(Shielded, BeliefPolicy):
    """A policy over beliefs whose actions the support of the belief allows, see `mdm.shield`.

    Args:
        policy: The policy.
        mask: The actions that supports allow.
        margin: The transitions besides the model's, by which beliefs are tracked as well.
    """

    form = "a shielded policy over beliefs"

    def __init__(self, policy: Any, mask: SupportMask, margin: Sequence[tuple[int, int, int]] = ()) -> None:
        super().__init__(policy)
        self.mask, self.margin = mask, margin
        self.input, self.by_support = policy.input, getattr(policy, "by_support", False)

    def information(self, model: MDP | None) -> Information:
        """Return the policy's own, which knows of the margin."""
        model = widened(observable(model), self.margin) if self.margin else model
        information: Information = self.policy.information(model)
        return information

    def allowed(self, x: Any, /) -> Mask:
        """Return which actions are allowed at a belief: A truth values."""
        states, weights = _support(x)
        return np.asarray(self.mask.at(states, weights[None, :])[0])

    def _chosen(self, x: Any, wants: int) -> int:
        if (allowed := self.allowed(x))[wants]:
            return int(wants)
        scores = self.policy.scores(x)
        return self._best(x, allowed, None if scores is None else scores.numbers)

    def _best(self, x: Any, allowed: Mask, numbers: Vector | None) -> int:
        """Return the best allowed action by some numbers, or by the values of known states where there are none."""
        if numbers is None or not np.isfinite(numbers[allowed]).any():
            states, weights = _support(x)
            numbers = weights @ self.mask.values[states]
        return int(np.where(allowed, numbers, -np.inf).argmax())

    def actions_at(self, beliefs: Vector) -> npt.NDArray[np.intp]:
        """Return the action for each belief, N x S."""
        actions = self.policy.actions_at(beliefs).copy()
        _, first, kind = np.unique(np.packbits(beliefs > 0, axis=1), axis=0, return_index=True, return_inverse=True)
        for number, example in enumerate(first.tolist()):
            rows, states = np.flatnonzero(kind.ravel() == number), np.flatnonzero(beliefs[example])
            allowed = self.mask.at(states, beliefs[np.ix_(rows, states)])
            off = rows[~allowed[np.arange(len(rows)), actions[rows]]]
            if len(off):
                _, each, which = np.unique(beliefs[off], axis=0, return_index=True, return_inverse=True)
                chosen = [self._chosen(beliefs[row], int(actions[row])) for row in off[each].tolist()]
                actions[off] = np.array(chosen)[which.ravel()]
        return np.asarray(actions, dtype=np.intp)

    def facts(self) -> dict[str, Any]:
        """Return its sizes and X by name."""
        return {**super().facts(), "supports": len(self.mask.allowed)}

    def parameters(self) -> list[Any]:
        """Return all that decides besides the information."""
        its = self.mask
        arrays = [its.states, its.allowed, its.risk, its.values, *([] if its.gain is None else [its.gain])]
        return [type(self.policy).__name__, *self.policy.parameters(), *arrays, [list(each) for each in self.margin]]

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes."""
        if model.pomdp is None or self.policy.batch(model) is None or not hasattr(self.policy, "actions_at"):
            return None
        return BeliefBatch(self, widened(model.pomdp, self.margin))


def _support(x: Any) -> tuple[Indices, Vector]:
    """Return the states of an information state, in ascending order, and their probabilities."""
    x = x.by if isinstance(x, Drawn) else x
    if isinstance(x, int | np.integer):
        return np.array([x]), np.ones(1)
    if isinstance(x, tuple):
        order = np.argsort(x[0])
        return np.asarray(x[0], dtype=np.int64)[order], np.asarray(x[1])[order]
    belief = np.asarray(x)
    (states,) = belief.nonzero()
    return states, belief[states]


def _key(x: Any) -> int:
    states, weights = _support(x)
    return hash((states.tobytes(), weights.tobytes()))


class Answered(NamedTuple):
    """The result of a shielded search, and the action that the search itself found, where it is another one."""

    action: int
    expansions: int
    wanted: int | None


class ShieldedSearch(ShieldedBelief):
    """A search whose answers the support of the belief allows, and its fallback's as well.

    Attributes:
        fallback: The shielded fallback; None where there is none.
    """

    form = "a shielded search"
    deliberates: Literal[True] = True

    def __init__(self, policy: Any, mask: SupportMask, margin: Sequence[tuple[int, int, int]] = ()) -> None:
        super().__init__(policy, mask, margin)
        self.worker, self.seconds, self.expansions = policy.worker, policy.seconds, policy.expansions
        self.fallback = None if policy.fallback is None else ShieldedBelief(policy.fallback, mask, margin)
        self.parts, self.prepare, self.belief_of = policy.parts, policy.prepare, policy.belief_of
        self._wishes: dict[int, int | None] = {}

    def answered(self, found: Any, x: Any, /) -> Answered:
        """Return the answer for a result of the search: its own action, or the best of its root that is allowed."""
        allowed, lower = self.allowed(x), getattr(found, "lower", None)
        if allowed[found.action]:
            return Answered(int(found.action), found.expansions, None)
        best = self._best(x, allowed, None if lower is None else np.array(lower))
        return Answered(best, found.expansions, int(found.action))

    def search(self, x: Any, /, *, timed: bool = True) -> Answered:
        """Search in this process."""
        return self.answered(self.policy.search(x, timed=timed), x)

    def action(self, x: Any, /) -> int:
        """Return the action after a search."""
        found = self.search(x)
        self.note(x, found.wanted)
        return found.action

    def note(self, x: Any, wanted: int | None, /) -> None:
        """Remember the action that the search wanted at a belief; None where the shield took no other one."""
        self._wishes.pop(key := _key(x), None)  # the newest comes last
        self._wishes[key] = wanted
        if len(self._wishes) > _WISHES:
            del self._wishes[next(iter(self._wishes))]

    def wanted(self, x: Any, /) -> int | None:
        """Return the action of the search in its last answer at a belief, of the newest 1,000; None if taken."""
        return self._wishes.get(_key(x))


class ShieldedController(Shielded, FiniteStateController):
    """A finite-state controller whose nodes know the support of the belief, which allows their actions.

    Args:
        policy: The controller as it was.
        actions: The action of each node.
        successors: For each node the next node after each observation, None where there is none.
        wanted: For each node the action of the controller's own node; None behind it, where it did not reach the goal.
        allowed: The actions that each node allows, nodes x A.
    """

    form = "a shielded finite-state controller"
    kind: ClassVar[str] = "shielded controller"
    margin: Sequence[tuple[int, int, int]] = ()

    def __init__(
        self,
        policy: FiniteStateController,
        actions: Sequence[int],
        successors: Sequence[Sequence[int | None]],
        wanted: Sequence[int | None],
        allowed: Mask,
    ) -> None:
        FiniteStateController.__init__(self, actions, successors, policy.num_actions)
        self.policy, self.discount_of = policy, policy.discount_of
        self._wanted = [None if its == action else its for its, action in zip(wanted, actions, strict=True)]
        self._allowed = allowed

    action, scores = FiniteStateController.action, FiniteStateController.scores

    def wanted(self, nodes: Sequence[int], /) -> int | None:
        """Return the action that the controller's own node has, where it is not taken; else None."""
        return self._wanted[nodes[0]]

    def allowed(self, nodes: Sequence[int], /) -> Mask:
        """Return which actions are allowed at a node: A truth values."""
        return np.asarray(self._allowed[nodes[0]])

    def parameters(self) -> list[Any]:
        """Return all that decides, and the original's."""
        return [*super().parameters(), *self.policy.parameters()]

    def facts(self) -> dict[str, Any]:
        """Return its sizes and X by name."""
        return {**super().facts(), "nodes": self.num_nodes}


_CHANCE = 1e-6
"""The probability of a margin's transitions."""


def widened(model: POMDP, margin: Sequence[tuple[int, int, int]]) -> POMDP:
    """Return a model with a margin's transitions of probability 1e-6, by which beliefs are tracked."""
    if not margin:
        return model
    model, actions = model.flatten(), range(len(model.action_space))
    transitions = [csr(model.transition_matrix(action)).tolil() for action in actions]
    for before, action, after in margin:
        transitions[action][before] *= 1 - _CHANCE
        transitions[action][before, after] += _CHANCE
    wider = POMDP(
        [csr(each) for each in transitions], [model.observation_matrix(action) for action in actions], model.rewards,
        discount=model.discount, states=model.state_space, actions=model.action_space,
        observation_names=model.observation_space, initial_belief=model.initial_belief,
    )  # fmt: skip
    return wider.with_false_negatives(model.false_negative)
