"""Twenty random schedules of what may happen to a robot of ROS; `make chaos` plays 500."""

from __future__ import annotations

import asyncio

import pytest
from ros2.schedules import DISTURBANCES, STATES, Schedule, play

pytestmark = pytest.mark.slow

SEEDS = range(4, 24)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_safe_action_reaches_the_robot_in_each_schedule(ros, tmp_path, seed):
    asyncio.run(play(ros, tmp_path, seed))


def test_these_schedules_have_all_that_may_happen():
    schedules = [Schedule(seed) for seed in SEEDS]
    assert {schedule.state for schedule in schedules} == set(STATES)
    assert {each for schedule in schedules for each in schedule.disturbances} == set(DISTURBANCES)
