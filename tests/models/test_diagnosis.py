"""What is odd about a model, by a plain search."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import given
from random_models import dense, factored_models, flat_models

from mdm.errors import ModelWarning
from mdm.models import MDP, POMDP, Factor, Space
from mdm.models.diagnosis import diagnose, reachable_states
from mdm.models.validation import collect_problems


def plainly_reached(model):
    reached = {s for s, chance in enumerate(model.initial_belief) if chance > 0}
    matrices = [dense(model.transition_matrix(a)) for a in range(len(model.action_space))]
    waiting = list(reached)
    while waiting:
        state = waiting.pop()
        for matrix in matrices:
            for after in np.flatnonzero(matrix[state] > 0).tolist():
                if after not in reached:
                    reached.add(after)
                    waiting.append(after)
    return reached, matrices


def check(model):
    reached, matrices = plainly_reached(model)
    assert set(np.flatnonzero(reachable_states(model)).tolist()) == reached
    told = "\n".join(diagnose(model))
    size = len(model.state_space)
    missing = size - len(reached)
    assert (f"{missing} of {size} states" in told and "cannot be reached" in told) == (missing > 0)
    absorbing = sum(all(matrix[s, s] == 1 for matrix in matrices) for s in range(size))
    assert ("(absorbing)" in told) == (absorbing > 0)
    if model.kind == "POMDP":
        seen = {
            o
            for a, matrix in enumerate(matrices)
            for o in range(len(model.observation_space))
            for s in reached
            for t in range(size)
            if matrix[s, t] > 0 and model.observation(a, t, o, state=s) > 0
        }
        never = len(model.observation_space) - len(seen)
        assert ("can never occur" in told) == (never > 0)


@given(model=flat_models(events=True))
def test_flat_models(model):
    check(model)


@given(model=factored_models(events=True))
def test_factored_models(model):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        check(model)


def test_values_and_symbols_that_nothing_uses():
    states = Space([Factor("here", ["a", "b"]), Factor("lamp", ["off", "on", "broken"])])
    told = np.zeros((1, 6, 4))
    told[..., 0] = 1
    model = POMDP(
        [np.eye(6)],
        told,
        np.zeros((6, 1)),
        discount=0.9,
        states=states,
        observation_names=Space([Factor("left", ["x", "y"]), Factor("right", ["x", "y"])]),
        initial_belief=[0.5, 0.5, 0, 0, 0, 0],
    )
    told = diagnose(model)
    assert "1 of 2 values ('b') of state factor 'here' never occur" in told
    assert "1 of 3 values ('broken') of state factor 'lamp' never occur" in told
    assert "1 of 2 observations ('y') of agent 'left' never occur" in told


def test_problems_are_collected_and_put_right():
    transitions = [[[0.5, 0.25, 0], [np.nan, 1, 0], [0, 0, 0]], np.eye(3), [[2, 0, 0], [0, -1, 2], [0, 0, 1]]]
    for sparse in (False, True):
        with collect_problems() as problems:
            model = MDP(transitions, np.zeros((3, 3)), discount=0.9, initial_belief=[0.5, 0, 0], sparse=sparse)
        assert [(problem.text, problem.is_sum) for problem in problems] == [
            ("T of action '0': nan in the row of '1' is not a probability", False),
            ("T of action '0': the row of '0' sums to 0.75, not to 1", True),
            ("T of action '0': the row of '2' sums to 0, not to 1", False),
            ("T of action '2': -1 in the row of '1' is not a probability", False),
            ("T of action '2': the row of '0' sums to 2, not to 1", True),
            ("T of action '2': the row of '1' sums to 2, not to 1", True),
            ("the initial belief sums to 0.5, not to 1", True),
        ]
        for action in range(3):
            np.testing.assert_allclose(dense(model.transition_matrix(action)).sum(axis=1), 1)
        np.testing.assert_allclose(dense(model.transition_matrix(0))[0], [2 / 3, 1 / 3, 0])
        assert model.initial_belief.tolist() == [1, 0, 0]
