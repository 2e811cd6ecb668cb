"""Recollections: what comes late is known in the end as though it had come in time; what never comes is summed over."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused
from teams import team

import mdm
from mdm.controller import Controller
from mdm.policies import AlphaVectors, FiniteStateController, JointController
from mdm.team import Experience, Recollection

MODELS = [team(seed, agents=agents, states=3, actions=2, observations=2) for seed, agents in ((1, 2), (2, 2), (3, 3))]
MODELS.append(mdm.problems.meeting(2, discount=0.9))  # certain observations, impossible after a wrong assumption


def policy_for(model, seed=0):
    random = np.random.default_rng(seed)
    size, actions = len(model.state_space), len(model.action_space)
    return AlphaVectors(random.normal(size=(12, size)), random.integers(actions, size=12), actions)


def controller_for(model, **options):
    return Controller(policy_for(model), model, **options)


def whole(space, components):
    return space.ravel(components)


def in_order(controller, did, saw):
    """Return the beliefs of a controller that gets everything in order, of each step's decision.

    Args:
        did: For each step the components of the joint action; None where the controller has to assume one.
        saw: For each step but the first the components of the observation.
    """
    actions = controller.symbols.action_space
    controller.reset()
    beliefs = [controller.belief]
    for step, known in enumerate(did):
        mark = controller.mark()
        assumed = actions.unravel(controller.decide().action)
        controller.go_back(mark)
        controller.decide(actions.ravel([b if a is None else a for a, b in zip(known, assumed, strict=True)]))
        if controller.over:
            controller.reset()
        else:
            controller.advance(tuple(saw[step + 1]) if None in saw[step + 1] else list(saw[step + 1]))
        beliefs.append(controller.belief)
    return beliefs


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_in_the_end_everything_is_known_as_though_it_had_come_in_time(data):
    model = data.draw(st.sampled_from(MODELS))
    horizon = data.draw(st.sampled_from([None, 3]))
    agents, sizes = model.num_agents, [len(factor) for factor in model.observation_space.factors]
    window = data.draw(st.integers(0, 6))
    steps = data.draw(st.integers(1, 10))
    me = data.draw(st.integers(0, agents - 1))
    did, saw, arriving = [], [None], {}
    for step in range(1, steps + 1):
        did.append([data.draw(st.none() | st.integers(0, 1)) for _ in range(agents)])
        saw.append([data.draw(st.none() | st.integers(0, size - 1)) for size in sizes])
        for other in range(agents):
            if other != me:
                delay = data.draw(st.integers(0, window))
                arriving.setdefault(step + delay, []).append((other, step))
    recollection = Recollection(controller_for(model, horizon=horizon), me, window=window)
    recollection.start()
    for step in range(steps + window + 1):
        if step:
            recollection.observe(saw[step][me] if step <= steps else None)
        for other, of in data.draw(st.permutations(arriving.get(step, []))):
            assert recollection.hear(other, Experience(of, did[of - 1][other], saw[of][other]))
            if data.draw(st.booleans()):
                assert recollection.belief is not None  # applied at once; else all that arrived together
        decided = recollection.decide()
        own = model.action_space.unravel(decided.action)[me]
        if step < steps:
            did[step][me] = own
        else:
            did.append([own if agent == me else None for agent in range(agents)])
            saw.append([None] * agents)
    expected = in_order(controller_for(model, horizon=horizon), did[:-1], saw)[-1]
    np.testing.assert_allclose(recollection.belief, expected, atol=1e-12)
    counts = recollection.statistics()
    assert counts.heard == (agents - 1) * steps
    assert counts.too_late == counts.too_early == counts.contradictory == 0


def test_what_never_arrives_is_summed_over():
    model = MODELS[2]
    random = np.random.default_rng(5)
    recollection = Recollection(controller_for(model), 1, window=4)
    recollection.start()
    belief = np.array(model.initial_belief)
    for step in range(1, 8):
        action = recollection.decide().action
        told = model.action_space.unravel(action)
        seen = int(random.integers(2))
        recollection.observe(seen)
        heard = int(random.integers(2))
        recollection.hear("robot2", Experience(step, told[2], heard))
        predicted = belief @ model.transition_matrix(action)
        chances = sum(
            np.asarray(model.observation_matrix(action))[:, model.observation_space.ravel([missing, seen, heard])]
            for missing in range(2)
        )
        belief = predicted * chances
        belief /= belief.sum()
        np.testing.assert_allclose(recollection.belief, belief, atol=1e-12)


def test_own_actions_stay_what_they_were_when_more_is_known():
    model = mdm.problems.dec_tiger(discount=0.9)
    listens = AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8], 9)  # opens from 0.9 on
    recollection = Recollection(Controller(listens, model), 0)
    recollection.start()
    assert recollection.decide().action_name == "listen listen"
    recollection.observe("hear-left")
    assert recollection.decide().action_name == "listen listen"
    recollection.observe("hear-left")
    assert recollection.decide().action_name == "open-right open-right"
    # The other agent heard the opposite twice, and listened: now it is known that this agent opened alone.
    recollection.hear("agent1", Experience(1, 0, 1))
    recollection.hear("agent1", Experience(2, 0, 1))
    np.testing.assert_allclose(recollection.belief, [0.5, 0.5])
    assert recollection.decide().action_name == "listen listen"  # nothing was carried out yet
    recollection.observe(None)
    recollection.hear("agent1", Experience(3, 0, None))
    np.testing.assert_allclose(recollection.belief, [0.5, 0.5])


def test_an_action_that_was_told_takes_the_place_of_the_assumed_one():
    model = mdm.problems.dec_tiger(discount=0.9)
    recollection = Recollection(controller_for(model), 0)
    recollection.start()
    listen = AlphaVectors([[0.0, 0.0]], [0], 9)
    recollection = Recollection(Controller(listen, model), 0)
    recollection.start()
    recollection.decide()
    recollection.observe("hear-left")
    np.testing.assert_allclose(recollection.belief, [0.85, 0.15])
    recollection.hear(1, Experience(1, 1, None))  # it opened a door, so that nothing was heard of the tiger
    np.testing.assert_allclose(recollection.belief, [0.5, 0.5])


def test_what_comes_too_late_too_early_or_otherwise_is_counted_and_told():
    model = MODELS[0]
    recollection, other = (Recollection(controller_for(model), 0, window=2) for _ in range(2))
    for each in (recollection, other):
        each.start()
        for _ in range(5):
            each.decide()
            each.observe(0)
    assert not recollection.hear(1, Experience(2, 0, 1))
    assert recollection.problem == "step 2 of robot1 came at step 5, after the window"
    assert not recollection.hear(1, Experience(9, 0, 1))
    assert recollection.problem == "step 9 of robot1 came at step 5, far ahead of it"
    np.testing.assert_array_equal(recollection.belief, other.belief)
    for each in (recollection, other):
        assert each.hear(1, Experience(3, 0, 1))
    assert recollection.hear(1, Experience(3, 0, 1))  # once more
    assert recollection.hear(1, Experience(3, None, 1))
    assert not recollection.hear(1, Experience(3, 0, 0))
    assert recollection.problem.startswith("robot1 told two different things of step 3: (0, 1), then (0, 0)")
    np.testing.assert_array_equal(recollection.belief, other.belief)
    counts = recollection.statistics()
    assert (counts.heard, counts.late, counts.repeated_steps) == (6, 1, 3)
    assert (counts.too_late, counts.too_early, counts.contradictory) == (1, 1, 1)


def test_what_comes_together_is_gone_through_once():
    recollection = Recollection(controller_for(MODELS[0]), 0)
    recollection.start()
    for _ in range(6):
        recollection.observe(1)
    assert recollection.belief is not None
    for step in (4, 2, 6):
        recollection.hear(1, Experience(step, 0, 1))
    assert recollection.statistics().repeated_steps == 0
    assert recollection.belief is not None
    assert recollection.statistics().repeated_steps == 5


def test_nobody_s_recollection_knows_what_was_told():
    model = MODELS[0]
    common, reference = Recollection(controller_for(model)), controller_for(model)
    common.start()
    reference.start()
    common.observe()
    common.hear(0, Experience(1, 1, 0))
    common.hear(1, Experience(1, 0, None))
    reference.reset()
    reference.decide(model.action_space.ravel([1, 0]))
    reference.advance((0, None))
    np.testing.assert_allclose(common.belief, reference.belief, atol=1e-12)


@pytest.mark.parametrize("decided", [False, True])
@pytest.mark.parametrize("horizon", [None, 2])
def test_the_look_ahead_is_the_value_of_an_action(decided, horizon):
    model = MODELS[0]
    recollection = Recollection(controller_for(model, horizon=horizon), 0)
    recollection.start()
    recollection.observe(1)
    if decided:
        recollection.decide()
    before = recollection.controller.digest()  # before the belief is looked at, which normalises it in place
    policy, belief = policy_for(model), recollection.belief
    for action in range(len(model.action_space)):
        expected = belief @ model.rewards[:, action]
        for observation in range(len(model.observation_space)):
            after = belief @ model.transition_matrix(action)
            after = after * np.asarray(model.observation_matrix(action))[:, observation]
            if horizon is None:
                expected += model.discount * after.sum() * policy.value(after / after.sum())
        assert recollection.look_ahead(action) == pytest.approx(expected)
    assert recollection.controller.digest() == before
    np.testing.assert_array_equal(recollection.belief, belief)


def test_a_recollection_begins_anew():
    recollection, other = (Recollection(controller_for(MODELS[0]), 0) for _ in range(2))
    recollection.start()
    recollection.observe(0)
    recollection.hear(1, Experience(1, 0, 1))
    recollection.hear(1, Experience(2, 0, 1))
    for each in (recollection, other):
        each.start()
        each.observe(1)
        each.observe(1)
    np.testing.assert_array_equal(recollection.belief, other.belief)


def test_memory_stays_within_the_window():
    recollection = Recollection(controller_for(MODELS[0]), 0, window=3)
    recollection.start()
    for step in range(1, 50):
        recollection.decide()
        recollection.observe(0)
        recollection.hear(1, Experience(step, 0, 0))
    assert len(recollection._marks) == 5
    assert len(recollection._did) <= 6
    assert len(recollection._saw) <= 6


def test_what_makes_no_recollection_is_refused():
    model = MODELS[0]
    plan = JointController([FiniteStateController([0], [[0, 0]], 2)] * 2)
    states = mdm.models.MDP([np.eye(2)] * 2, np.zeros((2, 2)), discount=0.9)
    cases = [
        (lambda: Recollection(controller_for(model), 2), "there is no agent 2; the model has 2"),
        (lambda: Recollection(controller_for(model), "robot7"), "the agents are robot0, robot1"),
        (lambda: Recollection(controller_for(model), 0, window=-1), "a window is a number of steps from 0 on, not -1"),
        (lambda: Recollection(controller_for(model), 0, window=1.5), "a number of steps"),
        (lambda: Recollection(Controller(plan, model), 0), "runs its own part of a plan on its own observations"),
        (lambda: Recollection(Controller([0, 1], states), 0), "for policies over beliefs, but this one is over states"),
    ]
    for make, text in cases:
        with pytest.raises(mdm.ConfigError, match=text):
            make()


def test_what_makes_no_sense_is_refused_and_changes_nothing():
    recollection = Recollection(controller_for(MODELS[0]), 0)
    with refused(mdm.ModelError):
        recollection.observe(0)
    recollection.start()
    before = recollection.controller.digest()
    cases = [
        (lambda: recollection.observe(7), "has no symbol 7"),
        (lambda: recollection.hear(0, Experience(1, 0, 0)), "'robot0' knows itself what it did and observed"),
        (lambda: recollection.hear(5, Experience(1, 0, 0)), "there is no agent 5"),
        (lambda: recollection.hear(1, Experience(0, 0, 0)), "steps with an observation count from 1"),
        (lambda: recollection.hear(1, Experience(1, 9, 0)), "has no symbol 9"),
        (lambda: recollection.hear(1, Experience(1, 0, 9)), "has no symbol 9"),
    ]
    for call, text in cases:
        with pytest.raises(mdm.ModelError, match=text):
            call()
    assert recollection.controller.digest() == before
    assert (recollection.step, recollection.statistics().heard) == (0, 0)
    nobody = Recollection(controller_for(MODELS[0]))
    nobody.start()
    with refused(mdm.ModelError):
        nobody.observe(0)


def test_steps_that_are_counted_are_not_unseen():
    """Agents that communicate count each step: an event is that of the step before, whatever it leaves unobserved."""
    with pytest.warns(mdm.ModelWarning, match="as little as 0.5"):
        model = team(4, events=True, seen=0.5)
    recollection = Recollection(controller_for(model), agent=0)
    recollection.start()
    action = recollection.decide().action
    after = [model.initial_belief @ model.joint_matrix(action, o) for o in range(len(model.observation_space))]
    expected = max(after, key=np.sum)
    own, other = model.observation_space.unravel(int(np.argmax([belief.sum() for belief in after])))
    recollection.observe(own)
    assert recollection.hear(1, Experience(step=1, action=model.action_space.unravel(action)[1], observation=other))
    recollection.decide()
    np.testing.assert_allclose(recollection.belief, expected / expected.sum(), atol=1e-12)
