"""ROS 2 by one link: topics are sensors; goals, services and topics are actions; ROS sees how the robot does."""

from mdm.ros2.actions import Actions
from mdm.ros2.conditions import Condition
from mdm.ros2.inputs import Topic
from mdm.ros2.link import Link
from mdm.ros2.navigator import GoalNavigator, NavigatorTable
from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.wire import Quality, Wire, WireError

__all__ = [
    "Actions",
    "Condition",
    "GoalNavigator",
    "Link",
    "NavigatorTable",
    "Quality",
    "RclpyWire",
    "Topic",
    "Wire",
    "WireError",
]
