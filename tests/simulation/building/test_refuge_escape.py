"""Ways out: by plain geometry they touch nothing, and lead to where there is room."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from hypothesis import example, given, strategies as st

from mdm.maps import Frame, Grid, Pose
from mdm.simulation.building.refuge import GAP, way_out

SIDE, SIZE, RADIUS, OTHER = 0.05, 80, 0.25, 0.2
TOUCH = RADIUS + OTHER
NOWHERE = np.zeros((SIZE, SIZE), dtype=bool)


def hall():
    """Return a hall of 4 m by 4 m within walls of a cell."""
    free = np.zeros((SIZE, SIZE), dtype=bool)
    free[1:-1, 1:-1] = True
    return Grid(Frame(SIZE, SIZE, SIDE), free, ~free)


def body(x, y):
    """Return what stands somewhere."""
    return SimpleNamespace(radius=OTHER, pose=Pose(x, y), agent=SimpleNamespace(position=np.array([x, y])))


def distances(one, other, at):
    """Return how far it is from a point to what is on the straight way from one to the other, at many points."""
    return [math.dist(np.add(one, np.multiply(share, np.subtract(other, one))), at) for share in np.linspace(0, 1, 41)]


@given(
    st.floats(1.3, 2.7), st.floats(1.3, 2.7),
    st.lists(st.tuples(st.floats(0, math.tau), st.floats(GAP - 0.005, 0.12)), min_size=1, max_size=3),
)  # fmt: skip
@example(1.375, 2.0, [(3.0, 0.0625), (1.5, 0.0625), (5.25, 0.0625)])  # a point off its cell's centre
def test_it_leads_past_all_that_stands_to_where_there_is_room(x, y, around):
    others = [body(x + (TOUCH + gap) * math.cos(to), y + (TOUCH + gap) * math.sin(to)) for to, gap in around]
    way = way_out((x, y), RADIUS, hall(), others, [(~NOWHERE, 0.15)])
    if len(others) < 3:  # between two there is always a way at right angles; three can lock a robot in
        assert way
    if not way:
        return
    for other in others:
        at = other.agent.position
        for one, to in zip([(x, y), *way], way, strict=False):
            apart = distances(one, to, at)
            assert min(apart) >= min(TOUCH + GAP, apart[0]) - 1e-9
        assert math.dist(way[-1], at) > TOUCH + 0.15
    assert all(
        coordinate - SIDE > RADIUS and coordinate + SIDE < SIZE * SIDE - RADIUS for at in way for coordinate in at
    )


def test_what_is_best_counts_first_and_then_the_next():
    corner = NOWHERE.copy()
    corner[40, 60] = True
    x, y = hall().frame.centre(40, 40)
    to = way_out((x, y), RADIUS, hall(), [], [(corner, 0.15), (~NOWHERE, 0.0)])
    assert to[-1] == hall().frame.centre(40, 60)
    assert len(to) >= 20 - 2  # cells, the first step leads over up to two
    assert way_out((x, y), RADIUS, hall(), [], [(NOWHERE, 0.15), (~NOWHERE, 0.0)]) == [(x, y)]
    assert way_out((x, y), RADIUS, hall(), [], [(NOWHERE, 0.15)]) == []


def test_where_all_is_shut_there_is_none():
    shut = [body(2 + 0.48 * math.cos(to), 2 + 0.48 * math.sin(to)) for to in np.arange(8) * math.tau / 8]
    assert way_out((2.0, 2.0), RADIUS, hall(), shut, [(~NOWHERE, 0.15)]) == []
