"""Bounds against linear equations, value iteration and backups over dense arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_models import dense, flat_models
from sentences import refused

from mdm.compilation import can_compile
from mdm.errors import ModelError
from mdm.models import MDP
from mdm.models.dynamics import Dynamics
from mdm.problems import tiger
from mdm.solvers import Limits, bounds
from mdm.solvers.bounds import InformedBound, blind_values, for_ever, informed_values, known_state_values, known_states
from mdm.solvers.sarsop import sarsop

DISCOUNT = 0.8
POMDPS = flat_models(kinds=("POMDP",), events=True)


def transitions(model):
    return np.stack([dense(model.transition_matrix(a)) for a in range(len(model.action_space))])


def joints(model):
    """Return P(s', o | s, a), A x O x S x S', what is left to no observation as one more."""
    known = np.array(
        [
            [dense(model.joint_matrix(a, o)) for o in range(len(model.observation_space))]
            for a in range(len(model.action_space))
        ]
    )
    rest = transitions(model)[:, None] - known.sum(axis=1, keepdims=True)
    return np.concatenate([known, np.maximum(rest, 0)], axis=1)


def known(model, sweeps=200):
    table = np.zeros(model.rewards.shape)
    for _ in range(sweeps):
        table = model.rewards + DISCOUNT * np.einsum("ast,t->sa", transitions(model), table.max(axis=1))
    return table


def informed(model, table, sweeps=1):
    told = joints(model)
    for _ in range(sweeps):
        after = np.einsum("aost,tb->aosb", told, table).max(axis=-1).sum(axis=1)
        table = model.rewards + DISCOUNT * after.T
    return table


@given(flat_models())
def test_blind_policies_solve_linear_equations(model):
    model = model.with_discount(DISCOUNT)
    found = blind_values(Dynamics(model))
    for action, matrix in enumerate(transitions(model)):
        exact = np.linalg.solve(np.eye(len(matrix)) - DISCOUNT * matrix, model.rewards[:, action])
        assert (found[action] <= exact + 1e-13 * np.abs(exact).max()).all()
        np.testing.assert_allclose(found[action], exact, atol=1e-8 * (1 + np.abs(model.rewards).max()))


@given(flat_models())
def test_values_of_known_states_are_bounds_at_every_step(model):
    model = model.with_discount(DISCOUNT)
    dynamics, exact = Dynamics(model), known(model)
    for table, sure in known_states(dynamics, 1e-6):
        assert sure
        assert (table >= exact - 1e-12 * (1 + np.abs(exact).max())).all()
    np.testing.assert_allclose(table, exact, atol=2e-6)
    np.testing.assert_allclose(known_state_values(dynamics), exact, atol=1e-6)
    early = known_state_values(dynamics, lambda: False)
    assert (early >= exact - 1e-12 * (1 + np.abs(exact).max())).all()


@pytest.mark.parametrize("penalty", [1e9, 1e300])
def test_values_of_known_states_are_bounds_beside_rewards_of_another_magnitude(penalty):
    slow, fast = [[0.9, 0.1, 0], [0, 1, 0], [0, 1, 0]], [[0, 1, 0], [0, 1, 0], [0, 1, 0]]
    model = MDP([slow, fast], [[-0.002, -0.001], [0, 0], [-penalty, -penalty]], discount=0.95)
    for table, sure in known_states(Dynamics(model), 1e-9):
        assert sure
        assert table[0].max() >= -0.001


@given(POMDPS)
def test_the_fast_informed_bound_is_the_limit_of_its_backups(model):
    model = model.with_discount(DISCOUNT)
    found, above = informed_values(Dynamics(model), Limits()), known(model)
    assert (found <= above + 1e-6 * (1 + np.abs(above).max())).all()
    np.testing.assert_allclose(found, informed(model, above, sweeps=200), atol=1e-5 * (1 + np.abs(above).max()))


@pytest.mark.compiled("sweeps", where_possible=True)
@given(POMDPS, st.integers(0, 99))
def test_a_backup_and_sweeps_compiled_or_not(model, seed):
    model = model.with_discount(DISCOUNT)
    table = known(model)
    results = []
    for compiled in (False, can_compile()):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bounds, "_LARGE", 0 if compiled else 10**9)
            bound = InformedBound(Dynamics(model))
        any_table = np.random.default_rng(seed).normal(size=table.shape)
        np.testing.assert_allclose(bound.backup(any_table), informed(model, any_table), atol=1e-9)
        swept = table.copy()
        change = bound.sweep(swept)
        assert change == pytest.approx((table - swept).max(), abs=1e-12)
        assert (swept >= informed(model, table, sweeps=200) - 1e-9).all()
        results.append(bound.lowered(table, lambda: True))
    np.testing.assert_allclose(*results, atol=1e-5 * (1 + np.abs(table).max()))


def test_sweeps_end_when_their_time_is_up():
    dynamics = Dynamics(tiger())
    early, late = informed_values(dynamics, Limits(time=0)), informed_values(dynamics, Limits())
    assert (early >= late - 1e-9).all()
    assert early.max() > late.max() + 1


def test_rewards_that_add_up_to_no_number_are_refused():
    assert for_ever(-2, 0.75) == -8
    dynamics = Dynamics(MDP([np.eye(2)], [[1e308], [0]], discount=0.9))
    for bound in (blind_values, known_state_values):
        with refused(ModelError):
            bound(dynamics)


def test_rewards_that_are_all_alike():
    model = MDP([np.eye(2)] * 2, np.full((2, 2), 3.0), discount=0.5)
    assert blind_values(Dynamics(model)) == pytest.approx(np.full((2, 2), 6.0))
    assert known_state_values(Dynamics(model)) == pytest.approx(np.full((2, 2), 6.0))


@pytest.mark.parametrize("sweeps", [0, 1, 2])
def test_values_of_single_actions_hold_wherever_sweeps_end(sweeps):
    model = tiger()
    dynamics = Dynamics(model)
    asked = iter(range(sweeps))
    found = blind_values(dynamics, lambda: next(asked, None) is not None)
    for action, values in enumerate(found):
        transition = np.asarray(model.transition_matrix(action))
        exact = np.linalg.solve(np.eye(2) - model.discount * transition, model.rewards[:, action])
        assert (values <= exact).all()
    assert list(asked) == []


def test_no_sweep_begins_once_time_is_up(monkeypatch):
    monkeypatch.setattr(InformedBound, "sweep", lambda *_: pytest.fail("a sweep began"))
    monkeypatch.setattr("mdm.solvers.bounds.known_states", lambda *_: pytest.fail("a round began"))
    model = tiger()
    with Limits(time=0) as limits:
        table = informed_values(Dynamics(model), limits)
        found = sarsop(model, limits=limits)
    assert table.min() >= model.rewards.max() / (1 - model.discount)
    assert found.reason == "time"
    assert found.lower <= 19.37 <= found.upper
