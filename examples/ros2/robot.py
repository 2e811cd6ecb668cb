"""A robot of ROS 2 to try patrol.toml with: it drives straight on, and its battery empties by that.

It has the topics and actions of a robot with Nav2: /amcl_pose while it moves, /battery_state, /navigate_to_pose and
/dock_robot; and hears /cmd_vel. Needs rclpy and nav2_msgs.
"""

import math
from contextlib import suppress

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav2_msgs.action import DockRobot, NavigateToPose
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import BatteryState

SPEED = 2.0  # metres a second
PERIOD = 0.1  # seconds from one step to the next
DRAIN = 0.04  # of the battery, a metre
CHARGE = 0.5  # of the battery, a second
DOCK = (2.0, 3.0)


class Robot(Node):
    """Drives to one goal at a time: a new one aborts the one before, as Nav2 does."""

    def __init__(self):
        super().__init__("robot")
        self.x, self.y, self.battery = *DOCK, 1.0
        self.goal = self.target = self.over = None
        self.stands = False
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.poses = self.create_publisher(PoseWithCovarianceStamped, "/amcl_pose", kept)
        self.batteries = self.create_publisher(BatteryState, "/battery_state", 10)
        self.create_subscription(Twist, "/cmd_vel", self.stop, 10)
        group = ReentrantCallbackGroup()
        self.servers = [
            ActionServer(
                self, kind, name, pursue, callback_group=group, cancel_callback=lambda _: CancelResponse.ACCEPT
            )
            for kind, name, pursue in (
                (NavigateToPose, "/navigate_to_pose", self.navigate),
                (DockRobot, "/dock_robot", self.dock),
            )
        ]
        self.create_timer(PERIOD, self.step)
        self.create_timer(0.5, self.tell_battery)
        self.tell_pose()

    async def navigate(self, goal):
        """Pursue a goal of NavigateToPose."""
        at = goal.request.pose.pose.position
        return await self.pursue(goal, (at.x, at.y), NavigateToPose)

    async def dock(self, goal):
        """Pursue a goal of DockRobot, which ends when the battery is full."""
        return await self.pursue(goal, DOCK, DockRobot)

    async def pursue(self, goal, target, kind):
        """Drive to a target, until the goal is over."""
        if self.goal is not None:
            self.over.set_result(self.goal.abort)
        print(f"goes to {target[0]:.1f}, {target[1]:.1f}{' to dock' if kind is DockRobot else ''}", flush=True)
        self.goal, self.target, self.over, self.stands = goal, target, Future(), False
        end = await self.over
        end()
        return kind.Result()

    def finish(self, end):
        """End the goal."""
        self.goal, over = None, self.over
        over.set_result(end)

    def step(self):
        """Go on for a tenth of a second."""
        goal = self.goal
        if goal is None:
            return
        if goal.is_cancel_requested:
            self.finish(goal.canceled)
            return
        left = math.dist((self.x, self.y), self.target)
        docks = isinstance(goal.request, DockRobot.Goal)
        if left > 0.01:
            share = min(SPEED * PERIOD / left, 1.0)
            self.x += share * (self.target[0] - self.x)
            self.y += share * (self.target[1] - self.y)
            self.battery = max(self.battery - DRAIN * share * left, 0.0)
            self.tell_pose()
        elif docks and self.battery < 1.0:
            self.battery = min(self.battery + CHARGE * PERIOD, 1.0)
        else:
            print("is charged" if docks else f"is at {self.x:.1f}, {self.y:.1f}", flush=True)
            self.finish(goal.succeed)
            return
        goal.publish_feedback(DockRobot.Feedback() if docks else NavigateToPose.Feedback(distance_remaining=left))

    def stop(self, twist):
        """Stand still at a zero Twist."""
        if not self.stands and not twist.linear.x and not twist.angular.z:
            self.stands = True
            print("stands still", flush=True)

    def tell_pose(self):
        """Publish where it is."""
        message = PoseWithCovarianceStamped()
        message.header.frame_id, message.header.stamp = "map", self.get_clock().now().to_msg()
        message.pose.pose.position.x, message.pose.pose.position.y = self.x, self.y
        message.pose.pose.orientation.w = 1.0
        message.pose.covariance[0] = message.pose.covariance[7] = 0.02
        self.poses.publish(message)

    def tell_battery(self):
        """Publish how full the battery is."""
        self.batteries.publish(BatteryState(percentage=self.battery, present=True))


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Robot())
