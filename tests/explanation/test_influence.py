"""Influences of observations, against Bayes' rule written out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm import ModelError, problems
from mdm.explanation import Influence, influences, strongest
from mdm.models import POMDP
from mdm.policies import AlphaVectors, FiniteStateController, JointController, MaskedAlphaVectors

SEEDS = st.integers(0, 2**32 - 1)


def random_model(random, states, actions, observations):
    transitions = random.dirichlet(np.ones(states), size=(actions, states))
    seen = random.dirichlet(np.ones(observations), size=(actions, states))
    return POMDP(transitions, seen, random.normal(size=(states, actions)), discount=0.9)


def believed(model, steps):
    """Return the belief after actions and observations, where None is not observed; by the rule."""
    belief = np.array(model.initial_belief)
    for action, observation in steps:
        belief = belief @ np.asarray(model.transition_matrix(action))
        if observation is not None:
            belief = belief * np.asarray(model.observation_matrix(action))[:, observation]
        belief = belief / belief.sum()
    return belief


def margin_of(vectors, actions, belief, action):
    values = vectors @ belief
    best = {a: values[np.asarray(actions) == a].max() for a in set(actions)}
    return best.pop(action) - max(best.values())


@given(SEEDS)
def test_the_observation_that_is_named_changes_the_margin_most(seed):
    random = np.random.default_rng(seed)
    states, count = int(random.integers(2, 5)), int(random.integers(1, 7))
    model = random_model(random, states, 3, 3)
    vectors = random.normal(size=(6, states))
    actions = [0, 1, 2, 0, 1, 2]
    controller = mdm.Controller(AlphaVectors(vectors, actions), model)
    step, steps = controller.start(), []
    for _ in range(count):
        observation = int(random.integers(3))
        steps.append((step.action, observation))
        step = controller.observe(observation)
    margin = margin_of(vectors, actions, believed(model, steps), step.action)
    changes = []
    for removed in range(count):
        without = [(action, None if at == removed else seen) for at, (action, seen) in enumerate(steps)]
        belief = believed(model, without)
        there = margin_of(vectors, actions, belief, step.action)
        changes.append(margin - there)
    explanation = step.explain()
    assert explanation.margin == pytest.approx(margin, abs=1e-12)
    assert [each.change for each in explanation.influences] == pytest.approx(changes, abs=1e-9)
    told = explanation.moved_by
    assert abs(told.change) == pytest.approx(max(map(abs, changes)), abs=1e-9)
    assert told.epoch == 1 + max(range(count), key=lambda at: (round(abs(changes[at]), 9), at))


def test_only_the_last_observations_are_looked_at():
    model = problems.tiger()
    controller = mdm.Controller(AlphaVectors([[0, 0], [1, -99], [-99, 1]], [0, 1, 2]), model)
    steps = [controller.start(), *(controller.observe(number % 2) for number in range(50))]
    assert [each.epoch for each in steps[-1].explain(3).influences] == [48, 49, 50]
    assert len(steps[-1].explain().influences) == 10
    assert len(steps[5].explain().influences) == 5
    assert steps[30].explain() == steps[30].explain()


def test_which_teammate():
    """Agent 1 has heard the opposite of agent 0, and of itself before: what each has heard is removed alone."""
    model = problems.dec_tiger().with_discount(0.9)
    policy = AlphaVectors([[0, 0], [5, -50], [-50, 5]], [0, 4, 8], 9)
    controller = mdm.Controller(policy, model)
    controller.start()
    step = controller.observe((0, 0))
    found = influences(step.case())
    assert [(each.of, each.observation) for each in found] == [
        (factor.name, factor.names[0]) for factor in model.observation_space.factors
    ]
    one = believed(model, [(0, None)])
    seen = np.asarray(model.observation_matrix(0)).reshape(2, 2, 2)
    for agent, each in enumerate(found):
        heard = seen[:, 0, :].sum(axis=1) if agent == 1 else seen[:, :, 0].sum(axis=1)
        belief = one * heard / (one @ heard)
        assert each.without == pytest.approx(margin_of(policy.vectors, policy.actions, belief, step.action))


def test_a_component_that_is_missing_counts_for_nobody():
    controller = mdm.Controller(AlphaVectors([[0, 0]], [0], 9), problems.dec_tiger().with_discount(0.9))
    controller.start()
    (found,) = influences(controller.observe((None, 1)).case())
    assert found.observation == "hear-right"
    assert influences(controller.observe(None).case()) == [found]


def test_a_margin_that_is_lost_counts_most():
    """Without the observation no vector of the action holds for the belief."""
    transitions = np.stack([np.eye(2)] * 2)
    model = POMDP(transitions, np.stack([np.eye(2)] * 2), np.zeros((2, 2)), discount=0.9)
    policy = MaskedAlphaVectors([{0: 5.0}, {0: 0.0, 1: 0.0}], [1, 0])
    controller = mdm.Controller(policy, model)
    controller.start()
    step = controller.observe(0)
    assert step.action == 1
    told = step.explain().moved_by
    assert (told.without, told.change, told.action, told.decisive) == (None, None, "action 0", True) or (
        told.action == step.case().action_name(0)
    )


def test_a_plan_without_values_names_what_led_elsewhere():
    policy = FiniteStateController([0, 1, 2], [[0, 1], [1, 2], [2, 2]])
    controller = mdm.Controller(policy)
    steps = [controller.start(), *(controller.observe(each) for each in (0, 1, 0, 0))]
    told = steps[-1].explain()
    assert (told.moved_by.epoch, told.moved_by.decisive, told.margin) == (2, True, None)
    assert [each.decisive for each in told.influences] == [False, True, False, False]


def test_agents_with_a_plan_each():
    own = FiniteStateController([0, 1], [[0, 1], [1, 1]])
    controller = mdm.Controller(JointController([own, own]))
    controller.start()
    told = controller.observe((0, 1)).explain()
    assert [(each.of, each.decisive) for each in told.influences] == [("agent0", False), ("agent1", True)]
    assert told.moved_by.of == "agent1"


def test_the_strongest_of_equal_ones_is_the_last():
    def influence(epoch, change, decisive=False):
        return Influence(epoch, "", "seen", 0.0, change, "a", decisive)

    assert strongest([]) is None
    assert strongest([influence(1, None), influence(2, 0.0)]) is None
    found = [influence(1, -2.0), influence(2, 2.0), influence(3, 1.0)]
    assert strongest(found).epoch == 2
    assert strongest([*found, influence(4, None, decisive=True)]).epoch == 4
    for order in itertools.permutations(found):
        assert abs(strongest(list(order)).change) == 2


def test_a_tracker_of_ones_own_is_not_run_again():
    class Half:
        current = np.array([0.5, 0.5])

        def reset(self, belief=None):
            pass

        def update(self, action, observation):
            return 1.0

    controller = mdm.Controller(AlphaVectors([[0, 0]], [0], 3), problems.tiger(), tracker=Half())
    controller.start()
    with refused(ModelError):
        influences(controller.observe(0).case())
