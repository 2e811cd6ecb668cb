"""The fewest observations that lead a plan elsewhere, against all sequences."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError
from mdm.explanation import changes, observation_changes
from mdm.policies import FiniteStateController, JointController

SEEDS = st.integers(0, 2**32 - 1)


def walked(policy, observations):
    node = policy.start
    for observation in observations:
        node = policy.next_node(node, observation)
    return policy.action_at(node)


@given(SEEDS)
def test_the_fewest_of_all_sequences(seed):
    random = np.random.default_rng(seed)
    nodes, count = int(random.integers(1, 5)), int(random.integers(1, 5))
    policy = FiniteStateController(
        random.integers(2, size=nodes).tolist(), random.integers(nodes, size=(nodes, 2)).tolist(), 2
    )
    seen = random.integers(2, size=count).tolist()
    controller = mdm.Controller(policy)
    step = controller.start()
    for observation in seen:
        step = controller.observe(observation)
    apart = {}
    for other in itertools.product(range(2), repeat=count):
        if walked(policy, other) != step.action:
            apart.setdefault(sum(a != b for a, b in zip(seen, other, strict=True)), []).append(other)
    found, ways = observation_changes(step.case())
    fewest = min(apart, default=3)
    assert ways == (len(apart[fewest]) if fewest <= 2 else 0)
    for change in found:
        other = list(seen)
        for each in change.observations:
            assert other[each.epoch - 1] == int(each.before[-1])
            other[each.epoch - 1] = int(each.after[-1])
        assert tuple(other) in apart[fewest]


def test_one_agents_observation():
    own = FiniteStateController([0, 1], [[0, 1], [1, 1]])
    controller = mdm.Controller(JointController([own, FiniteStateController([0], [[0, 0]])]))
    controller.start()
    found, ways = observation_changes(controller.observe((0, None)).case())
    assert ways == 1
    assert [(each.of, each.epoch) for each in found[0].observations] == [("agent0", 1)]


def test_what_is_too_much(monkeypatch):
    monkeypatch.setattr(changes, "_MOST_WALKS", 1)
    controller = mdm.Controller(FiniteStateController([0], [[0, 0]]))
    controller.start()
    controller.observe(0)
    with refused(ModelError):
        observation_changes(controller.observe(0).case())
