"""A hundred random goals and pre-emptions against a real server; `make chaos` has a thousand."""

from __future__ import annotations

import asyncio

import pytest
from ros2.pursuits import run

pytestmark = pytest.mark.slow


def test_of_random_goals_never_two_are_live_and_each_end_is_told(ros, tmp_path):
    seen = asyncio.run(run(ros, tmp_path, 100, 3))
    assert seen.violations() == []
    assert seen.accepted >= 100
    told = {status for status, _ in seen.ends.values()}
    assert told == {"succeeded", "failed", "preempted"}
