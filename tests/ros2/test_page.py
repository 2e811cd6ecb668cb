"""The program of the page on ROS, beside a robot by rclpy itself."""

from __future__ import annotations

import asyncio

import blocks
import pytest
from places import ROOT
from ros2.environment import programs

pytestmark = pytest.mark.slow


def test_the_program_of_the_page_docks_and_ends_its_goal_with_itself(ros, nav2, tmp_path):
    page = tmp_path / "page.py"
    [text] = blocks.texts("docs/how-to.md", "python", "## … connect to ROS?")
    page.write_text(text)

    async def main():
        async with programs(ros, tmp_path, nav2) as here:
            robot = await here.start(ROOT / "tests" / "ros_peer_program.py")
            docking = await here.start(page)
            await robot.hear("met")
            robot.tell(battery=0.1)
            assert await robot.hear("goal") == {"goal": 1}
            robot.tell(battery=0.9)
            assert await robot.hear("cancelled", "reached") == {"cancelled": 1}
            robot.tell(battery=0.1)
            assert await robot.hear("goal") == {"goal": 2}
            robot.tell(succeed=True)
            assert await robot.hear("cancelled", "reached") == {"reached": 2}
            robot.tell(toggle=True)  # full for long enough to be noticed, then low
            await robot.hear("goal")
            docking.process.terminate()
            await robot.hear("cancelled")  # by the end of the program
            assert await docking.end() == 143
            errors = docking.said.read_text()
            assert "Traceback" not in errors
            assert "terminate called" not in errors

    asyncio.run(main())
