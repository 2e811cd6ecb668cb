"""Snapshots that come from elsewhere: whatever one says, it is refused, or the controller goes on from it."""

from __future__ import annotations

import random

import msgspec
import numpy as np
import pytest
from team_robots import rooms

import mdm
from mdm import Controller, problems
from mdm.models import POMDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    RandomPolicy,
    StagedPolicy,
)

VALUES = (-(2**63), -1, 0, 1, 2, 3, 2**31, 2**62, 2**64 - 1, None, True, "", "1", [], {}, b"", 0.5, -1.0, 1e308)
NOT_FINITE = (float("nan"), float("inf"))


class Halving:
    """A tracker of a user's own."""

    def __init__(self):
        self.reset()

    def reset(self, belief=None):
        self.current = np.full(2, 0.5) if belief is None else np.asarray(belief)

    def update(self, action, observation):
        return 1.0


def over(model):
    """Alpha vectors, of no great value, for a model."""
    rewards = np.asarray(model.rewards).T
    return AlphaVectors(rewards, list(range(len(rewards))))


def corridor():
    """A model of so many states that its beliefs are held by their support."""
    size = 400
    moves = np.zeros((size, size))
    moves[np.arange(size), (np.arange(size) + 1) % size] = 1
    told = np.eye(2)[np.arange(size) % 2]
    return POMDP([moves] * 2, [told] * 2, np.zeros((size, 2)), discount=0.9, initial_belief=np.eye(size)[0])


def controllers():
    """Return a controller of each kind of information, and an observation or state to go on with."""
    tiger, fire, long = problems.tiger(), problems.fire_fighting(2, 3, 2), corridor()
    return {
        "a belief": (Controller(over(tiger), tiger, initial_belief=[0.4, 0.6]), 1),
        "a joint belief": (Controller(over(fire), fire, horizon=5), 1),
        "a belief by its support": (Controller(over(long), long), 1),
        "a tracker of one's own": (Controller(over(tiger), tiger, tracker=Halving()), 1),
        "random numbers": (Controller(RandomPolicy(3, 2, seed=5), tiger), 1),
        "a state": (Controller(DeterministicPolicy([0, 1, 2, 3]), rooms()), 3),
        "a state at a stage": (Controller(StagedPolicy(np.zeros((30, 4, 4))), rooms()), 3),
        "nodes": (Controller(JointController([FiniteStateController([0, 1], [[0, 1]] * 2, 3)] * 2)), 3),
    }


def change(value, chance):
    """Return a snapshot, or a part of one, with one leaf changed."""
    if isinstance(value, list) and value and chance.random() < 0.95:
        place = chance.randrange(len(value))
        return [*value[:place], change(value[place], chance), *value[place + 1 :]]
    if isinstance(value, bytes) and chance.random() < 0.8:
        if len(value) % 8 == 0 and value:
            place = 8 * chance.randrange(len(value) // 8)
            number = np.float64(chance.choice([*NOT_FINITE, -1.0, 0.0, 0.3, 1e300]))
            word = chance.choice([number, np.int64(chance.choice([-1, 0, 3, 2**40]))]).tobytes()
            return chance.choice([value[:place] + word + value[place + 8 :], value[8:], value * 2, value[:-1]])
        return value[:-1]
    return chance.choice([*VALUES, *NOT_FINITE])


@pytest.mark.parametrize(
    "kind",
    [
        "a belief",
        "a joint belief",
        "a belief by its support",
        "a tracker of one's own",
        "random numbers",
        "a state",
        "a state at a stage",
        "nodes",
    ],
)
def test_whatever_a_snapshot_says_it_is_refused_or_gone_on_from(kind):
    controller, seen = controllers()[kind]
    state = controller.takes == "state"
    take = controller.see if state else controller.observe
    if not state:
        controller.start()
    for _ in range(3):
        take(seen)
    chance = random.Random(1)
    begun, refused = controller.snapshot(), 0
    for _ in range(400):
        controller.restore(begun)
        before = controller.digest()
        forged = msgspec.msgpack.encode(change(msgspec.msgpack.decode(begun), chance))
        try:
            controller.restore(forged)
        except mdm.ModelError:
            refused += 1
            assert controller.digest() == before
            continue
        if not controller.over:
            step = take(seen)
            assert 0 <= step.action < controller.policy.num_actions
            assert step.reward is None or np.isfinite(step.reward)
    assert refused > 100
