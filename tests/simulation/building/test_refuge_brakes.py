"""Brakes: whatever steers them, bodies stay apart, by plain geometry."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from mdm.maps import Frame, Grid, Pose
from mdm.simulation.building.refuge import GAP, Brakes

SIDE, RADIUS = 0.05, 0.25


def hall(size=6.0):
    cells = round(size / SIDE)
    free = np.ones((cells, cells), dtype=bool)
    return Grid(Frame(cells, cells, SIDE), free, ~free)


def body(x, y, yaw, radius=RADIUS):
    return SimpleNamespace(
        pose=Pose(x, y, yaw), radius=radius, agent=SimpleNamespace(position=np.array([x, y], dtype=np.float32))
    )


def driven(one, metres, turn):
    """Return where one comes to on an arc, as wheels lead it; of a tiny turn, straight on."""
    begin, end = one.pose.yaw, one.pose.yaw + turn
    if abs(turn) < 1e-9:
        return one.pose.x + metres * math.cos(begin), one.pose.y + metres * math.sin(begin)
    around = metres / turn
    return (
        one.pose.x + around * (math.sin(end) - math.sin(begin)),
        one.pose.y - around * (math.cos(end) - math.cos(begin)),
    )


@pytest.mark.parametrize("seed", range(20))
def test_bodies_that_drive_as_they_like_never_touch(seed):
    random, brakes = np.random.default_rng(seed), Brakes(hall())
    bodies = [body(x, y, float(random.uniform(-4, 4))) for x in (1.5, 3.0, 4.5) for y in (1.5, 3.0, 4.5)]
    for _ in range(200):
        wanted = random.uniform(-0.05, 0.1, size=len(bodies)).tolist()
        turns = random.normal(scale=0.3, size=len(bodies)).tolist()
        shares = [brakes.share(*each, bodies) for each in zip(bodies, wanted, turns, strict=True)]
        assert all(0.0 <= share <= 1.0 for share in shares)
        points = [
            driven(one, share * metres, turn)
            for one, share, metres, turn in zip(bodies, shares, wanted, turns, strict=True)
        ]
        bodies = [body(*point, one.pose.yaw + turn) for one, point, turn in zip(bodies, points, turns, strict=True)]
        for index, one in enumerate(points):
            assert min(*one, 6.0 - one[0], 6.0 - one[1]) > RADIUS
            assert all(math.dist(one, other) > 2 * RADIUS for other in points[:index])


def test_who_drives_away_is_not_braked():
    brakes = Brakes(hall())
    here = body(0.3, 3.0, 0.0)
    near = body(0.3, 3.0 + 2 * RADIUS, 0.0)  # touching
    assert brakes.share(here, 0.05, 0.0, [here, near]) == 1.0
    assert brakes.share(body(0.3, 3.0, -math.pi / 2), 0.05, 0.0, [near]) == 1.0
    assert brakes.share(body(0.3, 3.0, math.pi / 2), 0.05, 0.0, [near]) == 0.0
    assert brakes.share(here, 0.0, 1.0, [near]) == 1.0


def test_half_of_the_room_is_left_to_the_other():
    here = body(3.0, 3.0, 0.0)
    other = body(3.0 + 2 * RADIUS + GAP + 0.06, 3.0, math.pi)
    assert Brakes(hall()).share(here, 0.05, 0.0, [other]) == pytest.approx(0.6, abs=1e-4)
    assert Brakes(hall()).share(here, -0.05, 0.0, [other]) == 1.0


def test_before_a_wall_a_robot_stops():
    brakes = Brakes(hall())
    assert brakes.share(body(5.0, 3.0, 0.0), 0.1, 0.0, []) == 1.0
    assert brakes.share(body(5.7, 3.0, 0.0), 0.1, 0.0, []) == 0.25  # 0.04 m to go, and half a step would be 0.05
    assert brakes.share(body(5.74, 3.0, 0.0), 0.1, 0.0, []) == 0.0
    assert brakes.share(body(5.74, 3.0, math.pi), 0.1, 0.0, []) == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_turns_along_a_wall_comes_no_nearer_than_it_may(seed):
    random, brakes = np.random.default_rng(seed), Brakes(hall())
    one = body(3.0, 0.262, 0.0)
    for _ in range(300):
        turn = float(random.normal(scale=0.1)) - 0.5 * math.sin(one.pose.yaw)  # it holds to its way
        metres = 0.1 * brakes.share(one, 0.1, turn, [])
        _, y = driven(one, metres, turn)
        one = body(3.0, y, one.pose.yaw + turn)
        assert y >= RADIUS + GAP / 2 - 1e-6


@given(
    st.floats(0.0, math.tau), st.floats(0.0, 0.006), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5), st.floats(0.004, 0.1)
)
@example(3.811, 0.0, -0.071, 0.556, 0.007)  # the corner is farthest from its cell's centre
def test_no_corner_is_touched(around, spare, turn, aside, most):
    free = np.ones((60, 60), dtype=bool)
    free[30, 30] = False
    grid = Grid(Frame(60, 60, SIDE), free, ~free)
    x, y = grid.frame.centre(30, 30)

    def room(at):
        """Return the metres between a point and the one cell that is not free."""
        return math.hypot(*(max(abs(one - other) - SIDE / 2, 0.0) for one, other in zip(at, (x, y), strict=True)))

    away = RADIUS + SIDE
    while room((x + away * math.cos(around), y + away * math.sin(around))) > RADIUS + GAP / 2 + spare:
        away -= 1e-4
    one = body(x + away * math.cos(around), y + away * math.sin(around), around + math.pi + aside)
    metres = most * Brakes(grid).share(one, most, turn, [])
    assert room(driven(one, metres, turn)) >= min(RADIUS + GAP / 2, room((one.pose.x, one.pose.y))) - 1e-9
