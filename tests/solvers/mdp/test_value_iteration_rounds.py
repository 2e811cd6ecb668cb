"""Every solver of MDPs against linear programs, MADP's tables, and one another; and how it stops."""

from __future__ import annotations

import json
import signal
import warnings

import figures
import numpy as np
import pytest
import scipy
from hypothesis import given, settings, strategies as st
from random_models import factored_models, flat_models
from sentences import refused

import mdm
from mdm.compilation import can_compile
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.models.dynamics import Dynamics
from mdm.solvers import Limits
from mdm.solvers.mdp import value_iteration as backups
from mdm.solvers.mdp.policy_iteration import policy_iteration
from mdm.solvers.mdp.value_iteration import modified_policy_iteration, prioritised_sweeping, value_iteration

SOLVERS = [value_iteration, prioritised_sweeping, policy_iteration, modified_policy_iteration]
TABLES = [
    ("broadcast_channel", 0.9),
    ("dec_tiger", 0.9),
    ("dec_tiger", 0.95),
    ("fire_fighting_graph", 0.9),
    ("grid_small", 0.9),
    ("patrol", 0.9),
]
every_solver = pytest.mark.parametrize("solver", SOLVERS)


def dense(matrix):
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def optimum(model):
    """Return the optimal values: the least V with V >= R + discount * P V for every action.

    Which constraints are binding comes from a linear program, and V from their equations: the program's own is less
    exact.
    """
    size = len(model.state_space)
    actions = range(len(model.action_space))
    bounds = np.vstack([model.discount * dense(model.transition_matrix(a)) - np.eye(size) for a in actions])
    earned = -np.concatenate([model.rewards[:, a] for a in actions])
    found = scipy.optimize.linprog(np.ones(size), A_ub=bounds, b_ub=earned, bounds=(None, None), method="highs")
    assert found.status == 0
    slack = (earned - bounds @ found.x).reshape(-1, size)
    binding = slack.argmin(axis=0) * size + np.arange(size)
    values = np.linalg.solve(bounds[binding], earned[binding])
    assert (bounds @ values <= earned + 1e-9 * (1 + np.abs(values).max())).all()
    np.testing.assert_allclose(values, found.x, rtol=1e-4, atol=1e-4)
    return values


def discounted(model):
    return model.with_discount(0.9) if model.discount == 1 else model


@pytest.mark.compiled("sweeps", where_possible=True)
@every_solver
@given(data=st.data())
@settings(max_examples=25)
def test_values_are_those_of_a_linear_program(solver, data):
    model = discounted(data.draw(flat_models() | factored_models()))
    best = optimum(model)
    for compiled in {False, can_compile()}:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(backups, "can_compile", lambda compiled=compiled: compiled)
            found = solver(model, limits=Limits(gap=1e-6))
        np.testing.assert_allclose(found.policy.values.max(axis=1), best, atol=2e-6)
        value = model.initial_belief @ best
        assert found.lower - 1e-7 <= value <= found.upper + 1e-7
        assert found.gap <= 1e-6


@every_solver
@given(data=st.data())
@settings(max_examples=25)
def test_bounds_hold_wherever_it_stops(solver, data):
    model = discounted(data.draw(flat_models(kinds=("MDP",))))
    limit = data.draw(st.integers(1, 6))
    reports = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backups, "can_compile", lambda: False)
        patch.setattr("mdm.solvers.mdp.value_iteration._SWEEPS", (1, 1))
        found = solver(model, limits=Limits(gap=0, iterations=limit, progress=reports.append))
    best = optimum(model)
    value = model.initial_belief @ best
    for report in [*reports, found]:
        assert report.lower - 1e-6 <= value <= report.upper + 1e-6
    assert found.iterations <= limit
    assert worth(model, found.policy) >= found.lower - 1e-6


def worth(model, policy):
    """Return what a policy is worth at the start, by its linear equations."""
    size = len(model.state_space)
    matrix = np.stack([dense(model.transition_matrix(policy.action(s)))[s] for s in range(size)])
    rewards = np.array([model.rewards[s, policy.action(s)] for s in range(size)])
    return model.initial_belief @ np.linalg.solve(np.eye(size) - model.discount * matrix, rewards)


@every_solver
@pytest.mark.parametrize(("problem", "discount"), TABLES)
def test_tables_are_those_of_madp(solver, problem, discount):
    table = figures.of(problem)["values"][str(discount)]["q_table"]
    found = solver(figures.model(problem, discount), limits=Limits(gap=1e-6))
    # MADP stopped when values changed by no more than 1e-4.
    np.testing.assert_allclose(found.policy.values, table, atol=1e-4 * discount / (1 - discount) + 2e-6)


@pytest.mark.foreign("Access_Synch.pgmx and fireFighting_2_3_3.dpomdp of MADPToolbox/MADP")
def test_tables_are_those_of_madp_for_files_of_other_problems(corpus):
    for name in ("Access_Synch.pgmx", "fireFighting_2_3_3.dpomdp"):
        told = json.loads((corpus / "values" / f"{name}_0.9.json").read_text())
        (path,) = (corpus / "models" / "madp").glob(f"{name}*")
        other = mdm.load_model(path).flatten().with_discount(0.9)
        for solver in SOLVERS:
            values = solver(other, limits=Limits(gap=1e-6)).policy.values
            table = np.array(told["mdp_q_table"])
            np.testing.assert_allclose(values[: len(table)], table, atol=1e-3, err_msg=name)
            assert values.mean() == pytest.approx(told["mdp_q_sum"] / values.size, abs=1e-3), name


def chain(size=400, *, sparse, discount=0.95):
    """Return a chain of states with two actions, a step on or back to the first, that pays at its end."""
    on, back = np.zeros((size, size)), np.zeros((size, size))
    places = np.arange(size)
    on[places, np.minimum(places + 1, size - 1)] = 0.9
    on[places, 0] += 0.1
    back[:, 0] = 1
    rewards = np.zeros((size, 2))
    rewards[-1, 0], rewards[1:, 1] = 4, 1
    return MDP([on, back], rewards, discount=discount, sparse=sparse)


@every_solver
def test_dense_and_sparse_agree(solver):
    tables = [solver(chain(sparse=sparse), limits=Limits(gap=1e-8)).policy.values for sparse in (False, True)]
    np.testing.assert_allclose(*tables, atol=2e-8)
    np.testing.assert_allclose(tables[0].max(axis=1), optimum(chain(sparse=False)), atol=1e-6)


@every_solver
def test_matrices_full_of_numbers_stay_dense(solver):
    random = np.random.default_rng(1)
    transitions = random.random((3, 40, 40))
    model = MDP(transitions / transitions.sum(axis=-1, keepdims=True), random.normal(size=(40, 3)), discount=0.97)
    assert Dynamics(model).is_dense
    found = solver(model, limits=Limits(gap=1e-6))
    np.testing.assert_allclose(found.policy.values.max(axis=1), optimum(model), atol=2e-6)


@every_solver
@pytest.mark.parametrize("discount", [0.5, 0.99999])
@pytest.mark.parametrize("sparse", [False, True])
def test_a_gap_that_rounding_leaves_open(solver, discount, sparse):
    model = chain(30, sparse=sparse, discount=discount)
    found = solver(model, limits=Limits(gap=0))
    assert found.reason in {"converged", "exact", "gap"}
    np.testing.assert_allclose(found.policy.values.max(axis=1), optimum(model), rtol=1e-7)


@every_solver
@pytest.mark.parametrize("penalty", [1e6, 1e9, 1e12, 1e300])
def test_bounds_hold_beside_rewards_of_another_magnitude(solver, penalty):
    slow, fast = [[0.9, 0.1, 0], [0, 1, 0], [0, 1, 0]], [[0, 1, 0], [0, 1, 0], [0, 1, 0]]
    costs = [[-0.002, -0.001], [0, 0], [-penalty, -penalty]]
    model = MDP([slow, fast], costs, discount=0.95, initial_belief=[1, 0, 0])
    found = solver(model, limits=Limits(gap=0))
    assert found.lower <= -0.001 <= found.upper


@every_solver
def test_ctrl_c_returns_the_best_so_far(solver):
    model = chain(sparse=True, discount=0.999)
    reports = []

    def interrupt(report):
        reports.append(report)
        if len(reports) == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.solvers.mdp.value_iteration._SWEEPS", (1, 1))
        found = solver(model, limits=Limits(gap=0, progress=interrupt))
    assert found.reason == "interrupted"
    assert found.iterations == len(reports) == 2
    assert found.policy.num_states == 400
    assert found.lower <= model.initial_belief @ optimum(model) + 1e-6


@every_solver
def test_time_is_up(solver):
    times = iter(range(1000))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdm.solvers.mdp.value_iteration._SWEEPS", (1, 1))
        limits = Limits(gap=0, time=3, clock=lambda: float(next(times)))
        found = solver(chain(sparse=True, discount=0.999), limits=limits)
    assert found.reason == "time"
    assert found.iterations == 3


@every_solver
def test_numbers_that_are_too_large(solver):
    model = MDP([np.eye(2)], np.full((2, 1), 1e308), discount=0.99)
    with warnings.catch_warnings(), refused(ModelError):
        warnings.simplefilter("ignore", RuntimeWarning)
        solver(model)


def test_rewards_that_are_no_numbers_and_empty_sets_of_actions():
    with refused(ModelError):
        MDP([np.eye(2)], [[np.nan], [0]], discount=0.9)
    with refused(ModelError):
        MDP([], np.zeros((2, 0)), discount=0.9)
