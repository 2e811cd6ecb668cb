from __future__ import annotations

import asyncio
import math

import figures
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from places import EXAMPLES
from random_models import random_mdp
from sentences import refused

from mdm import (
    ConfigError,
    Ensemble,
    FixedRate,
    World,
    evaluate,
    load_model,
    load_policy,
    simulate,
)
from mdm.messages import Action, State
from mdm.models import POMDP, Factor, FactoredPOMDP, MixedPOMDP, Space
from mdm.models.factored.factoring import as_network
from mdm.policies import DeterministicPolicy, FiniteStateController, JointController, MixedAlphaVectors, RandomPolicy
from mdm.problems import dec_tiger, tiger
from mdm.recording import Record
from mdm.replay import replay
from mdm.simulation import Sampler
from mdm.simulation.world import simulated, steps_for
from mdm.solvers import solve
from mdm.testing import probe, run_virtual


@settings(max_examples=5)
@given(st.integers(0, 100))
def test_an_mdp_is_worth_what_linear_algebra_says(seed):
    model, actions = random_mdp(seed)
    moves = np.stack([model.transition_matrix(a)[s] for s, a in enumerate(actions)])
    gains = model.rewards[np.arange(4), actions]
    exact = float(model.initial_belief @ np.linalg.solve(np.eye(4) - model.discount * moves, gains))
    result = simulate(model, DeterministicPolicy(actions, 2), episodes=300, seed=seed)
    assert abs(result.mean - exact) < 5 * result.standard_error + 1e-3
    assert result.standard_error == pytest.approx(np.std(result.returns, ddof=1) / math.sqrt(300))


@pytest.mark.parametrize("episodes", [70, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("drive", [None, FixedRate(10)])
def test_tiger_is_worth_its_published_optimum(drive, episodes):
    model = load_model(EXAMPLES / "tiger.pomdp")
    policy = load_policy(EXAMPLES / "tiger.vf", model)
    result = simulate(model, policy, episodes=episodes, seed=1, drive=drive)
    assert abs(result.mean - 19.3713) < 4 * result.standard_error
    first, other = (simulate(model, policy, episodes=10, seed=seed, drive=drive) for seed in (1, 2))
    assert np.array_equal(first.returns, result.returns[:10])
    assert first.mean != other.mean


def test_steps_and_mistakes():
    assert 0.95 ** steps_for(0.95) <= 1e-4 < 0.95 ** (steps_for(0.95) - 1)
    model, actions = random_mdp(0)
    policy = DeterministicPolicy(actions, 2)
    with refused(ConfigError):
        simulate(model.with_discount(1), policy, episodes=1)
    assert simulate(model.with_discount(1), policy, episodes=2, steps=3, seed=0).steps == 3
    with refused(ConfigError):
        simulate(model, policy, episodes=0)
    with refused(ConfigError):
        World(Ensemble("robot", policy=policy, actions={0: print, 1: print}))


def test_who_is_told_of_progress_may_end_a_simulation():
    told = []
    given = (EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf")
    whole = simulate(*given, episodes=8, steps=4, seed=3)
    part = simulate(*given, episodes=8, steps=4, seed=3, progress=lambda *counts: told.append(counts) or len(told) == 5)
    np.testing.assert_array_equal(part.returns, whole.returns[:5])
    assert told == [(count, 8) for count in range(1, 6)]


@pytest.mark.parametrize("drive", [None, FixedRate(10)])
def test_a_joint_plan_is_worth_what_its_solver_says(drive):
    model = dec_tiger()
    solution = solve(model, "jesp", horizon=3)
    result = simulate(model, solution.policy, episodes=4000, seed=1, drive=drive)
    assert result.steps == 3
    assert abs(result.mean - solution.lower) < 4 * result.standard_error
    assert result.standard_error < 0.5


@pytest.mark.parametrize("episodes", [150, pytest.param(600, marks=pytest.mark.slow)])
def test_a_controller_is_worth_what_its_nodes_say(episodes):
    model, policy = tiger(), figures.tiger_plan()
    result = simulate(model, policy, episodes=episodes, seed=3)
    assert abs(result.mean - policy.value(model.initial_belief)) < 4 * result.standard_error


def test_an_episode_ends_with_the_plan_whichever_way_it_goes():
    model = POMDP([[[1.0]]], [[[0.5, 0.5]]], [[1.0]], discount=1.0)
    # after observation 0 the plan is over, after 1 it goes on once more
    policy = FiniteStateController([0, 0, 0], [[1, 2], [None, None], [1, 1]])
    result = simulate(model, policy, episodes=200, seed=1)
    assert set(result.returns) == {2.0, 3.0}


def test_a_part_of_a_team_is_no_worlds_whole():
    model = dec_tiger()
    team = JointController([FiniteStateController([0], [[0, 0]], 3)] * 2)
    robot = Ensemble("robot", policy=team, model=model, local=True, actions=dict.fromkeys(range(3), print))
    with refused(ConfigError):
        World(robot)


def test_robots_that_run_their_own_parts_are_worth_what_the_team_is():
    model = dec_tiger()
    solution = solve(model, "jesp", horizon=3)
    sampler = Sampler(model, seed=5)
    returns = []

    async def main(runtime):
        decided = [0, 0]
        robots = [
            Ensemble(
                f"robot{agent}",
                policy=solution.policy,
                model=model,
                agent=agent,
                local=True,
                actions=dict.fromkeys(range(3), lambda: None),
            )
            for agent in range(2)
        ]
        for agent, robot in enumerate(robots):
            take = lambda action, agent=agent: decided.__setitem__(agent, action.index)
            runtime.channel(f"{robot.name}/action", Action).subscribe(take)
            await runtime.start(robot)
        for _episode in range(2500):
            state, total = sampler.first_state(), 0.0
            for _ in range(3):
                action = model.action_space.ravel(decided)
                total += model.rewards[state, action]
                before, state = state, sampler.next_state(state, action)
                seen = model.observation_space.unravel(sampler.observation(action, before, state))
                for robot, own in zip(robots, seen, strict=True):
                    robot.publish_observation(own)  # the last one begins the next episode
            assert [robot.controller.epoch for robot in robots] == [1, 1]
            returns.append(total)

    run_virtual(main)
    error = np.std(returns) / math.sqrt(len(returns))
    assert abs(np.mean(returns) - solution.lower) < 4 * error


@pytest.mark.parametrize("drive", [None, FixedRate(10)])
def test_what_is_seen_of_the_first_state_is_known_at_the_first_decision(drive):
    """A switch and a lamp that nobody sees, which stay as they are: the action that names the switch's place earns."""
    states = Space([Factor("switch", 2), Factor("lamp", 2)])
    rewards = np.repeat(np.eye(2), 2, axis=0)
    flat = POMDP([np.eye(4)] * 2, [np.full((4, 2), 0.5)] * 2, rewards, discount=0.5, states=states)
    model = MixedPOMDP(FactoredPOMDP(as_network(flat), discount=0.5), [0])
    policy = MixedAlphaVectors([[1, 1], [0, 0], [0, 0], [1, 1]], [0, 1, 0, 1], [0, 0, 1, 1], states=model.layout)
    result = simulate(model, policy, episodes=50, steps=2, seed=1, drive=drive)
    assert list(result.returns) == [1.5] * 50
    assert result.mean == evaluate(model, policy, episodes=50, steps=2, seed=1).mean


def test_a_controller_without_values_is_told_nothing_of_the_first_state():
    flat = POMDP([np.eye(2)], [np.full((2, 2), 0.5)], np.zeros((2, 1)), discount=0.5, states=Space([Factor("lamp", 2)]))
    model = MixedPOMDP(FactoredPOMDP(as_network(flat), discount=0.5), [0])

    async def main(runtime):
        faults = probe(runtime.faults)
        robot = Ensemble(
            "robot", policy=FiniteStateController([0], [[0] * 4]), model=model, actions={0: lambda: None}, horizon=2
        )
        await runtime.start(World(robot, seed=1))
        await runtime.start(robot)
        await asyncio.sleep(9.5)
        assert robot.control.statistics().decisions == 10
        assert not list(faults)

    run_virtual(main)


def test_a_record_has_the_true_states_by_which_returns_come_about(tmp_path):
    file = tmp_path / "simulated.mcap"
    result = simulate(tiger(), EXAMPLES / "tiger.vf", episodes=5, steps=20, seed=3, record=file)
    model, record = tiger(), Record(file)
    state, returns, value, weight = None, [], 0.0, 1.0
    for each in record.messages(["ensemble/true_state", "decisions"]):
        if isinstance(each.message, State):
            state = each.message.index
        else:
            value += weight * model.rewards[state, each.message.action]
            weight *= model.discount
            if each.message.epoch == 19:
                returns.append(value)
                value, weight = 0.0, 1.0
    assert returns == pytest.approx(list(result.returns), abs=1e-12)


@pytest.mark.parametrize("seed", [None, 4])
def test_a_recorded_simulation_is_replayed_also_where_a_policy_draws_without_a_seed(tmp_path, seed):
    file = tmp_path / "simulated.mcap"
    policy = RandomPolicy(num_actions=3, num_states=2)
    options = {} if seed is None else {"seed": seed}
    simulate(tiger(), policy, episodes=3, steps=10, record=file, **options)
    again = simulated(tiger(), RandomPolicy(num_actions=3, num_states=2), steps=10)
    replayed = replay(file, again)
    assert (replayed.recorded, replayed.replayed, replayed.same) == (30, 30, True)
    assert len({each.message.action for each in Record(file).messages(["decisions"])}) > 1
