"""Problems against the numbers that MADP has for them."""

from __future__ import annotations

import figures
import numpy as np
import pytest
from random_models import dense


def weighted(array, *axes):
    """Return the sum of an array's numbers by weights that tell apart where they stand, as the figures have it.

    The axes say which of the four multipliers each axis of the array takes.
    """
    places = np.indices(array.shape)
    total = sum(places[axis] * (7919, 104729, 1299709, 15485863)[which] for axis, which in enumerate(axes))
    return float((array * (total % 1000003 / 1000003)).sum())


@pytest.mark.parametrize("problem", figures.COMPUTED)
def test_numbers_are_those_of_madp(problem):
    checksums, found = figures.of(problem)["checksums"], figures.model(problem)
    actions = range(len(found.action_space))
    transitions = np.stack([dense(found.transition_matrix(action)) for action in actions], axis=1)
    assert weighted(transitions, 0, 1, 2) == pytest.approx(checksums["T"], rel=1e-12)
    assert weighted(found.rewards, 0, 1) == pytest.approx(checksums["R"], rel=1e-12)
    if "O" in checksums:
        observations = np.stack([found.observation_matrix(action) for action in actions])
        assert weighted(observations, 0, 1, 2) == pytest.approx(checksums["O"], rel=1e-12)
