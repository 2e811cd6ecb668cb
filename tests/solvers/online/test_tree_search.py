"""Online tree search against exhaustive look-ahead, value iteration, and what is known of the tiger."""

from __future__ import annotations

import subprocess
import sys
import warnings
from itertools import count

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from places import EXAMPLES
from random_models import dense, distributions, flat_models
from sentences import refused

import mdm
from mdm.beliefs import choice
from mdm.compilation import plain
from mdm.solvers.online import tree_search
from mdm.solvers.online.tree_search import Search, TreeSearch, search_tables

TIGER = EXAMPLES / "tiger.pomdp"
LISTEN, OPEN_LEFT, OPEN_RIGHT = 0, 1, 2


@pytest.fixture(scope="module")
def tiger():
    return mdm.load_model(TIGER)


def joint(model, action, missed):
    """Return P(s', o | s, a) for each o that is detected, and for no detection."""
    transition = dense(model.transition_matrix(action))
    if model.kind == "MDP":
        return [transition * np.eye(len(transition))[s] for s in range(len(transition))], np.zeros_like(transition)
    each = [dense(model.joint_matrix(action, o)) for o in range(len(model.observation_space))]
    rest = np.maximum(transition - sum(each), 0)
    rest[rest < 1e-9] = 0
    if missed is not None:
        rest = rest + each.pop(missed)
    return each, rest


def look_ahead(model, belief, depth, missed=None):
    """Return the values of actions over some steps, by trying all there is; an action goes on while nothing is seen."""
    actions = range(len(model.action_space))
    joints = [joint(model, a, missed) for a in actions]

    def value(weights, steps):
        return max(q(weights, a, steps) for a in actions)

    def q(weights, a, steps):
        if steps == 0 or not weights.sum() > 0:
            return 0.0
        each, rest = joints[a]
        total = weights @ model.rewards[:, a]
        total += model.discount * q(weights @ rest, a, steps - 1)
        return total + model.discount * sum(value(weights @ matrix, steps - 1) for matrix in each)

    return np.array([q(np.asarray(belief), a, depth) for a in actions])


def agrees(model, result, missed=None, depth=3):
    """Whether the bounds leave room for what look-ahead finds, and the action is as good as they say."""
    values = look_ahead(model, model.initial_belief, depth, missed)
    rest = model.discount**depth * np.abs(model.rewards).max() / (1 - model.discount) + 1e-5
    lower, upper = np.array(result.lower), np.array(result.upper)
    assert (lower <= upper + 1e-5).all()
    assert (lower <= values + rest).all()
    assert (upper >= values - rest).all()
    assert values[result.action] >= values.max() - 2 * rest - (upper.max() - lower.max())


@settings(max_examples=30)
@given(
    flat_models(joint=False, events=True, finer=False).filter(lambda model: model.discount < 1),
    st.integers(1, 60),
    st.booleans(),
)
def test_bounds_hold_against_exhaustive_look_ahead(model, expansions, misses):
    missed = 0 if misses and model.kind == "POMDP" and len(model.observation_space) > 1 else None
    policy = mdm.solvers.TreeSearch(model.with_false_negatives(missed), expansions=expansions)
    if model.kind == "MDP":
        for state in range(len(model.state_space)):
            result = policy.search(state)
            values = look_ahead(model, np.eye(len(model.state_space))[state], 3)
            rest = model.discount**3 * np.abs(model.rewards).max() / (1 - model.discount) + 1e-5
            assert (np.array(result.lower) <= values + rest).all()
            assert (np.array(result.upper) >= values - rest).all()
    else:
        agrees(model, policy.search(model.initial_belief), missed)


@settings(max_examples=12)
@given(st.integers(0, 10_000))
def test_the_best_action_is_found_where_the_future_weighs_little(seed):
    random = np.random.default_rng(seed)
    model = mdm.models.POMDP(
        distributions(random, 3, 3, 3),
        distributions(random, 3, 3, 2),
        random.normal(size=(3, 3)),
        discount=0.3,
        initial_belief=distributions(random, 3),
    )
    result = mdm.solvers.TreeSearch(model, expansions=300).search(model.initial_belief)
    agrees(model, result, depth=5)
    values = look_ahead(model, model.initial_belief, 5)
    rest = 0.3**5 / 0.7 * np.abs(model.rewards).max()
    assert values[result.action] >= values.max() - 2 * rest - 0.01
    assert values[result.action] <= max(result.upper) + rest


@pytest.mark.parametrize(
    ("left", "action"),
    [(0.5, LISTEN), (0.85, LISTEN), (0.15, LISTEN), (0.97, OPEN_RIGHT), (0.03, OPEN_LEFT), (0.99, OPEN_RIGHT)],
)
def test_the_tiger(tiger, left, action):
    policy = mdm.solvers.TreeSearch(tiger, expansions=1000)
    assert policy.action(np.array([left, 1 - left])) == action
    lower, upper = policy.search(np.array([left, 1 - left])).lower, policy.search(np.array([left, 1 - left])).upper
    assert max(lower) <= max(upper)
    if left == 0.5:
        assert max(lower) <= 19.3713 <= max(upper)  # its value at discount 0.95
        assert policy.value(np.array([0.5, 0.5])) == max(lower)


@pytest.mark.compiled("search", where_possible=True)
def test_returns_with_the_tiger(tiger):
    result = mdm.simulate(tiger, mdm.solvers.TreeSearch(tiger, expansions=100), episodes=40, steps=40, seed=2)
    assert abs(result.mean - 19.37) < 4 * result.standard_error + 3
    assert result.mean > -1  # what listening for ever leaves behind; any action at random is below -500


def test_plans_raise_what_is_reached(tiger):
    listen_then_open = mdm.policies.AlphaVectors([[28.4, -81.6], [-81.6, 28.4], [19.3, 19.3]], [2, 1, 0])
    with_plans = mdm.solvers.TreeSearch(tiger, expansions=10, plans=listen_then_open)
    assert max(mdm.solvers.TreeSearch(tiger, expansions=10).search([0.5, 0.5]).lower) < 0
    assert max(with_plans.search([0.5, 0.5]).lower) >= 19.3
    assert with_plans.action([0.5, 0.5]) == LISTEN


def test_bounds_that_a_search_begins_from():
    random = np.random.default_rng(0)
    model = mdm.models.MDP(distributions(random, 3, 5, 5), random.normal(size=(5, 3)), discount=0.9)
    values = np.zeros((5, 3))
    forever = np.zeros((3, 5))
    for _ in range(500):
        best = values.max(axis=1)
        values = model.rewards + 0.9 * np.stack([model.transition_matrix(a) @ best for a in range(3)], axis=1)
        forever = np.stack([model.rewards[:, a] + 0.9 * model.transition_matrix(a) @ forever[a] for a in range(3)])
    tables = search_tables(model, upper=None, lower=None)
    assert (tables.upper >= values - 1e-12).all()
    assert (tables.lower <= forever.T + 1e-12).all()
    np.testing.assert_allclose(tables.upper, values, atol=1e-5)
    np.testing.assert_allclose(tables.lower, forever.T, atol=1e-5)
    policy = mdm.solvers.TreeSearch(model, expansions=2000)
    assert [policy.action(state) for state in range(5)] == values.argmax(axis=1).tolist()


def test_the_same_seed_draws_the_same(tiger):
    random = np.random.default_rng(4)
    model = mdm.models.POMDP(
        distributions(random, 3, 30, 30), distributions(random, 3, 30, 4), random.normal(size=(30, 3)), discount=0.9
    )
    beliefs = [distributions(random, 30) for _ in range(5)]

    def results(seed):
        policy = mdm.solvers.TreeSearch(model, expansions=50, seed=seed, particles=5)
        first = [(r.action, r.lower, r.upper) for r in map(policy.search, beliefs)]
        policy.seed(seed)
        assert [(r.action, r.lower, r.upper) for r in map(policy.search, beliefs)] == first
        return first

    assert results(1) == results(1)
    assert results(1) != results(2)


def test_a_belief_is_drawn_from_in_proportion():
    kernel = plain("mdm.solvers.online.kernel")
    model = mdm.models.POMDP(np.eye(50)[None], np.ones((1, 50, 1)), np.arange(50.0)[:, None], discount=0.5)
    tables = search_tables(model, upper=None, lower=None)
    tree = kernel.search_tree(tables, 10, 100)
    belief = distributions(np.random.default_rng(1), 50)
    sums = np.zeros(50)
    for seed in range(400):
        kernel.plant(tables, tree, np.arange(50), belief, np.random.default_rng(seed), 10)
        length = tree.sizes[1]
        assert length <= 10
        assert abs(tree.weights[:length].sum() - 1) < 1e-12
        sums[tree.states[:length]] += tree.weights[:length]
    np.testing.assert_allclose(sums / 400, belief, atol=0.02)


def test_a_belief_may_be_given_by_its_states(tiger):
    policy = mdm.solvers.TreeSearch(tiger, expansions=200)
    given, dense_one = policy.search(([1, 0], [0.2, 0.8])), policy.search([0.8, 0.2])
    assert (given.action, given.lower) == (dense_one.action, dense_one.lower)


def test_time_is_kept(tiger):
    ticks = count()
    tables = search_tables(tiger, upper=None, lower=None)
    clock = lambda: next(ticks) * 0.01
    search = Search(tables, seconds=0.1, expansions=None, particles=10, memory=10**7, seed=1, clock=clock)
    result = search.run(np.array([0, 1]), np.array([0.5, 0.5]))
    assert result.seconds == pytest.approx(0.11)
    assert 0 < result.expansions < 100


def test_what_the_first_search_waits_for_is_none_of_its_time(tiger, monkeypatch):
    """To import, to compile and to allocate."""
    now, kernel = [0.0], plain("mdm.solvers.online.kernel")
    make = kernel.search_tree

    def slow(*arguments):
        now[0] += 2.0
        return make(*arguments)

    def clock():
        now[0] += 0.001
        return now[0]

    monkeypatch.setattr(kernel, "search_tree", slow)
    tables = search_tables(tiger, upper=None, lower=None)
    search = Search(tables, seconds=0.05, expansions=None, particles=10, memory=10**7, seed=1, clock=clock)
    result = search.run(np.array([0, 1]), np.array([0.5, 0.5]))
    assert now[0] > 2
    assert result.seconds == pytest.approx(0.052, abs=0.002)
    assert result.expansions > 10


def test_it_gives_up_when_told(tiger):
    tables = search_tables(tiger, upper=None, lower=None)
    search = Search(tables, seconds=None, expansions=None, particles=10, memory=10**7, seed=1)
    asked = []
    result = search.run(np.array([0, 1]), np.array([0.5, 0.5]), stopped=lambda: asked.append(1) or len(asked) > 3)
    assert len(asked) == 4
    assert result.expansions > 0


def test_a_full_tree_still_decides(tiger):
    policy = mdm.solvers.TreeSearch(tiger, seconds=60.0, memory=20_000)
    result = policy.search([0.5, 0.5])
    assert result.action == LISTEN
    assert result.nodes < 100


def test_a_certain_choice_ends_the_search():
    model = mdm.models.POMDP(np.eye(2)[None].repeat(2, 0), np.ones((2, 2, 1)), [[1.0, 0.0], [1.0, 0.0]], discount=0.5)
    result = mdm.solvers.TreeSearch(model, seconds=60.0).search([0.5, 0.5])
    assert result.action == 0
    assert result.expansions < 10


@pytest.mark.compiled("search")
def test_compiled_or_not_the_numbers_are_the_same():
    program = (
        f"import mdm, numpy as np; m = mdm.load_model(r'{TIGER}');"
        "r = mdm.solvers.TreeSearch(m, expansions=60, seed=3, particles=1).search(np.array([.7, .3]));"
        "print(r.action, r.lower, r.upper, r.nodes)"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program], env={"MDM_COMPILE": flag}, capture_output=True, text=True, check=True
        ).stdout
        for flag in ("0", "1")
    }
    assert len(outputs) == 1
    assert outputs.pop()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "a tree search needs an end: give it seconds, or a number of expansions"),
        ({"seconds": 0.0}, "seconds is a number above 0, not 0.0"),
        ({"expansions": -1}, "expansions is a number above 0, not -1"),
        ({"expansions": 1, "particles": 0}, "particles is a number above 0, not 0"),
        (
            {"expansions": 1, "fallback": mdm.policies.AlphaVectors([[0.0] * 3], [0], 3)},
            "the fallback is for 3 states and 3 actions",
        ),
        (
            {"expansions": 1, "fallback": mdm.policies.DeterministicPolicy([0, 0], 3)},
            "the fallback chooses by state, but",
        ),
        (
            {"expansions": 1, "plans": mdm.policies.AlphaVectors([[0.0] * 2], [0], 2)},
            "the plans is for 2 states and 2 actions",
        ),
    ],
)
def test_what_is_refused(tiger, options, text):
    with pytest.raises(mdm.Error, match=text):
        mdm.solvers.TreeSearch(tiger, **options)


def test_models_and_beliefs_that_are_refused(tiger):
    with refused(mdm.ModelError):
        mdm.solvers.TreeSearch(tiger.with_discount(1.0), expansions=1)
    policy = mdm.solvers.TreeSearch(tiger, expansions=1)
    for belief in ([0.5, 0.6], [1.0], [np.nan, 1.0], ([5], [1.0])):
        with refused(mdm.ModelError):
            policy.action(belief)
    chain = mdm.models.MDP(np.eye(2)[None], [[0.0], [1.0]], discount=0.5)
    with refused(mdm.ModelError):
        mdm.solvers.TreeSearch(chain, expansions=1).action(2)


def test_a_model_s_size_is_told_before_anything_of_it_is_built(monkeypatch):
    large = mdm.problems.rock_sample(15, 15)
    monkeypatch.setattr(choice, "free_memory", lambda: 8e9)
    with refused(mdm.ConfigError):
        TreeSearch(large, seconds=1.0)
    assert not large.is_flattened
    monkeypatch.setattr(choice, "free_memory", lambda: 64e9)
    monkeypatch.setattr(tree_search, "search_tables", lambda *_, **__: pytest.fail("built"))
    with (
        pytest.warns(mdm.ModelWarning, match=r"7405568 states.* T 2\.4 GB.* 16\.7 GB are needed"),
        pytest.raises(pytest.fail.Exception),
    ):
        TreeSearch(large, seconds=1.0)
    monkeypatch.undo()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        TreeSearch(mdm.problems.rock_sample(3, 3), seconds=1.0)
