"""Sizes of matrices that are told before they are made, against those that are made."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from random_models import factored_models

import mdm
from mdm.errors import ModelWarning
from mdm.models.factored.model import matrix_size
from mdm.models.matrices import is_compressed


def held(matrices):
    """Return the bytes of matrices, of one that several actions share once."""
    once = {id(matrix): matrix for matrix in matrices}.values()
    return sum(
        sum(array.nbytes for array in (matrix.data, matrix.indices, matrix.indptr))
        if is_compressed(matrix)
        else matrix.nbytes
        for matrix in once
    )


def made(model):
    """Return the bytes of T, O and R as they are made."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        flat = model.flatten()
    actions = range(len(flat.action_space))
    told = 0
    if isinstance(flat, mdm.models.POMDP) and not flat.event_observations:
        told = held([flat.observation_matrix(action) for action in actions])
    return held([flat.transition_matrix(action) for action in actions]), told, flat.rewards.nbytes


@pytest.mark.parametrize(
    "problem",
    [
        lambda: mdm.problems.fire_fighting(houses=3, team=3),
        lambda: mdm.problems.fire_fighting(houses=4, team=2, fire_levels=2),
        lambda: mdm.problems.fire_fighting_graph(team=5),
        mdm.problems.tag,
        mdm.problems.rock_sample,
    ],
    ids=["fires", "houses", "graph", "tag", "rocks"],
)
def test_sizes_are_known_before(problem):
    model = problem()
    size = matrix_size(model.network)
    transitions, observations, rewards = made(model)
    assert size.transitions == pytest.approx(transitions, rel=0.05)
    assert size.observations == pytest.approx(observations, rel=0.05)
    assert size.rewards == rewards
    assert size.total == size.transitions + size.observations + size.rewards


@given(factored_models())
def test_sizes_of_small_models_are_close(model):
    size, (transitions, observations, rewards) = model.matrix_size, made(model)
    assert size.transitions == pytest.approx(transitions, rel=0.3)
    assert size.observations == pytest.approx(observations, rel=0.3)
    assert size.rewards == rewards


def test_the_size_of_six_fire_fighters_takes_no_matrices():
    """As matrices this model takes gigabytes and more than a minute."""
    model = mdm.problems.fire_fighting(houses=3, team=6)
    assert 1e9 < model.matrix_size.transitions < 4e9
    assert model.matrix_size.rewards == 27 * 4**6 * 3**6 * np.dtype(float).itemsize
    assert "_flat" not in vars(model)
