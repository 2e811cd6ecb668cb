"""Solvers, policies, evaluation and simulation where not all actions are available, against own computations."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

import mdm
from mdm.errors import ConfigError, ModelError
from mdm.models import MDP, POMDP, Durations
from mdm.policies import (
    ConstantPolicy,
    DeterministicPolicy,
    FiniteStateController,
    MaskedAlphaVectors,
    QTable,
    RandomPolicy,
)
from mdm.solvers import TreeSearch

MDP_SOLVERS = ["value-iteration", "prioritised-sweeping", "policy-iteration", "modified-policy-iteration"]


def random_mdp(seed, kind=MDP):
    """Return a random model of 6 states and 4 actions; if it is hidden, observations tell in which half it is."""
    random = np.random.default_rng(seed)
    available = random.random((6, 4)) < 0.5
    available[np.arange(6), random.integers(4, size=6)] = True
    transitions = random.dirichlet(np.ones(6), size=(4, 6))
    rewards = random.normal(size=(6, 4))
    rewards[~available] = -np.inf
    options = {"discount": 0.5, "initial_belief": [0.5, 0.25, 0.25, 0, 0, 0]}
    if kind is MDP:
        return MDP(transitions, rewards, available=available, **options)
    available = np.repeat(available[[0, 3]], 3, axis=0)
    rewards = np.where(available, random.normal(size=(6, 4)), -np.inf)
    noise = random.dirichlet(np.ones(2), size=(4, 6))
    seen = np.zeros((4, 6, 4))
    seen[:, :3, :2], seen[:, 3:, 2:] = noise[:, :3], noise[:, 3:]
    return POMDP(transitions, seen, rewards, available=available, **options)


def optimal(model, discounts=0.5):
    """Return the optimal values by plain backups over the available actions."""
    values = np.zeros(len(model.state_space))
    moves = np.array([model.transition_matrix(a) for a in range(4)])
    for _ in range(100):
        table = model.rewards + discounts * np.einsum("ast,t->sa", moves, values)
        values = np.where(model.available, table, -np.inf).max(axis=1)
    return values


@pytest.mark.parametrize("solver", MDP_SOLVERS)
@pytest.mark.parametrize("seed", range(5))
def test_policies_of_states_are_optimal_among_available_actions(solver, seed):
    model = random_mdp(seed)
    solution = mdm.solve(model, solver=solver, gap=1e-9)
    policy, want = solution.policy, optimal(model)
    assert solution.lower == pytest.approx(model.initial_belief @ want, abs=1e-7)
    assert all(model.available[state, policy.action(state)] for state in range(6))
    assert [policy.value(state) for state in range(6)] == pytest.approx(want, abs=1e-7)
    assert mdm.solvers.state_values(model, policy) == pytest.approx(want, abs=1e-7)
    assert abs(mdm.evaluate(model, policy, episodes=2000, seed=1).mean - solution.lower) < 0.3


def test_plans_to_a_horizon_and_with_durations():
    model = random_mdp(3)
    plan = mdm.solve(model, solver="value-iteration", horizon=3).policy
    assert all(model.available[s, plan.action(s, stage=stage)] for s in range(6) for stage in range(3))
    model = model.with_discount(model.discount, of="second")
    durations = Durations(np.random.default_rng(1).uniform(0.5, 3, size=(6, 4)))
    policy = mdm.solve(model, durations=durations, gap=1e-9).policy
    want = optimal(model, durations.discounts(model))
    assert [policy.value(state) for state in range(6)] == pytest.approx(want, abs=1e-6)
    assert all(model.available[state, policy.action(state)] for state in range(6))


def best(model, belief, depth):
    """Return the value of a belief by enumeration of available actions and observations."""
    if not depth:
        return 0.0
    values = []
    for action in np.flatnonzero(model.available[belief > 0].all(axis=0)):
        value = belief @ model.rewards[:, action]
        after = belief @ model.transition_matrix(action)
        for seen in model.observation_matrix(action).T:
            joint = after * seen
            if joint.sum() > 0:
                value += model.discount * joint.sum() * best(model, joint / joint.sum(), depth - 1)
        values.append(value)
    return max(values)


@pytest.mark.parametrize("solver", ["sarsop", "perseus"])
@pytest.mark.parametrize("seed", [0, 2])
def test_policies_of_beliefs_choose_available_actions_and_keep_their_bounds(solver, seed):
    model = random_mdp(seed, POMDP)
    solution = mdm.solve(model, solver=solver, gap=0.02, **({"seed": 1} if solver == "perseus" else {}))
    tail = 0.5**4 * np.abs(model.rewards).max() / 0.5
    want = best(model, np.asarray(model.initial_belief), 4)
    assert solution.lower - tail <= want <= solution.upper + tail
    assert isinstance(solution.policy, MaskedAlphaVectors)
    told = mdm.evaluate(model, solution.policy, episodes=1000, seed=1)  # refuses what is not available
    assert told.interval[1] > solution.lower - 1e-3
    assert told.interval[0] < solution.upper + 1e-3


@pytest.mark.parametrize("solver", ["qmdp", "fib"])
def test_upper_bounds_choose_available_actions(solver):
    model = random_mdp(1, POMDP)
    solution = mdm.solve(model, solver=solver)
    assert (
        solution.upper >= best(model, np.asarray(model.initial_belief), 4) - 0.5**4 * np.abs(model.rewards).max() / 0.5
    )
    mdm.evaluate(model, solution.policy, episodes=500, seed=1)


def test_a_belief_in_time(tmp_path):
    model = random_mdp(1, POMDP)
    model = model.with_discount(model.discount, of="second")
    solution = mdm.solve(model, durations=Durations([[1.0, 2.0, 0.5, 1.0]] * 6), gap=0.01, time=20)
    told = mdm.evaluate(model, solution.policy, durations=Durations([[1.0, 2.0, 0.5, 1.0]] * 6), episodes=500, seed=1)
    assert told.interval[1] > solution.lower - 0.01
    mdm.save_policy(solution.policy, tmp_path / "p.npz", model)
    assert mdm.load_policy(tmp_path / "p.npz", model).actions == solution.policy.actions


def test_solvers_that_cannot_know_it_refuse():
    model = random_mdp(1, POMDP)
    for options in ({"solver": "jesp"}, {"solver": "perseus", "horizon": 3}):
        with refused(ConfigError):
            mdm.solve(model, **options)
    with refused(ConfigError):
        mdm.solve(model.with_discount(1.0))
    with refused(ConfigError):
        TreeSearch(model, seconds=1.0)


def unavailable(model):
    """Return a state and an action that is not available there."""
    return tuple(int(each) for each in np.argwhere(~model.available)[0])


def test_policies_that_choose_what_is_not_available_are_refused():
    model = random_mdp(0)
    state, action = unavailable(model)
    actions = model.available.argmax(axis=1).tolist()
    mdm.Controller(DeterministicPolicy(actions, 4), model)
    actions[state] = action
    values = np.zeros((6, 4))
    values[state, action] = 1
    for policy in (DeterministicPolicy(actions, 4), QTable(values), RandomPolicy(4, 6, input="state")):
        with refused(ConfigError):
            mdm.Controller(policy, model)
        with refused(ModelError):
            mdm.solvers.state_values(model, policy)
    with refused(ConfigError):
        mdm.Controller(FiniteStateController([0], [[0, 0, 0, 0]], 4), random_mdp(0, POMDP))


def test_the_controller_refuses_an_action_at_a_belief_and_takes_others():
    model = random_mdp(0, POMDP)
    _, action = (int(each) for each in np.argwhere(~model.available[:3])[0])
    with refused(ModelError):
        mdm.Controller(ConstantPolicy(action, 4, 6), model).start()
    fine = int(model.available[0].argmax())
    assert mdm.Controller(ConstantPolicy(fine, 4, 6), model).start().action == fine
    with refused(ModelError):
        mdm.evaluate(model, ConstantPolicy(action, 4, 6), episodes=10, seed=1)


def test_an_action_of_elsewhere_is_looked_at_too():
    model = random_mdp(0)
    state, action = unavailable(model)
    controller = mdm.Controller(mdm.solve(model).policy, model)
    controller.information.update(None, state)
    with refused(ModelError):
        controller.decide(action)
