from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

import mdm
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.policies import DeterministicPolicy, QTable, StochasticPolicy


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 4))
def test_a_q_table_takes_the_first_of_the_best(seed, states, actions):
    values = np.random.default_rng(seed).integers(0, 3, size=(states, actions)).astype(float)
    policy = QTable(values)
    for state in range(states):
        best = max(values[state])
        assert policy.action(state) == list(values[state]).index(best)
        assert policy.value(state) == best


def test_a_stochastic_policy_draws_by_its_probabilities_and_is_reproducible():
    probabilities = [[0.2, 1.0], [0.5, 0.0], [0.3, 0.0]]
    first, second = (StochasticPolicy(probabilities, seed=5) for _ in range(2))
    draws = [first.action(0) for _ in range(20_000)]
    assert draws == [second.action(0) for _ in range(20_000)]
    np.testing.assert_allclose(np.bincount(draws) / len(draws), [0.2, 0.5, 0.3], atol=0.02)
    assert {first.action(1) for _ in range(100)} == {0}
    first.seed(5)
    assert [first.action(0) for _ in range(10)] == draws[:10]


@pytest.mark.parametrize(
    ("policy", "states"),
    [(DeterministicPolicy([0, 1]), 2), (QTable([[0, 1]]), 1), (StochasticPolicy([[1, 1, 1]]), 3)],
)
def test_a_state_beyond_the_policy_is_named(policy, states):
    for state in (states, -1):
        with refused(ModelError):
            policy.action(state)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DeterministicPolicy([]), "at least one state"),
        (lambda: DeterministicPolicy([0, 2], 2), "entry for state 1 is 2, but its actions are 0 to 1"),
        (lambda: DeterministicPolicy([-1]), "state 0 is -1"),
        (lambda: DeterministicPolicy([0, 0.5]), "entry for state 1 is 0.5, but an action's index is needed"),
        (lambda: QTable([[0], [1, 2]]), "the Q-table is not an array of numbers"),
        (lambda: StochasticPolicy([[0.5, 0.5], [0.5, 0.9]]), "state 1 are not a distribution: 0.5, 0.9 sum to 1.4"),
        (lambda: StochasticPolicy([[1.5], [-0.5]]), "state 0"),
        (lambda: StochasticPolicy([1.0]), "actions x states"),
        (lambda: QTable([[0, np.nan]]), "action 1 in state 0 is NaN"),
        (lambda: QTable([]), "states x actions"),
    ],
)
def test_wrong_tables_are_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_values_that_are_not_known_are_not_made_up():
    with refused(ModelError):
        DeterministicPolicy([0]).value(0)


def test_an_action_of_probability_zero_is_never_drawn():
    """Ten tenths fall short of one; the gap belongs to the last action that may be drawn, not to the last."""
    policy = StochasticPolicy([[0.1]] * 10 + [[0.0]])

    class Largest:
        def random(self):
            return np.nextafter(1.0, 0.0)

    policy._generator = Largest()
    assert policy.action(0) == 9


@pytest.mark.parametrize("name", ["policy.npz", "policy"])
def test_a_policy_takes_the_names_of_its_model(tmp_path, name):
    stay, go = [[1, 0], [0, 1]], [[0.2, 0.8], [0, 1]]
    model = MDP([stay, go], [[0, -1], [5, 4]], discount=0.9, states=["home", "work"], actions=["stay", "go"])
    solved = mdm.solve(model).policy
    mdm.save_policy(solved, tmp_path / name, model)
    loaded = mdm.load_policy(tmp_path / name, model)
    for policy in (solved, loaded):
        assert [policy.action("home"), policy.action("work")] == [policy.action(0), policy.action(1)] == [1, 0]
        with refused(ModelError):
            policy.action("hme")
    for nameless in (QTable([[0, 1], [1, 0]]), DeterministicPolicy([0, 1])):
        with refused(ModelError):
            nameless.action("home")
