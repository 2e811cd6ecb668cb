"""Policies for many episodes at once: what each of them does next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mdm.beliefs.batch import CrowdBeliefs, grouped, product
from mdm.models import POMDP
from mdm.policies import (
    AlphaVectors,
    ConstantPolicy,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    RandomPolicy,
    StagedPolicy,
    StochasticPolicy,
)

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.simulation.crowd import Indices

__all__ = ["ENDED", "Choices", "choices"]

ENDED = -1
"""In place of an action, where a plan ends."""
_SURE = 1 - 1e-9
"""The belief in one observed value from which nothing else counts."""


class Choices(Protocol):
    """The decisions of many episodes."""

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions of episodes that begin in some states; `ENDED` where a plan has none."""
        ...

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions of some episodes.

        Args:
            episodes: Their places among those that go on.
            states: Where each is now.
            actions: What it did.
            seen: What it observed then.
            numbers: From [0, 1), for policies that draw.
        """
        ...

    def keep(self, which: Indices) -> None:
        """Drop the other episodes."""
        ...


def choices(model: MDP, policy: Any) -> Choices | None:
    """Return the decisions of a policy for many episodes; None for policies of a kind that is not known here."""
    if isinstance(policy, QTable | DeterministicPolicy):
        return _ByTable(np.array([policy.action(state) for state in range(policy.num_states)]))
    if isinstance(policy, ConstantPolicy):
        return _ByTable(np.full(policy.num_states, policy.action(0)))
    if isinstance(policy, RandomPolicy):
        return _ByProbability(np.full((policy.num_actions, policy.num_states), 1 / policy.num_actions))
    if isinstance(policy, StagedPolicy):
        return _ByStage(policy.values.argmax(axis=2))
    if isinstance(policy, StochasticPolicy):
        return _ByProbability(policy.probabilities)
    if not isinstance(model, POMDP):
        return None
    if isinstance(policy, AlphaVectors | MixedAlphaVectors | MaskedAlphaVectors):
        return _ByBelief(CrowdBeliefs(model), policy)
    if isinstance(policy, JointController):
        return _ByNode(policy.controllers, model)
    if isinstance(policy, FiniteStateController):
        return _ByNode((policy,), model)
    return None


class _ByTable:
    def __init__(self, actions: Indices) -> None:
        self._actions = actions

    def begin(self, states: Indices, numbers: Vector) -> Indices:  # noqa: ARG002 - nothing is drawn
        return self._actions[states]

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        return self._actions[states]

    def keep(self, which: Indices) -> None:
        pass


class _ByStage:
    """A table for each decision; all episodes are at the same one, as every step of time has one."""

    def __init__(self, actions: Indices) -> None:
        self._actions = actions
        self._stage = 0

    def begin(self, states: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        self._stage = 0
        return self._actions[0, states]

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        self._stage += 1
        return self._actions[self._stage, states]

    def keep(self, which: Indices) -> None:
        pass


class _ByProbability:
    def __init__(self, probabilities: Vector) -> None:
        levels = np.cumsum(probabilities, axis=0)
        self._levels = levels[:-1] / levels[-1]

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        return (self._levels[:, states] <= numbers).sum(axis=0)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        return self.begin(states, numbers)

    def keep(self, which: Indices) -> None:
        pass


class _ByBelief:
    def __init__(self, crowd: CrowdBeliefs, policy: AlphaVectors | MixedAlphaVectors | MaskedAlphaVectors) -> None:
        self._crowd = crowd
        self._policy = policy

    def begin(self, states: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        self._crowd.begin(states)
        return _best(self._policy, self._crowd.beliefs)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        self._crowd.update(episodes, actions, seen)
        return _best(self._policy, self._crowd.beliefs[episodes])

    def keep(self, which: Indices) -> None:
        self._crowd.keep(which)


def _best(policy: Any, beliefs: Vector) -> Indices:
    """Return the action for each belief, a row each."""
    if isinstance(policy, AlphaVectors):
        return np.asarray(policy.actions)[product(beliefs, policy.vectors.T).argmax(axis=1)]
    if not isinstance(policy, MixedAlphaVectors):
        return np.array([policy.action(belief) for belief in beliefs])
    result = np.full(len(beliefs), ENDED)
    shown = np.empty(policy.num_states, dtype=np.intp)
    shown[policy.states] = np.arange(len(policy.states))[:, None]
    for rows, x in grouped(shown[beliefs.argmax(axis=1)]):
        vectors, parts = policy.sets[x], beliefs[np.ix_(rows, policy.states[x])]
        sure = parts.sum(axis=1) > _SURE
        if vectors is not None and sure.any():
            result[rows[sure]] = _best(vectors, parts[sure])
    for row in np.flatnonzero(result == ENDED):  # a vote, or no vectors, which is an error
        result[row] = policy.action(beliefs[row])
    return result


class _ByNode:
    """A node for each episode and agent, moved by that agent's own observations."""

    def __init__(self, controllers: tuple[FiniteStateController, ...], model: POMDP) -> None:
        self._controllers = controllers
        self._model = model
        team = len(controllers) > 1
        self._shape = model.action_space.shape if team else (len(model.action_space),)
        self._seen = model.observation_space.shape if team else (len(model.observation_space),)
        self._actions = [np.array(controller.actions) for controller in controllers]
        self._successors = [
            np.array([[ENDED if node is None else node for node in row] for row in controller.successors])
            for controller in controllers
        ]
        self._nodes = np.empty((len(controllers), 0), dtype=np.intp)

    def begin(self, states: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        alone = self._controllers[0] if len(self._controllers) == 1 else None
        if alone is not None and alone.values is not None:  # each begins where it is best by what it knows
            first, inverse = np.unique(states, return_inverse=True)
            nodes = np.array([alone.start_node(self._model.belief_at_start(int(state))) for state in first])
            self._nodes = nodes[None, inverse]
        else:
            starts = np.array([controller.start for controller in self._controllers])
            self._nodes = np.repeat(starts[:, None], len(states), axis=1)
        return self._at(self._nodes)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:  # noqa: ARG002
        parts = np.unravel_index(seen, self._seen)
        for agent, (successors, part) in enumerate(zip(self._successors, parts, strict=True)):
            self._nodes[agent, episodes] = successors[self._nodes[agent, episodes], part]
        nodes = self._nodes[:, episodes]
        return np.where((nodes == ENDED).any(axis=0), ENDED, self._at(nodes))

    def keep(self, which: Indices) -> None:
        self._nodes = self._nodes[:, which]

    def _at(self, nodes: Indices) -> Indices:
        parts = [actions[row] for actions, row in zip(self._actions, nodes, strict=True)]
        return np.ravel_multi_index(parts, self._shape)
