"""The demo's robot behind NavigateToPose, which patrols; `make chaos` has it patrol for two minutes."""

from __future__ import annotations

import asyncio

import pytest
from ros2.patrol import patrol

pytestmark = pytest.mark.slow


def test_the_demo_patrols_rooms_by_navigate_to_pose(ros, nav2, tmp_path):
    pytest.importorskip("navground")

    def enough(said):
        reached = {event["ended"] for event in said if event.get("status") == "succeed"}
        return len({(event["x"], event["y"]) for event in said if event.get("goal") in reached}) >= 2

    _, told = asyncio.run(patrol(ros, nav2, tmp_path, enough))
    ends = [event["status"] for event in told if "life" in event and event["status"] != "running"]
    assert ends.count("succeeded") >= 2
    assert set(ends) <= {"succeeded", "preempted"}
