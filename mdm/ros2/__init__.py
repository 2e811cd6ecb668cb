"""ROS 2 by one link: topics are sensors; goals, services and topics are actions; ROS sees how the robot does."""

from mdm.ros2.conditions import Condition
from mdm.ros2.inputs import Topic
from mdm.ros2.link import Link
from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.wire import Quality, Wire, WireError

__all__ = ["Condition", "Link", "Quality", "RclpyWire", "Topic", "Wire", "WireError"]
