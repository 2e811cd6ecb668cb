"""Simulated communicating teams: with everything shared they are one; messages, losses and delays are counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused
from teams import team

import mdm
from mdm.controller import Controller
from mdm.policies import AlphaVectors
from mdm.simulation import evaluate_communication
from mdm.simulation.sampler import Sampler
from mdm.team import Always, Budget, Knowledge, Never, OnChange, ValueOfCommunication

TIGER = mdm.problems.dec_tiger(discount=0.9)
CAREFUL = AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8], 9)
"""Opens from 0.9 on."""


def random_policy(model, seed):
    random = np.random.default_rng(seed)
    size, actions = len(model.state_space), len(model.action_space)
    return AlphaVectors(random.normal(size=(12, size)), random.integers(actions, size=12), actions)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), agents=st.integers(2, 3), in_turn=st.booleans())
def test_agents_that_always_share_decide_as_one(seed, agents, in_turn):
    """The joint actions, and so the returns, are those of the team's controller on joint observations."""
    model = team(seed, agents=agents, states=3)
    policy = random_policy(model, seed)
    found = evaluate_communication(model, policy, Always(), episodes=3, steps=8, seed=seed, in_turn=in_turn)
    assert found.messages.tolist() == [7 * agents] * 3
    sampler, controller, returns = Sampler(model), Controller(policy, model), []
    for stream in np.random.SeedSequence(seed).spawn(3):
        sampler.seed(stream.spawn(2)[0])
        state, step, total, weight = sampler.first_state(), controller.start(), 0.0, 1.0
        for _ in range(8):
            total += weight * float(model.rewards[state, step.action])
            weight *= model.discount
            before, state = state, sampler.next_state(state, step.action)
            step = controller.observe(sampler.observation(step.action, before, state))
        returns.append(total)
    assert found.returns.tolist() == returns


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_agents_that_always_share_all_decide_on_the_team_s_belief(seed):
    model = team(seed, agents=3, states=3)
    policy = random_policy(model, seed)
    random = np.random.default_rng(seed)
    agents = [Knowledge(policy, model, agent, Always()) for agent in range(3)]
    controller = Controller(policy, model)
    step = controller.start()
    for number in range(1, 10):
        assert [agent.decide().action for agent in agents] == [step.action] * 3
        observation = int(random.integers(8))
        for agent, symbol in zip(agents, model.observation_space.unravel(observation), strict=True):
            agent.observe(symbol)
        said = [agent.share(float(number)) for agent in agents]
        for agent in agents:
            for history in random.permutation(3):
                if history != agent.agent:
                    agent.hear(said[history])
        step = controller.observe(observation)
        for agent in agents:
            np.testing.assert_allclose(agent.belief, controller.belief, atol=1e-12)


def test_silence_has_no_messages():
    found = evaluate_communication(TIGER, CAREFUL, Never(), episodes=20, steps=10, seed=1)
    assert found.messages.sum() == found.messages_per_step == found.lost == 0


def test_a_value_of_communication_returns_more_than_silence_for_less_than_all_messages():
    solved = mdm.solve(TIGER, gap=0.1).policy
    never, always, valued = (
        evaluate_communication(TIGER, solved, each, episodes=100, steps=20, seed=1)
        for each in (Never(), Always(), ValueOfCommunication(1.0))
    )
    assert valued.messages.sum() < always.messages.sum()
    assert valued.mean - never.mean > 0.9 * (always.mean - never.mean)
    assert always.messages_per_step == 2


def test_in_turn_nobody_says_what_is_clear_by_now():
    together, turns = (
        evaluate_communication(TIGER, CAREFUL, ValueOfCommunication(1.0), episodes=50, steps=20, seed=1, in_turn=each)
        for each in (False, True)
    )
    assert turns.messages.sum() < 0.8 * together.messages.sum()


def test_the_same_seed_gives_the_same_result():
    one, same, other = (
        evaluate_communication(TIGER, CAREFUL, OnChange(), episodes=10, steps=10, seed=seed, loss=0.3, delay=1)
        for seed in (3, 3, 4)
    )
    assert one.returns.tolist() == same.returns.tolist()
    assert one.messages.tolist() == same.messages.tolist()
    assert (one.lost, one.seed) == (same.lost, 3)
    assert one.returns.tolist() != other.returns.tolist()


def test_lost_messages_are_counted():
    lossless, some, none = (
        evaluate_communication(TIGER, CAREFUL, Always(), episodes=20, steps=10, seed=1, loss=loss)
        for loss in (0.0, 0.5, 1.0)
    )
    assert lossless.lost == 0
    assert 0 < some.lost < none.lost == none.messages.sum()
    silent = evaluate_communication(TIGER, CAREFUL, Never(), episodes=20, steps=10, seed=1)
    assert none.returns.tolist() == silent.returns.tolist()


def test_what_comes_after_the_window_is_counted_and_counts_not():
    late = evaluate_communication(TIGER, CAREFUL, Always(), episodes=5, steps=10, seed=1, delay=3, window=2)
    silent = evaluate_communication(TIGER, CAREFUL, Never(), episodes=5, steps=10, seed=1)
    assert late.too_late == 5 * 2 * (9 - 3)
    assert late.returns.tolist() == silent.returns.tolist()
    in_time = evaluate_communication(TIGER, CAREFUL, Always(), episodes=5, steps=10, seed=1, delay=3, window=3)
    assert in_time.too_late == 0


def test_budgets_begin_anew_with_each_episode_and_go_by_the_period():
    found = evaluate_communication(TIGER, CAREFUL, Budget(1.0), episodes=3, steps=21, seed=1, period=0.5)
    assert found.messages.tolist() == [20] * 3  # of each agent one at every other step


def test_what_makes_no_sense_is_refused():
    for options, text in (
        ({"episodes": 0}, "episodes: a whole number from 1 on is needed, not 0"),
        ({"steps": 0}, "steps: a whole number from 1 on"),
        ({"delay": -1}, "delay: a whole number from 0 on"),
        ({"delay": 0.5}, "from 0 on is needed, not 0.5"),
        ({"loss": 1.5}, "a loss is a probability, not 1.5"),
        ({"period": 0}, "a period is a positive number of seconds, not 0"),
    ):
        with pytest.raises(mdm.ConfigError, match=text):
            evaluate_communication(TIGER, CAREFUL, Always(), **options)
    with refused(mdm.ConfigError):
        evaluate_communication(TIGER.with_false_negatives(0), CAREFUL, Always())
    with refused(mdm.ConfigError):
        evaluate_communication(mdm.problems.dec_tiger(), CAREFUL, Always())
