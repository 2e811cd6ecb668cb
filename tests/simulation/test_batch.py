"""Simulation of many episodes at once, against values by plain recursion and against the real decision loop."""

from __future__ import annotations

import math
import warnings

import figures
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from places import EXAMPLES
from random_models import dense, distributions, factored_models, flat_models
from recursion import FEW, SEEDS, assert_within, by_recursion, vectors_for
from sentences import refused
from solved import solved

from mdm import ConfigError, Controller, ModelError, ModelWarning, evaluate, load_model, load_policy, simulate
from mdm.models import MDP, POMDP, Durations, Factor, Space, in_time
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MixedAlphaVectors,
    QTable,
    StagedPolicy,
    StochasticPolicy,
)
from mdm.problems import forest, tiger
from mdm.simulation.batch import Limits, one_by_one
from mdm.simulation.sampler import Sampler
from mdm.solvers import exact_values, solve


@FEW
@given(flat_models(kinds=("POMDP",), events=True, finer=False), SEEDS)
def test_beliefs_of_all_episodes_are_worth_what_recursion_says(model, seed):
    model = model.with_discount(min(model.discount, 0.9))
    policy = vectors_for(model, np.random.default_rng(seed))
    assert_within(evaluate(model, policy, episodes=3000, steps=3, seed=seed), by_recursion(model, policy, 3))


@FEW
@given(SEEDS, st.booleans())
def test_false_negatives_are_worth_what_recursion_says(seed, sparse):
    random = np.random.default_rng(seed)
    size, count, width = 4, 2, 3
    told = random.dirichlet(np.ones(width) * 0.6, size=(count, size, size))
    transitions = random.dirichlet(np.ones(size) * 0.5, size=(count, size))
    told = np.moveaxis(told, -1, 1) * random.choice([1.0, 0.9])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = POMDP(
            transitions,
            told,
            random.normal(size=(size, count)),
            discount=0.8,
            event_observations=True,
            initial_belief=random.dirichlet(np.ones(size)),
            sparse=sparse,
        )
    policy = vectors_for(model, random)
    result = evaluate(model.with_false_negatives(1), policy, episodes=3000, steps=3, seed=seed)
    assert_within(result, by_recursion(model, policy, 3, false_negative=1))


@settings(FEW, max_examples=10)
@given(factored_models(), SEEDS)
def test_seen_factors_are_seen_from_the_start(model, seed):
    """Each value that may be seen first begins a recursion of its own."""
    assume(model.kind == "POMDP" and any(model.network.fully_observed))
    world = model.with_discount(0.8).revealed()
    random, size, count = np.random.default_rng(seed), len(model.state_space), len(model.action_space)
    shape = world.layout.shape
    policy = MixedAlphaVectors(
        random.normal(size=(2 * shape[0], shape[1])),
        random.integers(count, size=2 * shape[0]).tolist(),
        [*range(shape[0])] * 2,
        count,
        states=world.layout,
    )
    exact = 0
    for seen in world.layout:
        belief = np.where(np.isin(np.arange(size), seen), model.initial_belief, 0)
        if (share := belief.sum()) > 0:
            exact += share * by_recursion(world, policy, 3, belief=belief / share)
    assert_within(evaluate(world, policy, episodes=2000, steps=3, seed=seed), exact)
    returns, _ = one_by_one(world, policy, Limits(3, np.inf), episodes=200, seed=seed)
    assert abs(returns.mean() - exact) < 5 * returns.std() / np.sqrt(200) + 1e-9 * (1 + abs(exact))


@FEW
@given(flat_models(finer=False), SEEDS)
def test_tables_are_worth_what_recursion_says(model, seed):
    random = np.random.default_rng(seed)
    size, count = model.rewards.shape
    weights = distributions(random, size, count).T
    values = 0
    for _ in range(4):
        after = [
            model.rewards[:, a] + model.discount * (dense(model.transition_matrix(a)) @ (values + np.zeros(size)))
            for a in range(count)
        ]
        values = sum(weights[a] * after[a] for a in range(count))
    result = evaluate(model, StochasticPolicy(weights), episodes=3000, steps=4, seed=seed)
    assert_within(result, model.initial_belief @ values)


@pytest.mark.parametrize("looped", [100, pytest.param(300, marks=pytest.mark.slow)])
def test_tiger_is_worth_its_published_optimum_and_the_loop_agrees(looped):
    model = load_model(EXAMPLES / "tiger.pomdp")
    policy = load_policy(EXAMPLES / "tiger.vf", model)
    result = evaluate(model, policy, seed=3)
    low, high = result.interval
    assert abs(result.mean - 19.3713) < 4 * result.standard_error
    assert (low + high) / 2 == pytest.approx(result.mean)
    assert high - low == pytest.approx(2 * 1.96 * result.standard_error, rel=1e-4)
    assert (result.episodes, result.seed, result.moves) == (10_000, 3, 270 * 10_000)
    loop = simulate(model, policy, episodes=looped, seed=1)
    assert abs(result.mean - loop.mean) < 4 * np.hypot(result.standard_error, loop.standard_error)


@pytest.mark.parametrize("looped", [60, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("false_negative", [None, 0])
def test_the_patrol_of_madp_with_and_without_false_negatives(false_negative, looped):
    model, policy = figures.model("patrol").with_false_negatives(false_negative), figures.vectors("patrol", 0.9)
    result = evaluate(model, policy, episodes=2000, seed=1)
    loop = simulate(model, policy, episodes=looped, seed=1)
    assert abs(result.mean - loop.mean) < 4 * np.hypot(result.standard_error, loop.standard_error)
    assert abs(result.mean - figures.of("patrol")["values"]["0.9"]["perseus"]) < 4 * result.standard_error


def test_the_same_seed_gives_the_same_and_another_policy_the_same_luck():
    model = load_model(EXAMPLES / "tiger.pomdp")
    policy = load_policy(EXAMPLES / "tiger.vf", model)
    first, again, other = (evaluate(model, policy, episodes=50, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.returns, again.returns)
    assert not np.array_equal(first.returns, other.returns)
    drawn = evaluate(model, policy, episodes=50)
    assert np.array_equal(drawn.returns, evaluate(model, policy, episodes=50, seed=drawn.seed).returns)
    listening = FiniteStateController([0], [[0, 0]], 3)
    vectors = AlphaVectors([[0.0, 0.0]], [0], 3)
    assert np.array_equal(*(evaluate(model, each, episodes=50, seed=1).returns for each in (listening, vectors)))
    # Episodes that end at different times leave each other's luck alone.
    chain = MDP([[[0.5, 0.5], [0, 1]]] * 2, [[1, 1], [0, 0]], discount=0.9)
    tables = (DeterministicPolicy([0, 1], 2), QTable([[0, 1], [0, 1]]))
    assert np.array_equal(*(evaluate(chain, table, episodes=500, seed=1).returns for table in tables))


def until(least, told):
    """Return what ends an evaluation once so many episodes have ended."""

    def tell(ended, episodes):
        told.append((ended, episodes))
        return ended >= least

    return tell


def test_who_is_told_of_progress_may_end_an_evaluation():
    """What is known by then are the first episodes of the whole evaluation."""
    told, given = [], (EXAMPLES / "tiger.pomdp", EXAMPLES / "tiger.vf")
    options = {"episodes": 1500, "seed": 4, "steps": 5}
    whole = evaluate(*given, **options)
    part = evaluate(*given, **options, progress=until(1000, told))
    assert part.episodes == 1000
    np.testing.assert_array_equal(part.returns, whole.returns[:1000])
    assert [ended for ended, _ in told] == sorted(ended for ended, _ in told)
    assert {episodes for _, episodes in told} == {1500}
    none = evaluate(*given, **options, progress=until(0, told))
    assert (none.episodes, none.moves) == (0, 0)
    assert np.isnan([none.mean, none.standard_error, *none.interval]).all()
    assert evaluate(*given, **options, progress=until(1501, told)).mean == whole.mean


def test_who_is_told_of_progress_may_end_episodes_one_by_one():
    model = load_model(EXAMPLES / "tiger.pomdp")
    given = (model, load_policy(EXAMPLES / "tiger.vf"), Limits(5, 100))
    whole, moves = one_by_one(*given, episodes=6, seed=2)
    told = []
    part, fewer = one_by_one(*given, episodes=6, seed=2, progress=until(4, told))
    np.testing.assert_array_equal(part, whole[:4])
    assert fewer == moves * 4 // 6
    assert told[-1] == (4, 6)


def test_episodes_end_where_nothing_more_is_earned():
    model = MDP([[[0.5, 0.5], [0, 1]]], [[1], [0]], discount=0.999, initial_belief=[1, 0])
    result = evaluate(model, DeterministicPolicy([0, 0]), seed=1)
    assert result.moves < 3 * 10_000
    assert_within(result, 1 / (1 - 0.999 / 2))


def test_a_team_goes_by_its_own_observations():

    random = np.random.default_rng(1)
    team = POMDP(
        random.dirichlet(np.ones(3), size=(4, 3)),
        random.dirichlet(np.ones(6), size=(4, 3)),
        random.normal(size=(3, 4)),
        discount=0.9,
        actions=Space([Factor("a", 2), Factor("b", 2)]),
        observation_names=Space([Factor("a", 2), Factor("b", 3)]),
    )
    controllers = [
        FiniteStateController([0, 1], [[1, 0], [0, 0]]),
        FiniteStateController([1, 0], [[1, 0, 1], [0, 1, 1]]),
    ]
    joint = JointController(controllers)

    def worth(weights, nodes, left):
        action = team.action_space.ravel(joint.actions_at(nodes))
        total = weights @ team.rewards[:, action]
        if left > 1:
            for o in range(6):
                after = 0.9 * weights @ team.joint_matrix(action, o)
                total += worth(after, joint.next_nodes(nodes, divmod(o, 3)), left - 1)
        return total

    assert_within(evaluate(team, joint, steps=3, seed=1), worth(team.initial_belief, (0, 0), 3))


def test_a_plan_that_ends_ends_an_episode():
    model = load_model(EXAMPLES / "tiger.pomdp").with_discount(1)
    tree = FiniteStateController([0, 0], [[1, 1], [None, None]], 3)
    result = evaluate(model, tree, seed=1, episodes=100)
    assert (result.mean, result.standard_error, result.steps) == (-2, 0, 2)
    assert evaluate(model, JointController([tree]), seed=1, episodes=100).mean == -2
    with refused(ConfigError):
        evaluate(model, FiniteStateController([0], [[0, 0]], 3))


def test_false_negatives_for_ever_end_an_episode():
    told = np.zeros((1, 2, 2, 2))
    told[0, 0] = 1
    model = POMDP([np.eye(2)], told, [[1.0], [1.0]], discount=1, event_observations=True)
    result = evaluate(model.with_false_negatives(0), AlphaVectors([[0, 0]], [0]), episodes=3, steps=2, seed=1)
    assert list(result.returns) == [10_000] * 3


def test_mistakes_are_told():
    model = load_model(EXAMPLES / "tiger.pomdp")
    policy = load_policy(EXAMPLES / "tiger.vf", model)
    mdp = MDP([np.eye(2)], [[1.0], [1.0]], discount=0.9)
    for arguments, words in (
        ((model, policy, {"episodes": 0}), "at least 1 episode"),
        ((model, policy, {"episodes": 1.5}), "at least 1 episode, not 1.5"),
        ((model, policy, {"steps": 2.5}), "at least 1 step, not 2.5"),
        ((model, policy, {"seed": -1}), "a seed is a whole number from 0 on, not -1"),
        ((model, policy, {"steps": 0}), "at least 1 step"),
        ((mdp, policy, {}), "is an MDP, which has none"),
        ((model, DeterministicPolicy([0, 1, 2]), {}), "3 states"),
        ((model.with_discount(1), policy, {}), "needs an end"),
    ):
        *given_, options = arguments
        with pytest.raises(ConfigError, match=words):
            evaluate(*given_, **options)


def test_a_staged_policy_goes_through_its_stages():
    model = MDP([np.eye(2), [[0, 1], [1, 0]]], [[1, 0], [5, 3]], discount=0.5, initial_belief=[1, 0])
    policy = StagedPolicy([[[0, 1], [0, 0]], [[0, 0], [0, 1]], [[1, 0], [1, 0]]])
    result = evaluate(model, policy, episodes=10, seed=1)  # change over, change back, stay
    assert list(result.returns) == [0.5 * 3 + 0.25 * 1] * 10
    assert list(simulate(model, policy, episodes=10, seed=1).returns) == [0.5 * 3 + 0.25 * 1] * 10
    assert simulate(model, policy, episodes=2, steps=9).steps == 3
    assert list(simulate(model, policy, episodes=2, steps=2).returns) == [0.5 * 3] * 2
    assert exact_values(model, policy)[0] == pytest.approx(result.mean)
    assert evaluate(model, policy, episodes=1, steps=2).mean == pytest.approx(exact_values(model, policy, steps=2)[0])


def doors(*heard, discount):
    """Return two doors, behind which a sound is heard more or less often."""
    stuck, anew = np.eye(2), np.full((2, 2), 0.5)
    told = np.full((3, 2, 2, 2), 0.5)
    told[0] = (np.array([[0.85, 0.15], [0.15, 0.85]]) * np.array(heard)[:, None]).T[:, None]
    rewards = [[-1, -100, 10], [-1, 10, -100]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP([stuck, anew, anew], told, rewards, discount=discount, event_observations=True)


@pytest.mark.parametrize(
    ("episodes", "singly", "looped"), [(1_000, 60, 40), pytest.param(10_000, 200, 100, marks=pytest.mark.slow)]
)
def test_policies_earn_their_bounds_where_events_go_unseen(episodes, singly, looped):
    """Behind one door much goes unheard. Whoever takes each sound for that of a single step opens the other one."""
    model = doors(0.95, 0.4, discount=0.95)
    solution = solved(model, gap=0.01)
    aware = evaluate(model, solution.policy, episodes=episodes, seed=1)
    assert solution.lower - 4 * aware.standard_error < aware.mean < solution.upper + 4 * aware.standard_error
    returns, _ = one_by_one(model, solution.policy, Limits(math.inf, 270), episodes=singly, seed=2)
    error = returns.std() / np.sqrt(singly)
    assert solution.lower - 4 * error < returns.mean() < solution.upper + 4 * error
    loop = simulate(model, solution.policy, episodes=looped, seed=3)
    assert abs(loop.mean - solution.lower) < 4 * loop.standard_error


def test_beliefs_that_discount_long_waits_earn_the_bound():
    """A sound every ten steps or every one: how long it took nobody knows, but it costs."""
    model = doors(0.9, 0.1, discount=0.9)
    solution = solved(model, gap=0.01)
    plain = evaluate(model, solution.policy, episodes=10_000, seed=1)
    weighed = evaluate(model.with_discounted_waits(), solution.policy, episodes=10_000, seed=1)
    assert plain.mean < solution.lower - 5 * plain.standard_error
    assert solution.lower - 4 * weighed.standard_error < weighed.mean < solution.upper + 4 * weighed.standard_error
    looped = simulate(model.with_discounted_waits(), solution.policy, episodes=200, seed=3)
    assert abs(looped.mean - solution.lower) < 4 * looped.standard_error


@FEW
@given(SEEDS, st.sampled_from(["table", "controller"]), st.sampled_from([None, 3]))
def test_actions_that_take_time_are_worth_what_is_exact(seed, kind, steps):
    random = np.random.default_rng(seed)
    model = (forest() if kind == "table" else tiger()).with_discount(0.9, of="second")
    sizes = len(model.state_space), len(model.action_space)
    durations = Durations(random.uniform(1.0, 30.0, size=sizes), random.integers(1, 5, size=sizes))
    policy = DeterministicPolicy(random.integers(sizes[1], size=sizes[0]).tolist(), sizes[1])
    if kind == "controller":
        policy = FiniteStateController([0, 1, 2], random.integers(3, size=(3, 2)).tolist(), sizes[1])
    exact = model.initial_belief @ exact_values(model, policy, steps=steps, durations=durations)
    assert_within(evaluate(model, policy, episodes=3000, steps=steps, seed=seed, durations=durations), exact)

    class Own:  # no batch: one episode at a time
        num_actions, action = policy.num_actions, getattr(policy, "action", None)
        information = getattr(policy, "information", None)

    if kind == "table":
        assert_within(evaluate(model, Own(), episodes=300, steps=steps, seed=seed, durations=durations), exact)


def test_where_no_action_takes_longer_than_a_second_evaluation_is_the_same():
    rate = -math.log(0.95)
    alike = Durations((1 / 0.95 - 1) / rate)
    policy = solved(tiger(), gap=0.1).policy
    timed = evaluate(tiger().with_discount(0.95, of="second"), policy, episodes=500, seed=3, durations=alike)
    assert timed.mean == pytest.approx(evaluate(tiger(), policy, episodes=500, seed=3).mean, abs=1e-4)


@pytest.mark.parametrize(
    ("model", "durations", "words"),
    [
        (forest(), [1.0, 2.0], r"durations are mdm.models.Durations\(…\), not \[1.0, 2.0\]"),
        (forest(), Durations([1.0] * 5), "the model has 3 states and 2 actions"),
        (
            forest().with_discount(0.9, of=1.0),
            Durations([1e-20, 1.0]),
            "an action is so short that its time costs nothing",
        ),
        (
            forest().with_discount(0.9, of="second"),
            Durations(1e300, 9),
            "each action is so long that nothing counts after it",
        ),
        (forest().with_discount(1.0), Durations(1.0), "time costs nothing: leave the durations out"),
        (tiger().with_false_negatives(0), Durations(1.0), "none of which is a false negative"),
    ],
)
def test_durations_that_do_not_fit_are_refused(model, durations, words):
    policy = DeterministicPolicy([0] * len(model.state_space), len(model.action_space))
    for use in (
        lambda: evaluate(model, policy, episodes=1, durations=durations),
        lambda: exact_values(model, policy, durations=durations),
        lambda: solve(model, durations=durations),
    ):
        with pytest.raises(ModelError, match=words):
            use()


@pytest.mark.slow
@pytest.mark.parametrize("episodes", [100, 500])
def test_hidden_states_that_take_longer_are_weighed_by_beliefs_in_time(episodes):
    """By the plain beliefs a policy may earn less than its bound; by those of the model in time it earns that."""
    model, durations = tiger().with_discount(0.95, of="second"), Durations([[0.1, 1.0, 1.0], [20.0, 1.0, 1.0]])
    timed = in_time(model, durations)
    whole = solve(timed, gap=1e-2)
    cut = solve(model, durations=durations, gap=1e-2)
    assert cut.lower == pytest.approx(whole.lower, abs=1e-2)  # both are that near to the value
    assert evaluate(model, cut.policy, episodes=4000, seed=1, durations=durations).interval[1] < cut.lower
    discounts, controller, sampler = durations.discounts(model), Controller(whole.policy, timed), Sampler(model, 1)
    returns = []
    for _ in range(episodes):
        state, weight, total, step = sampler.first_state(), 1.0, 0.0, controller.start()
        while weight > 1e-4:
            total += weight * model.rewards[state, step.action]
            weight *= discounts[state, step.action]
            before, state = state, sampler.next_state(state, step.action)
            step = controller.observe(sampler.observation(step.action, before, state))
        returns.append(total)
    assert np.mean(returns) + 3.5 * np.std(returns) / math.sqrt(len(returns)) > whole.lower
