"""The program of the page on ROS, beside a robot by rclpy itself, where its wheels can be had.

They are installed into an environment of their own, by pip as it is configured; MDM_ROS_INDEX names another index.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import sysconfig
import tempfile
from contextlib import asynccontextmanager
from pathlib import Path

import blocks
import pytest
from peers import Peer
from places import ROOT

pytestmark = pytest.mark.slow

WHEELS = [f"ros-kilted-{name}" for name in ("rclpy", "rmw-fastrtps-cpp", "sensor-msgs", "action-msgs", "test-msgs")]
STAND_IN = "from test_msgs.action import Fibonacci as DockRobot\n"
"""Nav2's messages are not among the wheels; the page's program uses of its action that it is one, and no field."""


@pytest.fixture(scope="module")
def ros():
    """Give the interpreter of an environment with rclpy."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        python = Path(folder) / "bin" / "python"
        index = os.environ.get("MDM_ROS_INDEX")
        options = ["--quiet", "--disable-pip-version-check", *([] if index is None else ["--index-url", index])]
        done = subprocess.run([python, "-m", "pip", "install", *options, *WHEELS], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"rclpy's wheels cannot be had: {done.stderr.strip().rpartition(chr(10))[2]}")
        yield python


@asynccontextmanager
async def program(python, path, **environment):
    """Run a program, and end it."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *(python, path), stdin=pipe, stdout=pipe, stderr=pipe, env={**os.environ, **environment}
    )
    try:
        yield Peer(process)
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


def test_the_program_of_the_page_docks_and_ends_its_goal_with_itself(ros, tmp_path):
    messages = tmp_path / "nav2_msgs"
    messages.mkdir()
    (messages / "__init__.py").touch()
    (messages / "action.py").write_text(STAND_IN)
    page = tmp_path / "page.py"
    [text] = blocks.texts("docs/how-to.md", "python", "## … connect to ROS?")
    page.write_text(text)
    ours = [tmp_path, ROOT, *{sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}]
    environment = {
        "PYTHONPATH": os.pathsep.join(map(str, ours)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(os.getpid() % 100 + 1),
    }

    async def main():
        peer = ROOT / "tests" / "ros_peer_program.py"
        async with program(ros, peer, **environment) as robot, program(ros, page, **environment) as docking:
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
            errors = (await docking.process.stderr.read()).decode()
            assert "Traceback" not in errors
            assert "terminate called" not in errors

    asyncio.run(main())
