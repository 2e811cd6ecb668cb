"""The belief over places: shares of particles, beside what is believed of other factors."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, strategies as st
from rows_of_rooms import row_of_rooms
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error
from mdm.maps import Floors, Frame, Labels, PlaceBelief
from mdm.models import POMDP, Factor, Space
from mdm.testing import probe, run_virtual

THREE = row_of_rooms("A", "B", "C", gap=1.0)


def robot(*factors, start=None):
    """An ensemble that decides on beliefs over these factors; nothing changes by itself."""
    space = Space(factors)
    model = POMDP(
        [np.eye(len(space))],
        [np.ones((len(space), 1))],
        np.zeros((len(space), 1)),
        discount=0.9,
        states=space,
        actions=["Look"],
        initial_belief=start,
    )
    policy = mdm.policies.AlphaVectors(np.zeros((1, len(space))), [0])
    return mdm.Ensemble("robot", policy=policy, model=model, actions={"Look": lambda: None})


def believe(ensemble, *arguments, floor=THREE, factor="position"):
    """Return the belief after particles, and the faults."""

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        place_belief = PlaceBelief(floor, ensemble, factor)
        await runtime.start(place_belief)
        place_belief.see(*arguments)
        return ensemble.control.belief, faults, place_belief.unplaced

    return run_virtual(main)


def test_the_belief_is_the_share_of_the_particles():
    belief, faults, unplaced = believe(robot(Factor("position", ["C", "A", "B"])), [1, 2, 6, 11], [1, 1, 1, 1])
    assert belief.tolist() == [0.25, 0.5, 0.25]
    assert (faults, unplaced) == ([], 0.0)


def test_weights_count_and_particles_in_no_place_do_not():
    x, y, weights = [1, 6, 4.5, 99, math.nan], [1, 1, 1, 1, 1], [3, 1, 4, 4, 4]
    belief, faults, unplaced = believe(robot(Factor("room", ["A", "B", "C"])), x, y, weights)
    assert belief.tolist() == [0.75, 0.25, 0]
    assert (faults, unplaced) == ([], 0.75)


@pytest.mark.parametrize("first", [True, False])
def test_other_factors_keep_their_belief(first):
    factors = [Factor("position", ["A", "B", "C"]), Factor("fire", ["no", "yes"])]
    start = np.outer([0.5, 0.5, 0.0], [0.9, 0.1])
    ensemble = robot(*(factors if first else factors[::-1]), start=(start if first else start.T).ravel())
    belief, _, _ = believe(ensemble, [11, 11, 11, 6], [1, 1, 1, 1])
    wanted = np.outer([0, 0.25, 0.75], [0.9, 0.1])
    assert belief == pytest.approx((wanted if first else wanted.T).ravel())


@pytest.mark.parametrize(
    "particles",
    [
        ([], []),
        ([99], [1]),
        ([1], [1], [0]),
        ([1], [1], [-1]),
        ([1, 6], [1, 1], [-1, 2]),
        ([1, 6], [1, 1], [math.nan, 1]),
    ],
)
def test_particles_that_tell_nothing_leave_the_belief_and_are_a_fault(particles):
    belief, faults, _ = believe(robot(Factor("position", ["A", "B", "C"]), Factor("fire", ["no", "yes"])), *particles)
    assert belief == pytest.approx(np.full(6, 1 / 6))
    assert [fault.kind for fault in faults] == ["particles"]


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_particles_beyond_all_numbers_lie_in_no_place(yaw):
    floor = row_of_rooms("A", "B", "C").labels
    frame = Frame(*floor.frame.shape, floor.frame.resolution, 0.0, 0.0, yaw)
    place_belief = PlaceBelief(Labels(frame, floor.raster, floor.names), on_three_places())
    x, y = np.array([1e308, -math.inf, 1.0]), np.array([1e308, math.inf, 1.0])
    assert list(place_belief._places(mdm.messages.ParticleUpdate(0, x, y))) == [1, 0, 0]
    assert place_belief.unplaced == pytest.approx(2 / 3)
    assert place_belief._places(mdm.messages.ParticleUpdate(0, x, y, np.full(3, 1e308))) is None


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.4, math.pi]))
def test_shares_are_those_of_a_plain_count(seed, yaw):
    random = np.random.default_rng(seed)
    raster = random.integers(1, 4, size=(6, 8)).astype(np.uint16)
    raster[random.random(raster.shape) < 0.2] = 0
    labels = Labels(Frame(6, 8, 0.5, -1.0, 2.0, yaw), raster, ("A", "B", "C"))
    x, y = random.normal(scale=3, size=200), random.normal(2, 3, size=200)
    place_belief = PlaceBelief(labels, on_three_places())
    found = [labels.name(*point) for point in zip(x, y, strict=True)]
    counts = np.array([found.count(name) for name in "ABC"])
    update = mdm.messages.ParticleUpdate(0, x, y)
    shares = place_belief._places(update)
    assert shares is None if not counts.sum() else shares == pytest.approx(counts / counts.sum())


@cache
def on_three_places():
    return robot(Factor("position", ["A", "B", "C"]))


def test_what_does_not_fit_is_refused():
    table = mdm.Ensemble("table", policy=[0, 0, 0], actions={"Look": print})
    with refused(ConfigError):
        PlaceBelief(THREE, table)
    two = robot(Factor("room", ["A", "B", "C"]), Factor("fire", ["no", "yes"]))
    with refused(ConfigError):
        PlaceBelief(THREE, two)
    assert PlaceBelief(THREE, two, "room").unplaced == 0
    with refused(ConfigError):
        PlaceBelief(THREE, robot(Factor("position", ["A", "B"])))
    with refused(ConfigError):
        PlaceBelief(THREE, robot(Factor("position", ["A", "B", "C", "D"])))
    with refused(Error):
        believe(robot(Factor("position", ["A", "B", "C"])), [1, 2], [1])
    with refused(Error):
        believe(robot(Factor("position", ["A", "B", "C"])), [[1]], [[1]])
    with refused(Error):
        believe(robot(Factor("position", ["A", "B", "C"])), ["one"], [1])


def test_particles_are_of_one_floor():
    with refused(ConfigError):
        PlaceBelief(Floors({"ground": THREE}), robot(Factor("position", ["A", "B", "C"])))
