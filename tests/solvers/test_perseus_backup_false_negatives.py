"""Vectors that wait for what is detected, against recursion over what may be missed."""

from __future__ import annotations

import warnings

import figures
import numpy as np
import pytest
from perseus_models import events, parts, reachable, recursion

from mdm import ModelWarning, evaluate, load_model
from mdm.models.dynamics import Dynamics
from mdm.solvers import Limits
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.perseus import Improved, Vectors, perseus


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
    function = Improved(dynamics, beliefs, start, missed)
    for _ in range(rounds):
        function.round(np.random.default_rng(0), Unhurried(), every=True)
    vectors = function.vectors
    for action in range(2):
        own = vectors.values[vectors.actions == action]
        assert len(own)
        assert max(own @ beliefs[0]) == pytest.approx(worth(beliefs[0], action, rounds), abs=1e-9)
        for belief in np.random.default_rng(1).dirichlet(np.ones(4), size=20):
            assert max(own @ belief) <= worth(belief, action, rounds) + 1e-9


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


def test_patrol_with_false_negatives_earns_more_than_without_regard_to_them():
    patrol, theirs = figures.model("patrol").with_false_negatives("False Negative"), figures.vectors("patrol", 0.9)
    solution = perseus(patrol, beliefs=100, limits=Limits(iterations=12))
    ours, others = (evaluate(patrol, policy, episodes=1000, seed=1) for policy in (solution.policy, theirs))
    assert solution.lower - 4 * ours.standard_error < ours.mean
    difference = ours.returns - others.returns
    assert difference.mean() > -2 * difference.std() / np.sqrt(len(difference))


@pytest.mark.slow
@pytest.mark.foreign("MAISS_TopLevel.pgmx of MADPToolbox/MADP")
def test_the_top_level_with_false_negatives(corpus):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(corpus / "models" / "madp" / "MAISS_TopLevel.pgmx").with_discount(0.9)
        model.flatten()
    solution = perseus(model.with_false_negatives("False Negative"), beliefs=40, limits=Limits(iterations=2))
    assert solution.history[0].lower < solution.lower < solution.upper < 0
