"""Brakes: whatever steers them, bodies stay apart, by plain geometry."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from mdm.maps import Frame, Grid, Pose
from mdm.simulation.building.brakes import GAP, Brakes

SIDE, RADIUS = 0.05, 0.25


def hall(size=6.0):
    cells = round(size / SIDE)
    free = np.ones((cells, cells), dtype=bool)
    return Grid(Frame(cells, cells, SIDE), free, ~free)


def body(x, y, yaw, radius=RADIUS):
    return SimpleNamespace(
        pose=Pose(x, y, yaw), radius=radius, agent=SimpleNamespace(position=np.array([x, y], dtype=np.float32))
    )


def driven(one, metres):
    return one.pose.x + metres * math.cos(one.pose.yaw), one.pose.y + metres * math.sin(one.pose.yaw)


@pytest.mark.parametrize("seed", range(20))
def test_bodies_that_drive_as_they_like_never_touch(seed):
    random, brakes = np.random.default_rng(seed), Brakes(hall())
    bodies = [body(x, y, float(random.uniform(-4, 4))) for x in (1.5, 3.0, 4.5) for y in (1.5, 3.0, 4.5)]
    for _ in range(200):
        wanted = random.uniform(-0.05, 0.1, size=len(bodies)).tolist()
        turns = random.normal(scale=0.3, size=len(bodies)).tolist()
        shares = [brakes.share(*each, bodies) for each in zip(bodies, wanted, turns, strict=True)]
        assert all(0.0 <= share <= 1.0 for share in shares)
        points = [driven(one, share * metres) for one, share, metres in zip(bodies, shares, wanted, strict=True)]
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
