"""Communication policies: what each shares when, and what each refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm.policies import AlphaVectors
from mdm.team import Always, Budget, Knowledge, Never, OnChange, ValueOfCommunication

TIGER = mdm.problems.dec_tiger(discount=0.9)
CAREFUL = AlphaVectors([[9, 9], [0, 10], [10, 0]], [0, 4, 8], 9)
"""Opens from 0.9 on."""
LEFT, RIGHT = 0, 1


def shared(communication, observations, *, period=1.0):
    """Return for each observation the steps that agent 0 shares after it, alone."""
    agent = Knowledge(CAREFUL, TIGER, 0, communication)
    result = []
    for number, observation in enumerate(observations, 1):
        agent.decide()
        agent.observe(observation)
        said = agent.share(number * period)
        result.append([] if said is None else [each.step for each in said.experiences])
    return result


def test_always_and_never():
    assert shared(Always(), [LEFT, LEFT, None, RIGHT]) == [[1], [2], [3], [4]]
    assert shared(Never(), [LEFT, LEFT, None, RIGHT]) == [[], [], [], []]


def test_on_change():
    assert shared(OnChange(), [LEFT, LEFT, LEFT, RIGHT, RIGHT, None, LEFT]) == [[1], [], [], [2, 3, 4], [], [5, 6], [7]]


@given(
    rate=st.floats(0.05, 5),
    burst=st.integers(1, 3),
    observations=st.lists(st.sampled_from([LEFT, RIGHT]), min_size=1, max_size=30),
    of=st.sampled_from([None, OnChange()]),
)
def test_a_budget_keeps_its_bound_and_loses_nothing(rate, burst, observations, of):
    said = shared(Budget(rate, of, burst=burst), observations)
    times = [number for number, steps in enumerate(said, 1) if steps]
    for first, begin in enumerate(times):
        for last in range(first, len(times)):
            assert last - first + 1 <= burst + rate * (times[last] - begin) + 1e-6
    steps = [step for part in said for step in part]
    assert steps == list(range(1, len(steps) + 1))


def test_the_value_of_communication_is_that_of_the_changed_decision():
    policy = ValueOfCommunication(0.0)
    agent = Knowledge(CAREFUL, TIGER, 0, policy)
    agent.decide()
    agent.observe(LEFT)
    assert policy.worth(agent) == 0  # both go on listening
    assert agent.share(1.0) is None
    agent.decide()
    agent.observe(LEFT)
    left = 0.85**2 / (0.85**2 + 0.15**2)
    both = 20 * left - 50 * (1 - left)  # open-right, the tiger being on the left
    alone = 9 * left - 101 * (1 - left)
    # Whoever opens, the tiger is put behind a door at random, and what follows is the same.
    assert policy.worth(agent) == pytest.approx(both - alone)
    assert len(agent.share(2.0).experiences) == 2
    assert policy.worth(agent) == 0


@pytest.mark.parametrize(("threshold", "speaks"), [(12, True), (13, False)])
def test_the_threshold_is_in_units_of_the_reward(threshold, speaks):
    assert shared(ValueOfCommunication(threshold), [LEFT, LEFT]) == [[], [1, 2] if speaks else []]


def test_the_threshold_counts_for_a_budget_too():
    chosen = Budget(0.2, ValueOfCommunication(1.0))
    assert chosen.uses_common_belief
    assert shared(chosen, [LEFT, LEFT, RIGHT, RIGHT]) == [[], [1, 2], [], []]


def test_what_silence_costs_is_known_from_both_beliefs():
    """An agent that hears of another's history speaks if its own gives another decision."""
    agents = [Knowledge(CAREFUL, TIGER, agent, ValueOfCommunication(1.0)) for agent in range(2)]
    for _ in range(2):
        for agent, symbol in zip(agents, (LEFT, RIGHT), strict=True):
            agent.decide()
            agent.observe(symbol)
    first, second = (agent.share(2.0) for agent in agents)
    assert first is not None
    assert second is not None
    agents[0].hear(second)
    agents[1].hear(first)
    for agent in agents:
        np.testing.assert_allclose(agent.belief, [0.5, 0.5])
        np.testing.assert_allclose(agent.common_belief, [0.5, 0.5])
        assert agent.decide().action_name == "listen listen"


@pytest.mark.parametrize("threshold", [-1, math.nan, math.inf, True, "1", None])
def test_thresholds_that_are_none(threshold):
    with refused(mdm.ConfigError):
        ValueOfCommunication(threshold)


def test_budgets_that_are_none():
    with refused(mdm.ConfigError):
        Budget(0)
    with refused(mdm.ConfigError):
        Budget(1, burst=0)
    with refused(mdm.ConfigError):
        Budget(1, 3)


@pytest.mark.parametrize("wrapped", [lambda policy: policy, lambda policy: Budget(1.0, policy)])
def test_the_value_of_communication_needs_values_and_steps(wrapped):
    for policy, model, text in (
        (RandomBeliefs(), TIGER, "the value of communication needs a policy with values"),
        (CAREFUL, by_events(TIGER), "it needs a model without event observations"),
    ):
        with pytest.raises(mdm.ConfigError, match=text):
            Knowledge(policy, model, 0, wrapped(ValueOfCommunication(1.0)))


def by_events(model):
    """Return the same model with its observations as those of events."""
    actions, size = range(len(model.action_space)), len(model.state_space)
    told = [np.repeat(np.asarray(model.observation_matrix(a)).T[:, None, :], size, axis=1) for a in actions]
    names = {"actions": model.action_space, "observation_names": model.observation_space}
    moves = [np.asarray(model.transition_matrix(a)) for a in actions]
    return mdm.models.POMDP(moves, told, model.rewards, discount=0.9, event_observations=True, **names)


class RandomBeliefs(mdm.policies.BeliefPolicy):
    num_states, num_actions = 2, 9

    def action(self, belief):
        return 0
