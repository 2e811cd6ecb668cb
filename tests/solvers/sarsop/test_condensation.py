"""Condensation: few vectors whose own values hold, and are no less than what the whole set promises."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from places import TIGER
from random_models import dense, distributions
from sarsop_models import mixed

from mdm import compilation, evaluate, load_model, problems
from mdm.models import POMDP, MixedPOMDP
from mdm.models.dynamics import Dynamics
from mdm.solvers import Limits
from mdm.solvers.bounds import blind_values
from mdm.solvers.sarsop import sarsop
from mdm.solvers.sarsop.condensation import Controller, Kernels, Vectors, condensed
from mdm.solvers.sarsop.graph import layout_of, new_scratch


def random_model(seed, discount=0.9):
    random = np.random.default_rng(seed)
    states, actions, observations = random.integers(1, 5, size=3)
    ways = distributions(random, actions, states, states)
    ways[random.random(ways.shape) < 0.3] = 0
    ways += np.eye(states) * 1e-3
    return POMDP(
        ways / ways.sum(axis=-1, keepdims=True),
        distributions(random, actions, states, observations),
        random.integers(-5, 6, size=(states, actions)) * float(random.choice([0, 1e-6, 1, 1e6])),
        discount=discount,
        initial_belief=distributions(random, states),
    )


@settings(max_examples=6)
@example(1, False, 500)  # where a chance is so small that what is asked of its node overflows
@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(5, 200))
def test_few_vectors_are_certified_anew(seed, seen, backups):
    model = mixed(seed) if seen else random_model(seed)
    limits = Limits(gap=1e-6, iterations=backups)
    few = sarsop(model, limits=limits)
    scale = 1 + np.abs(model.rewards).max() / (1 - model.discount)
    assert few.history[-1].size == few.policy.facts()["vectors"]
    assert few.policy.value(model.initial_belief) == pytest.approx(few.lower, abs=1e-9 * scale)
    assert few.lower >= min(few.history[-2].lower, few.upper - 1e-6) - 1e-9 * scale
    assert few.lower <= few.upper + 1e-9 * scale
    random = np.random.default_rng(seed)
    for _ in range(10):
        belief = distributions(random, len(model.state_space))
        if isinstance(model, MixedPOMDP):
            belief = np.where(model.seen_in == random.choice(model.seen_in[belief > 0]), belief, 0)
            belief /= belief.sum()
        assert few.policy.value(belief) <= followed(model, few.policy, belief) + 1e-9 * scale


def followed(model, policy, belief):
    """Return what the policy's action is worth, and its own values after it."""
    action = policy.action(belief)
    value = belief @ model.rewards[:, action]
    for observation in range(len(model.observation_space)):
        after = belief @ dense(model.joint_matrix(action, observation))
        if after.sum() > 0:
            value += model.discount * after.sum() * policy.value(after / after.sum())
    return value


def test_promises_that_vectors_do_not_hold_are_not_believed():
    model = random_model(7)
    dynamics = Dynamics(model)
    layout, _ = layout_of(model, dynamics)
    blind = blind_values(dynamics)
    vectors = Vectors(blind + 100.0, np.arange(len(blind)), np.zeros(len(blind), dtype=np.intp))
    first = np.zeros(1, dtype=np.intp)
    found = condensed(layout, vectors, first, model.initial_belief[None], first, slack=0.0)
    whole = sarsop(model, limits=Limits(gap=1e-3))
    assert found.lower <= whole.upper


def test_the_tiger_needs_few():
    model = load_model(TIGER).with_discount(0.95)
    found = sarsop(model, limits=Limits(gap=1e-3))
    assert len(found.policy.actions) < 20
    assert found.lower <= 19.37137 <= found.upper  # A. R. Cassandra's optimum
    assert len(sarsop(model, limits=Limits(gap=1e-3), whole=True).policy.actions) > 100


@pytest.mark.parametrize("name", ["tiger", "one rock", "two rocks"])
def test_simulated_returns_lie_within_the_bounds_and_near_those_of_all_vectors(name):
    models = {
        "tiger": lambda: load_model(TIGER).with_discount(0.95),
        "one rock": lambda: problems.rock_sample(2, 1),
        "two rocks": lambda: problems.rock_sample(3, 2),
    }
    model = models[name]()
    found, means, errors = [], [], []
    for whole in (False, True):
        solution = sarsop(model, limits=Limits(gap=1e-3, iterations=200, clock=ticks()), whole=whole)
        # With different seeds the means are independent; five standard errors are left in once in a million runs.
        simulated = evaluate(model, solution.policy, episodes=2000, seed=1 + whole)
        slack = 5 * simulated.standard_error
        assert solution.lower - slack <= simulated.mean <= solution.upper + slack
        found.append(solution)
        means.append(simulated.mean)
        errors.append(simulated.standard_error)
    assert found[0].lower >= found[1].lower - 1e-3
    assert found[0].history[-1].size < found[1].history[-1].size
    assert abs(means[0] - means[1]) <= 5 * np.hypot(*errors)


def ticks():
    """Return a clock on which a run takes the same course each time."""
    times = itertools.count(0, 1e-5)
    return lambda: next(times)


def random_controller(seed, kernels=None):
    """Return a controller of twenty random nodes, and the model's layout."""
    model = mixed(seed) if seed % 2 else random_model(seed)
    layout, _ = layout_of(model.revealed(), Dynamics(model.revealed()))
    random = np.random.default_rng(seed)
    blocks = np.arange(20) % (len(layout.first_state) - 1)
    values = random.normal(size=(20, layout.first_state[1]))
    vectors = Vectors(values, random.integers(len(layout.rewards), size=20), blocks)
    made_in = np.zeros(int(layout.observations.columns.max()) + 1, dtype=np.intp)  # an observation's block
    counts = np.diff(layout.observations.starts.astype(np.int64))
    rows = np.repeat(np.arange(len(counts)), counts) % len(layout.state)
    made_in[layout.observations.columns] = layout.block[layout.state[rows]]
    after = np.stack([random.permutation(20) for _ in made_in], axis=1)
    after[blocks[after] != made_in] = -1
    defaults = np.arange(len(layout.first_state) - 1)
    return Controller(layout, vectors, defaults, after, kernels and kernels(layout)), layout


def kernels(layout):
    search = compilation.kernels("mdm.solvers.sarsop.search")
    return Kernels(search.follow, search.arrive, new_scratch(layout, 1))


COMPILED = pytest.param(True, marks=(pytest.mark.slow, pytest.mark.compiled("sarsop")))


@pytest.mark.parametrize("compiled", [False, COMPILED])
@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_steps_between_nodes_are_those_of_matrices(compiled, seed):
    (one, _), (other, _) = random_controller(seed), random_controller(seed, kernels)
    start = np.random.default_rng(seed).random(one.vectors.values.shape)
    goes_on = lambda: True
    np.testing.assert_allclose(other.visits(start, None, goes_on), one.visits(start, None, goes_on), atol=1e-12)
    values, expected = other.evaluated().values, one.evaluated().values
    np.testing.assert_allclose(values, expected, atol=1e-6 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("kernels", [None, kernels])
@pytest.mark.parametrize("asked", [3, 10, 30])
def test_a_plan_whose_evaluation_is_cut_short_has_lower_bounds(kernels, asked):
    exact, _ = random_controller(4, kernels)
    controller, _ = random_controller(4, kernels)
    begun = []

    def part(share):
        """Return a clock on which a share of less than all is soon used up."""
        times = iter(range(asked if share < 1 else 1_000))
        begun.append(share)
        return lambda: next(times, None) is not None

    found = controller.evaluated(part)
    assert len(begun) == 2
    assert (found.values <= exact.evaluated().values + 1e-9).all()
    assert np.isfinite(found.values).all()
