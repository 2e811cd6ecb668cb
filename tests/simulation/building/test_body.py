"""Bodies: where they are, as a pose and as a cell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mdm.maps import Frame, Pose
from mdm.maps.paths import Paths
from mdm.simulation.building.body import Body


class Thing(Body):
    remaining, turns = 0.0, ()

    def steer(self, seconds, bodies=()):
        pass


def thing(x, y):
    """Return a body on a floor of 5 x 5 metres, the middle row of which is open."""
    free = np.zeros((5, 5), dtype=bool)
    free[2, 1:4] = True
    agent = SimpleNamespace(radius=0.25, position=(x, y), orientation=0.5)
    return Thing("thing", agent, Paths(Frame(5, 5, 1.0), free))


def test_a_body_is_where_its_agent_is():
    assert thing(1.5, 2.25).pose == Pose(1.5, 2.25, 0.5)
    assert thing(1.5, 2.25).radius == 0.25


@pytest.mark.parametrize(
    ("point", "cell"),
    [
        ((1.5, 2.5), (2, 1)),
        ((3.9, 2.1), (2, 3)),
        ((3.5, 1.5), (2, 3)),  # pushed against a wall
        ((4.5, 2.5), (2, 3)),
        ((0.5, 4.5), (2, 1)),
        ((-9.0, -9.0), (2, 1)),  # off the floor
    ],
)
def test_the_cell_of_a_body_is_the_nearest_one_where_it_may_be(point, cell):
    assert thing(*point).cell == cell
