"""Perseus against recursion over beliefs, known optima, MADP's own policies, and simulation."""

from __future__ import annotations

import signal
import warnings

import figures
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_models import dense, factored_models, flat_models

from mdm import ConfigError, ModelError, ModelWarning, evaluate, load_model
from mdm.models import POMDP, MixedPOMDP
from mdm.models.dynamics import Dynamics
from mdm.policies import AlphaVectors
from mdm.problems import tiger
from mdm.solvers import Limits, controller_values, solve
from mdm.solvers.perseus import joint_dynamics, perseus
from mdm.solvers.perseus.backup import Vectors
from mdm.solvers.perseus.false_negatives import Constrained
from mdm.solvers.perseus.joint_dynamics import JointDynamics
from mdm.solvers.perseus.points import sampled, starts

SEEDS = st.integers(0, 2**32 - 1)
SMALL = flat_models(kinds=("POMDP",), joint=False, events=True, finer=False)


def parts(model, false_negative=None):
    """Return for each action what is earned until something is detected, and what then follows each observation."""
    size = len(model.state_space)
    result = []
    for action in range(len(model.action_space)):
        joints = {
            o: dense(model.joint_matrix(action, o)) for o in range(len(model.observation_space)) if o != false_negative
        }
        missed = dense(model.transition_matrix(action)) - sum(joints.values())
        missed[np.abs(missed) < 1e-9] = 0
        during = np.linalg.inv(np.eye(size) - model.discount * missed)
        result.append((during @ model.rewards[:, action], [during @ joint for joint in joints.values()]))
    return result


def recursion(each, discount, belief, depth, rest=0.0):
    """Return the greatest value of so many decisions from an unnormalised belief; then comes the rest."""
    if not depth:
        return rest * belief.sum()
    return max(
        belief @ earned
        + discount * sum(recursion(each, discount, belief @ m, depth - 1, rest) for m in after if (belief @ m).any())
        for earned, after in each
    )


def reachable(each, belief, depth):
    """Return all beliefs that so many decisions lead to, and those on the way."""
    found, level = [belief], [belief]
    for _ in range(depth):
        after = [b @ m for b in level for _, matrices in each for m in matrices]
        level = [b / b.sum() for b in after if b.sum() > 1e-12]
        found += level
    return np.stack(found)


def test_tiger_reaches_its_optimum():
    solution = perseus(tiger())
    assert solution.reason == "converged"
    assert 19.37 < solution.lower < 19.3722
    assert solution.policy.value(tiger().initial_belief) == pytest.approx(solution.lower)
    assert solution.upper > solution.lower
    lowers = [progress.lower for progress in solution.history]
    assert lowers == sorted(lowers)


@given(SMALL, SEEDS)
@settings(max_examples=40)
def test_bounds_enclose_the_optimum_and_policies_keep_their_promise(model, seed):
    model = model.with_discount(min(model.discount, 0.8))
    solution = perseus(model, beliefs=30, seed=seed, limits=Limits(iterations=6))
    each, depth = parts(model), 3
    ends = [float(pick(model.rewards)) / (1 - model.discount) for pick in (np.min, np.max)]
    low, high = (recursion(each, model.discount, model.initial_belief, depth, end) for end in ends)
    slack = 1e-9 * (1 + np.abs(ends).max())
    assert solution.lower <= high + slack
    assert solution.upper >= low - slack
    assert solution.lower <= solution.upper + slack
    policy = solution.policy
    assert policy.value(model.initial_belief) == pytest.approx(solution.lower, abs=slack)
    for belief in np.random.default_rng(seed).dirichlet(np.full(len(model.state_space), 0.5), size=10):
        earned, after = each[policy.action(belief)]
        ahead = sum(max(policy.vectors @ (belief @ matrix)) for matrix in after)
        assert policy.value(belief) <= belief @ earned + model.discount * ahead + slack


@given(SMALL, SEEDS, st.integers(1, 3), st.booleans())
@settings(max_examples=30)
def test_plans_are_optimal_at_all_beliefs_that_can_be_reached(model, seed, horizon, misses):
    del seed
    missed = 0 if misses and len(model.observation_space) > 1 else None
    if missed is not None or model.event_observations:
        model = model.with_discount(min(model.discount, 0.9))
    model = model.with_false_negatives(missed)
    each = parts(model, missed)
    beliefs = reachable(each, model.initial_belief, horizon - 1)
    solution = perseus(model, beliefs=beliefs, horizon=horizon, limits=Limits(gap=0))
    best = recursion(each, model.discount, model.initial_belief, horizon)
    slack = 1e-9 * (1 + abs(best))
    assert solution.lower == pytest.approx(best, abs=slack)
    assert solution.upper >= best - slack
    plan = solution.policy
    assert plan.horizon == horizon
    worth = controller_values(model, plan)[plan.start] @ model.initial_belief
    assert worth == pytest.approx(solution.lower, abs=slack)


@given(factored_models().filter(lambda model: model.kind == "POMDP" and any(model.network.fully_observed)), SEEDS)
@settings(max_examples=15)
def test_bounds_are_for_who_sees_what_is_observed_from_the_start(model, seed):
    model = model.with_discount(min(model.discount, 0.5)).revealed()
    assert isinstance(model, MixedPOMDP)
    solution = perseus(model, beliefs=20, seed=seed, limits=Limits(iterations=4))
    each = parts(model)
    ends = [float(pick(model.rewards)) / (1 - model.discount) for pick in (np.min, np.max)]
    starts = [np.where(model.seen_in == seen, model.initial_belief, 0.0) for seen in range(max(model.seen_in) + 1)]
    low, high = (sum(recursion(each, model.discount, start, 1, end) for start in starts) for end in ends)
    slack = 1e-9 * (1 + np.abs(ends).max())
    assert solution.lower <= high + slack
    assert solution.upper >= low - slack
    worth = sum(start.sum() * solution.policy.value(start / start.sum()) for start in starts if start.any())
    assert worth == pytest.approx(solution.lower, abs=slack)


def events(seed, *, told=1.0, size=4):
    random = np.random.default_rng(seed)
    observations = told * np.moveaxis(random.dirichlet(np.ones(3), size=(2, size, size)), -1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return POMDP(
            random.dirichlet(np.ones(size), size=(2, size)),
            observations,
            random.normal(size=(size, 2)),
            discount=0.85,
            event_observations=True,
        )


class Unhurried:
    remaining = 1.0


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_backups_with_false_negatives_are_what_recursion_says(rounds):
    model, missed = events(rounds), 1
    joints = [[model.joint_matrix(a, o) for o in range(3)] for a in range(2)]
    blind = [np.linalg.solve(np.eye(4) - 0.85 * model.transition_matrix(a), model.rewards[:, a]) for a in range(2)]

    def worth(belief, action, depth):
        """Return what an action is worth that goes on after what is missed, however often."""
        if not depth:
            return belief @ blind[action]
        total = belief @ model.rewards[:, action] + 0.85 * worth(belief @ joints[action][missed], action, depth - 1)
        for o in (0, 2):
            total += 0.85 * max(worth(belief @ joints[action][o], other, depth - 1) for other in range(2))
        return total

    dynamics = JointDynamics(Dynamics(model))
    everything = [(None, row) for row in joints]
    beliefs = reachable(everything, model.initial_belief, rounds - 1)
    start = Vectors(np.stack(blind), np.arange(2), np.zeros(2, dtype=np.intp))
    function = Constrained(dynamics, beliefs, start, missed)
    for _ in range(rounds):
        function.round(np.random.default_rng(0), Unhurried(), every=True)
    vectors = function.vectors
    for action in range(2):
        own = vectors.values[vectors.actions == action]
        assert len(own)
        assert max(own @ beliefs[0]) == pytest.approx(worth(beliefs[0], action, rounds), abs=1e-9)
        for belief in np.random.default_rng(1).dirichlet(np.ones(4), size=20):
            assert max(own @ belief) <= worth(belief, action, rounds) + 1e-9


@pytest.mark.parametrize("sparse", [False, True])
def test_what_is_never_detected_goes_on(monkeypatch, sparse):
    monkeypatch.setattr(joint_dynamics, "_SMALL", 0 if sparse else 10**9)
    monkeypatch.setattr(joint_dynamics, "_DENSE", 2.0)
    model = POMDP([np.eye(2)] * 2, [np.array([[1, 0], [1, 0]])] * 2, [[1, 2], [3, 1]], discount=0.5, sparse=sparse)
    model = model.with_false_negatives(0)
    for horizon in (None, 1, 2):
        solution = perseus(model, beliefs=20, horizon=horizon, limits=Limits(gap=0))
        assert solution.lower == pytest.approx(4, abs=1e-5)  # the first for ever, 2 a step
        assert solution.upper == pytest.approx(4, abs=1e-5)


@pytest.mark.parametrize("told", [1.0, 0.9])
def test_false_negatives_are_part_of_the_bound(told):
    model = events(5, told=told).with_false_negatives(1)
    solution = perseus(model, beliefs=100, limits=Limits(iterations=40))
    assert set(solution.policy.actions) <= {0, 1}
    each = parts(model, 1)
    high = recursion(each, 0.85, model.initial_belief, 5, float(model.rewards.max()) / 0.15)
    assert solution.lower <= high
    # Two actions' vectors of a plan, at random: what a plan earns is no more than the best one at each belief.
    result = evaluate(model, solution.policy, episodes=4000, seed=2)
    assert abs(result.mean - solution.lower) < 4 * result.standard_error + 0.02


def test_sparse_and_dense_find_the_same(monkeypatch):
    model = events(7, told=0.95, size=9)
    found = []
    for small, wide in ((10**9, 10**9), (0, 10**9), (0, 0)):
        monkeypatch.setattr(joint_dynamics, "_SMALL", small)
        monkeypatch.setattr(joint_dynamics, "_DENSE", 2.0)
        monkeypatch.setattr(joint_dynamics, "_WIDE", wide)
        monkeypatch.setattr(joint_dynamics, "_NARROW", 2.0)
        for missed in (None, 2):
            limits = Limits(iterations=5, gap=0)
            found.append(perseus(model.with_false_negatives(missed), beliefs=40, limits=limits).lower)
    np.testing.assert_allclose(found[2:4], found[:2], atol=1e-9)
    np.testing.assert_allclose(found[4:], found[:2], atol=1e-9)


MADP = [("dec_tiger", 0.9, 40), ("dec_tiger", 0.95, 60), ("broadcast_channel", 0.9, 20)]
MADP += [("grid_small", 0.9, 17), ("patrol", 0.9, 32)]


@pytest.mark.parametrize(("problem", "discount", "rounds"), MADP)
def test_policies_are_certified_to_be_worth_what_madp_says_of_its_own(problem, discount, rounds):
    told = figures.of(problem)["values"][str(discount)]
    beliefs = 600 if problem == "patrol" else 1000
    solution = perseus(figures.model(problem, discount), beliefs=beliefs, limits=Limits(iterations=rounds))
    assert solution.lower > told["perseus"] - 1e-3
    assert solution.upper <= max(told["qmdp"]) + 1e-2


def test_patrol_with_false_negatives_earns_more_than_without_regard_to_them():
    patrol, theirs = figures.model("patrol").with_false_negatives("False Negative"), figures.vectors("patrol", 0.9)
    solution = perseus(patrol, beliefs=300, limits=Limits(iterations=12))
    ours, others = (evaluate(patrol, policy, episodes=3000, seed=1) for policy in (solution.policy, theirs))
    assert solution.lower - 4 * ours.standard_error < ours.mean
    difference = ours.returns - others.returns
    assert difference.mean() > -2 * difference.std() / np.sqrt(len(difference))


@pytest.mark.foreign("MAISS_TopLevel.pgmx of MADPToolbox/MADP")
def test_the_top_level_with_false_negatives(corpus):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(corpus / "models" / "madp" / "MAISS_TopLevel.pgmx").with_discount(0.9)
        model.flatten()
    solution = perseus(model.with_false_negatives("False Negative"), beliefs=40, limits=Limits(iterations=2))
    assert solution.history[0].lower < solution.lower < solution.upper < 0


def test_the_same_seed_finds_the_same_policy():
    model = events(3)
    first, again, other = (solve(model, "perseus", iterations=5, beliefs=50, seed=seed).policy for seed in (1, 1, 2))
    assert np.array_equal(first.vectors, again.vectors)
    assert first.actions == again.actions
    assert first.vectors.shape != other.vectors.shape or not np.allclose(first.vectors, other.vectors)


def test_it_stops_when_it_is_told_to():
    def interrupt(progress):
        if progress.iterations == 3:
            signal.raise_signal(signal.SIGINT)

    solution = perseus(tiger(), limits=Limits(progress=interrupt))
    assert solution.reason == "interrupted"
    assert solution.iterations == 3
    assert isinstance(solution.policy, AlphaVectors)
    assert solution.lower > -20  # what listening for ever is worth
    seconds = iter(range(10**9))
    late = perseus(tiger(), beliefs=100, limits=Limits(time=60, gap=0, clock=lambda: next(seconds)))
    assert late.reason == "time"
    assert late.policy.value(tiger().initial_belief) == late.lower
    assert perseus(tiger(), beliefs=100, limits=Limits(iterations=0)).lower == pytest.approx(-20, abs=1e-2)
    assert perseus(tiger(), beliefs=100, limits=Limits(gap=150)).reason == "gap"
    assert perseus(tiger(), beliefs=100, limits=Limits(memory=1)).reason == "memory"


def test_a_plan_is_whole_wherever_it_is_stopped():
    seconds = iter(range(10**9))
    solution = perseus(tiger(), beliefs=100, horizon=9, limits=Limits(time=25, clock=lambda: next(seconds)))
    assert solution.reason == "time"
    assert solution.policy.horizon == 9
    worth = controller_values(tiger(), solution.policy)[solution.policy.start] @ tiger().initial_belief
    assert worth == pytest.approx(solution.lower)
    assert perseus(tiger().with_discount(1), beliefs=100, horizon=9).lower > solution.lower


def test_refusals():
    model = tiger()
    with pytest.raises(ModelError, match="discount below 1, or a horizon"):
        perseus(model.with_discount(1))
    with pytest.raises(ConfigError, match="at least 1 belief, not 0"):
        perseus(model, beliefs=0)
    with pytest.raises(ConfigError, match="from 1 on, not 0"):
        perseus(model, horizon=0)
    with pytest.raises(ModelError, match="belief 1 sums to 2"):
        perseus(model, beliefs=[[0.5, 0.5], [1, 1]])
    with pytest.raises(ModelError, match="too much for numbers"):
        perseus(POMDP([np.eye(2)], [np.eye(2)], [[1e308], [0]], discount=0.9))
    never = POMDP([np.eye(2)], [[[1, 0], [0, 1]]], [[1], [0]], discount=1.0)
    with pytest.raises(ModelError, match="may go on for ever without anything being detected"):
        perseus(never.with_false_negatives(0), horizon=2)


def test_fewer_beliefs_are_sampled_where_there_is_no_room_for_all():
    model = tiger()
    limits = Limits(memory=1)
    dynamics = JointDynamics(Dynamics(model))
    found = sampled(model, dynamics, starts(model), 50, np.random.default_rng(0), limits)
    assert len(found) == 1
    assert len(sampled(model, dynamics, starts(model), 50, np.random.default_rng(0), Limits())) > 1
