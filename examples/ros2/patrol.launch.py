"""Starts the patrol, and with `simulated:=true` the robot of robot.py beside it: ros2 launch patrol.launch.py."""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

HERE = Path(__file__).parent


def generate_launch_description():
    """Return both processes; the patrol has 20 s for its safe action before it is killed."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("simulated", default_value="false", description="start a simulated robot, too"),
            ExecuteProcess(
                cmd=[sys.executable, str(HERE / "robot.py")],
                output="screen",
                condition=IfCondition(LaunchConfiguration("simulated")),
            ),
            ExecuteProcess(
                cmd=[sys.executable, "-m", "mdm", "run", str(HERE / "patrol.toml")],
                output="screen",
                sigterm_timeout="20",
                sigkill_timeout="20",
            ),
        ]
    )
