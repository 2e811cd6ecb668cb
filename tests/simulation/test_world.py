"""A model as the world of an ensemble."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from random_models import random_mdp
from sentences import refused

from mdm import (
    ActorFailure,
    ConfigError,
    Ensemble,
    FixedRate,
    ModelError,
    PredicateManager,
    StateFactor,
    World,
    problems,
    simulate,
    solve,
)
from mdm.messages import Reward, State
from mdm.models import MDP, POMDP, Durations, Factor, Space
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.testing import capture_decisions, run_virtual


def test_a_world_sets_predicates_and_takes_its_time():
    model, _ = random_mdp(1, states=4)

    async def main(runtime):
        manager = PredicateManager()
        for name in ("A", "B"):
            manager.sensor(name)

        named = MDP(
            [model.transition_matrix(a) for a in range(2)],
            model.rewards,
            discount=0.8,
            states=Space([Factor("a", 2), Factor("b", 2)]),
        )
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1, 0, 1]),
            model=named,
            actions={0: lambda: None, 1: lambda: None},
            predicates=manager,
            states=[StateFactor("a", ["A"]), StateFactor("b", ["B"])],
        )
        world = World(robot, seed=4, period=0.5)
        await runtime.start(manager)
        await runtime.start(world)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            for _ in range(20):
                await runtime.clock.sleep(0.5)
                values = manager.values()
                assert decisions[-1].state == 2 * values["A"] + values["B"]
        assert [decision.time for decision in decisions] == [index * 500_000_000 for index in range(len(decisions))]
        assert len(decisions) >= 20

    run_virtual(main)


def test_an_episode_in_which_nothing_is_observed_any_more_ends_with_a_fault():
    """Every step is a false negative."""
    told = np.zeros((1, 2, 2, 2))
    told[0, 0] = 1
    model = POMDP([np.eye(2)], told, [[1.0], [1.0]], discount=0.5, event_observations=True)
    model, policy = model.with_false_negatives(0), AlphaVectors([[0.0, 0.0]], [0], 1)
    result = simulate(model, policy, episodes=3, seed=1, steps=5)
    assert result.returns == pytest.approx((2.0, 2.0, 2.0))  # 1 + 0.5 + 0.25 + ..., with no second decision

    async def main(runtime):
        ensemble = Ensemble("robot", policy=policy, model=model, actions={"0": lambda: None})
        faults = []
        runtime.faults.subscribe(faults.append)
        await runtime.start(World(ensemble, seed=1))
        with capture_decisions(runtime) as decisions:
            await runtime.start(ensemble)
            await runtime.clock.sleep(3.5)
        return faults, decisions

    faults, decisions = run_virtual(main)
    assert {fault.kind for fault in faults} == {"no_observation"}
    assert "no observation in 10000 time steps, in state" in faults[0].detail
    assert [decision.cause for decision in decisions] == ["start", "reset", "reset", "reset"]


def lasting(seed, *, episodes, policy=None, model=None, durations=None, steps=40):
    """Return the discounted returns of some episodes in a world whose actions last."""
    returns = []

    async def main(runtime):
        actions = dict.fromkeys(range(len(model.action_space)), int)
        robot = Ensemble("robot", policy=policy, model=model, actions=actions, horizon=steps)
        await runtime.start(World(robot, durations=durations, seed=seed, finished=returns.append))
        await runtime.start(robot)
        while len(returns) < episodes:
            await runtime.clock.sleep(1000.0)

    run_virtual(main)
    return np.array(returns[:episodes])


@pytest.mark.parametrize("lump", [True, False])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_returns_of_lasting_actions_are_those_that_were_solved_for(seed, lump):
    model, rng = random_mdp(seed, states=4)[0], np.random.default_rng(seed)
    model = model.with_discount(model.discount, of="second")
    sizes = 4, len(model.action_space)
    rates = np.zeros(sizes) if lump else rng.normal(size=sizes)
    durations = Durations(rng.uniform(0.2, 3.0, size=sizes), rng.integers(1, 5, size=(4, 1)), rates)
    solution = solve(model, durations=durations, gap=1e-9)
    returns = lasting(seed, episodes=500, policy=solution.policy, model=model, durations=durations)
    error = returns.std() / len(returns) ** 0.5
    assert abs(returns.mean() - solution.upper) < 4 * error


@pytest.mark.parametrize("episodes", [150, pytest.param(400, marks=pytest.mark.slow)])
def test_returns_of_lasting_actions_without_sight_lie_within_their_bounds(episodes):
    model = problems.tiger().with_discount(0.9, of="second")
    durations = Durations([[0.5, 4.0, 4.0]] * 2, [[1, 2, 2]] * 2)
    solution = solve(model, durations=durations, gap=1e-3)
    returns = lasting(1, episodes=episodes, policy=solution.policy, model=model, durations=durations, steps=60)
    error = returns.std() / len(returns) ** 0.5
    assert solution.lower - 4 * error < returns.mean() < solution.upper + 4 * error


@pytest.mark.parametrize(("of", "unit"), [("step", "second"), (2.0, "second"), (2.0, "step")])
def test_what_replaces_an_action_ends_what_that_earns(of, unit):
    """Of 20 s, 5 go by before another action takes the place of the first."""
    model = MDP([np.eye(2), np.eye(2)], np.zeros((2, 2)), discount=0.5, initial_belief=[1, 0]).with_discount(0.9, of=of)
    scale = 2.0 if unit == "step" else 1.0
    returns = []

    async def main(runtime):
        robot = Ensemble(
            "robot", policy=DeterministicPolicy([0, 1]), model=model, actions=dict.fromkeys((0, 1), int), horizon=2
        )
        durations = Durations(20.0 / scale, 400, [[3.0 * scale, 0.0], [0.0, 0.0]], of=unit)
        await runtime.start(World(robot, durations=durations, seed=1, finished=returns.append))
        await runtime.start(robot)
        await runtime.clock.sleep(5.0)
        runtime.channel("robot/state", State, retain=True).publish(State(runtime.clock.now(), 1, (1,)))
        await runtime.clock.sleep(1.0)

    run_virtual(main)
    interest = -np.log(0.9) / (1.0 if of == "step" else 2.0)
    assert returns == pytest.approx([3.0 * (1 - np.exp(-5 * interest)) / interest])


def test_an_action_that_is_replaced_before_it_is_over_has_no_outcome():
    model = MDP([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 0], [0, 0]], discount=0.5, initial_belief=[1, 0])
    decided = []

    async def main(runtime):
        robot = Ensemble("robot", policy=DeterministicPolicy([0, 1]), model=model, actions=dict.fromkeys((0, 1), int))
        world = World(robot, durations=Durations(1000.0, 400), seed=1)
        await runtime.start(world)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            await runtime.clock.sleep(500.0)
            runtime.channel("robot/state", State, retain=True).publish(State(runtime.clock.now(), 0, (0,)))
            await runtime.clock.sleep(800.0)
            assert world.state == 0
            await runtime.clock.sleep(500.0)
            assert world.state == 1
            decided.extend(decision.action for decision in decisions)

    run_virtual(main)
    assert decided[:3] == [0, 0, 1]


def test_durations_take_the_place_of_a_period():
    model = problems.forest()
    robot = Ensemble("robot", policy=DeterministicPolicy([0, 0, 1]), model=model, actions={0: int, 1: int})
    with refused(ConfigError):
        World(robot, durations=Durations(1.0), period=2.0)
    ticking = Ensemble(
        "robot", policy=DeterministicPolicy([0, 0, 1]), model=model, actions={0: int, 1: int}, drive=FixedRate(1.0)
    )
    with refused(ConfigError):
        World(ticking, durations=Durations(1.0))
    with refused(ModelError):
        World(robot, durations=Durations([1.0] * 7))


@pytest.mark.parametrize("durations", [None, Durations(2.0, 200, rates=1.5)])
def test_what_it_pays_for_each_decision_is_told(durations):
    """Of 3 for a decision, and of 1.5 a second where actions last; without a discount the sum is the return."""
    model = MDP([[[0.5, 0.5], [0.5, 0.5]]], [[3.0], [3.0]], discount=1.0)
    returns, paid = [], []

    async def main(runtime):
        robot = Ensemble("robot", policy=[0, 0], model=model, actions={0: int}, horizon=4)
        world = World(robot, seed=1, durations=durations, finished=returns.append)
        runtime.channel("robot/true_reward", Reward).subscribe(paid.append)
        await runtime.start(world)
        await runtime.start(robot)
        while not returns:
            await runtime.clock.sleep(0.25)

    run_virtual(main)
    of_first = [each.value for each in paid if each.epoch in range(4)][: 4 if durations is None else 8]
    assert sum(of_first) == pytest.approx(returns[0])
    assert {each.epoch for each in paid} == {0, 1, 2, 3}
    assert of_first.count(3.0) == 4
    assert (sum(of_first) > 12) == (durations is not None)


def test_a_world_without_an_end_in_one_turn_ends_the_runtime(monkeypatch):
    monkeypatch.setattr("mdm.runtime.dispatcher._AT_ONCE", 1_000)
    model, _ = random_mdp(1, states=2)
    count = []

    async def main(runtime):
        robot = Ensemble("robot", policy=[0, 1], model=model, actions=dict.fromkeys((0, 1), lambda: None))

        def take(decision):
            count.append(decision)
            if len(count) == 40_000:  # it would go on for ever
                robot.stop()

        runtime.decisions.subscribe(take)
        await runtime.start(World(robot, seed=4, period=0.0))
        await runtime.start(robot)
        await asyncio.sleep(1)

    with pytest.raises(ActorFailure, match="^time stands still: "):
        run_virtual(main)
    assert len(count) < 40_000
