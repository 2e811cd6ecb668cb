"""Bounds of a probability under a policy over beliefs: its belief graph, unfolded from step to step.

A node is a belief with the probability of each state in which a run is there, before X or Y holds; beliefs that agree
to 12 digits are one. What is not unfolded in time, or is less probable than 1e-9, lies between the bounds.
"""

from __future__ import annotations

import time
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.policies import BeliefPolicy
from mdm.verification.choices import Choices, Graph

if TYPE_CHECKING:
    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Vector
    from mdm.models.specification import Specification

_LEAST = 1e-9


class Bounds(msgspec.Struct, frozen=True):
    """Bounds of a probability, by a policy's belief graph.

    Attributes:
        lower: The lower one.
        upper: The upper one.
        beliefs: How many were unfolded.
        seconds: The time that it took.
    """

    lower: float
    upper: float
    beliefs: int
    seconds: float


def bounds_of(model: MDP, policy: Any, asked: Specification, seconds: float) -> Bounds:
    """Return bounds of a probability, after at most some seconds.

    Raises:
        ModelError: If it is no probability, the policy decides by more than its belief, or the model leaves steps
            without an observation.
    """
    pomdp = _checked(model, policy, asked)
    began, size = time.perf_counter(), len(model.state_space)
    graph = Graph(Choices.of_model(model, asked.target, asked.before))
    never, sure = graph.impossible(), graph.unavoidable()[0] & (asked.within is None)
    joint = cache(lambda action: [pomdp.joint_matrix(action, seen) for seen in range(len(pomdp.observation_space))])
    level: dict[bytes, tuple[Vector, Vector]] = {}

    def add(belief: Vector, chances: Vector) -> None:
        key = belief.round(12).tobytes()
        known = level.get(key)
        level[key] = (belief, chances) if known is None else (known[0], known[1] + chances)

    for state in np.flatnonzero(model.initial_belief).tolist():
        add(pomdp.belief_at_start(state), np.eye(1, size, state)[0] * model.initial_belief[state])
    lower, open_, count, step = 0.0, 0.0, 0, 0
    while level:
        nodes, level = level, {}
        for belief, chances in nodes.values():
            if time.perf_counter() - began > seconds:
                open_ += float(chances.sum())
                continue
            count += 1
            action = policy.action(belief)
            hit = asked.target[:, action] | sure
            lower += float(chances[hit].sum())
            going = np.where(hit | asked.miss[:, action] | never | (step == asked.within), 0.0, chances)
            if going.sum() < _LEAST:
                open_ += float(going.sum())
                continue
            for moves in joint(action):
                after = going @ moves
                if after.any():
                    seen = belief @ moves
                    add(seen / seen.sum(), after)
        step += 1
    low, high = lower, min(lower + open_, 1.0)
    low, high = (1 - high, 1 - low) if asked.always else (low, high)
    return Bounds(low, high, count, time.perf_counter() - began)


def _checked(model: MDP, policy: Any, asked: Specification) -> POMDP:
    pomdp = model.pomdp
    if asked.kind != "P":
        raise ModelError("a belief graph bounds probabilities: ask P(…)")
    if pomdp is None or getattr(type(policy), "information", None) is not BeliefPolicy.information:
        raise ModelError("a belief graph is of policies that decide by their belief alone, in a POMDP")
    if pomdp.event_observations or pomdp.false_negative is not None:
        raise ModelError("a belief graph needs an observation at each step: this model may leave steps without one")
    return pomdp
