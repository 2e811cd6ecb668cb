"""Construction: what a controller takes from its options. What fits no policy is refused: see test_controller."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from sentences import refused

import mdm
from mdm.controller import Controller
from mdm.controller.controller import horizon_of, reward_rows, seeded, with_false_negatives
from mdm.policies import RandomPolicy, StagedPolicy
from mdm.problems import tiger
from mdm.symbols import Symbols


def test_a_horizon_is_at_most_the_policy_s_stages():
    information = StagedPolicy(np.zeros((3, 2, 3))).information(tiger())
    assert [horizon_of(information, given) for given in (None, 1, 3)] == [3, 1, 3]
    with refused(mdm.ConfigError):
        horizon_of(information, 4)


def test_rewards_are_rows_by_action_of_what_is_given_or_else_of_the_model():
    model = tiger()
    symbols = Symbols(RandomPolicy(3, 2, input="state"), model, None)
    given = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(reward_rows(given, model, symbols), given.T)
    np.testing.assert_array_equal(reward_rows(None, model, symbols), model.rewards.T)
    assert reward_rows(None, None, symbols) is None
    given[1, 2] = np.inf
    for wrong, words in (
        (given, "the reward of action 2 in state 1 is inf"),
        ([1.0, 2.0], r"not of shape \(2,\)"),
        ([[1.0], [2.0]], "for 2 states and 1 actions, but the policy is for 2 and 3"),
    ):
        with pytest.raises(mdm.ConfigError, match=words) as caught:
            reward_rows(wrong, model, symbols)
        assert caught.value.key == "rewards"


def test_a_seed_leaves_the_policy_that_was_given_as_it_is():
    given = RandomPolicy(50, 2, input="state")
    one, other = seeded(given, 3), seeded(given, 3)
    assert one is not given
    assert [one.action(0) for _ in range(9)] == [other.action(0) for _ in range(9)]


def test_false_negatives_are_the_model_s():
    model = with_false_negatives(tiger(), "hear-left")
    assert model is not None
    assert Controller(mdm.policies.AlphaVectors([[0.0, 0.0]], [0], 3), model).belief is not None
    for wrong in (None, mdm.models.MDP([[[1.0]]], [[0.0]], discount=0.9)):
        with refused(mdm.ConfigError):
            with_false_negatives(wrong, "hear-left")


def fires(team=2):
    return mdm.problems.fire_fighting(houses=3, team=team, discount=0.9)


def vectors(model, seed=0):
    """Return a policy that chooses among many actions by beliefs."""
    random = np.random.default_rng(seed)
    actions = random.permutation(len(model.action_space))[:9]
    return mdm.policies.AlphaVectors(
        random.normal(size=(len(actions), len(model.state_space))), actions.tolist(), len(model.action_space)
    )


def test_a_controller_with_little_memory_decides_as_one_of_matrices(monkeypatch):
    """Beliefs, probabilities, rewards and actions are the same, also where agents have seen nothing."""
    monkeypatch.setattr("mdm.models.factored.model._SMALL", 0)
    model, policy = fires(3), vectors(fires(3))
    spare, plain = Controller(policy, model, memory=100), Controller(policy, fires(3).flatten())
    assert spare.model.stays_factored
    random = np.random.default_rng(1)
    steps = [controller.start() for controller in (spare, plain)]
    for _ in range(30):
        one, other = steps
        assert one.action == other.action
        assert one.reward == pytest.approx(other.reward, abs=1e-12)
        assert one.probability == pytest.approx(other.probability, abs=1e-12)
        np.testing.assert_allclose(spare.belief, plain.belief, atol=1e-12)
        seen = [None if random.random() < 0.3 else int(random.integers(2)) for _ in range(3)]
        steps = [controller.observe(seen) for controller in (spare, plain)]
    assert not model.is_flattened


def test_six_fire_fighters_decide_without_matrices():
    """As matrices they would take gigabytes; the whole takes less than a hundred megabytes."""
    model = fires(6)
    assert model.matrix_size.total > 2e9
    policy = mdm.policies.ConstantPolicy(5, len(model.action_space), len(model.state_space))
    tracemalloc.start()
    controller = Controller(policy, model, memory=1000)
    step = controller.start()
    for seen in ([0, 1, 0, 1, 0, 1], [1, None, 0, None, 1, 1], None):
        step = controller.observe(seen)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100e6
    assert not controller.model.is_flattened
    assert not model.is_flattened
    assert -6 < step.reward < 0
    assert controller.belief.sum() == pytest.approx(1)


def test_policies_over_states_earn_what_the_matrices_say(monkeypatch):
    monkeypatch.setattr("mdm.models.factored.model._SMALL", 0)
    network = fires().network
    mdp = mdm.models.FactoredMDP(
        mdm.models.TwoSliceNetwork(
            network.states,
            network.actions,
            initial=network.initial,
            transitions=network.transitions,
            utilities=network.utilities,
        ),
        discount=0.9,
    )
    policy = mdm.policies.ConstantPolicy(4, 9, len(mdp.state_space), input="state")
    spare, plain = Controller(policy, mdp, memory=100), Controller(policy, mdp)
    for state in (0, 17, 431):
        assert spare.see(state).reward == pytest.approx(plain.see(state).reward, abs=1e-12)
    assert spare.model.stays_factored


def test_rewards_of_the_model_are_part_of_its_digest_and_others_count():
    policy = RandomPolicy(3, 2, seed=1)
    plain, own = Controller(policy, tiger()), Controller(policy, tiger(), rewards=tiger().rewards * 2)
    assert plain.configuration != own.configuration
    assert Controller(policy, tiger()).configuration == plain.configuration


def test_a_plan_needs_no_matrices_and_is_never_refused():
    plan = mdm.policies.FiniteStateController([0], [[0] * 64], 729)
    controller = Controller(plan, fires(6), memory=1)
    assert controller.start().action == 0
    assert not controller.model.is_flattened
