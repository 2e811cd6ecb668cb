"""The robot that the page on ROS has a program for, by rclpy itself: a battery, and a dock that takes goals.

Each line of its input is JSON: ``{"battery": 0.1}`` is published from then on, ten times a second; ``{"toggle": true}``
has the battery full and low by turns until another goal comes, and ``{"succeed": true}`` ends the goal that it pursues.
It prints as JSON that somebody listens and may send goals, and what becomes of each goal.
"""

import json
import sys
import threading

import rclpy
from nav2_msgs.action import DockRobot
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


class Robot:
    def __init__(self, node):
        self.node = node
        self.level, self.met, self.goals = None, False, 0
        self.toggles = None
        self.succeed = threading.Event()
        self.publisher = node.create_publisher(BatteryState, "/battery_state", 10)
        group = ReentrantCallbackGroup()
        self.timer = node.create_timer(0.1, self.publish)
        self.server = ActionServer(
            *(node, DockRobot, "/dock_robot", self.pursue),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )

    def publish(self):
        clients = self.node.count_clients("/dock_robot/_action/send_goal")
        if not self.met and clients and self.publisher.get_subscription_count():
            self.met = True
            tell(met=True)
        if self.toggles is not None:
            self.toggles += 1
            self.level = 0.1 if self.toggles // 10 % 2 else 0.9
        if self.level is not None:
            self.publisher.publish(BatteryState(percentage=self.level))

    def pursue(self, handle):
        self.goals += 1
        if self.toggles is not None:
            self.toggles, self.level = None, 0.1
        self.succeed.clear()
        tell(goal=self.goals)
        while not (self.succeed.wait(0.01) or handle.is_cancel_requested):
            pass
        if handle.is_cancel_requested:
            handle.canceled()
            tell(cancelled=self.goals)
        else:
            handle.succeed()
            tell(reached=self.goals)
        return DockRobot.Result()


def main():
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("robot", context=context)
    robot = Robot(node)
    executor = MultiThreadedExecutor(4, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    for line in sys.stdin:
        said = json.loads(line)
        robot.level = said.get("battery", robot.level)
        if "toggle" in said:
            robot.toggles = 0
        if "succeed" in said:
            robot.succeed.set()
    robot.succeed.set()
    executor.shutdown()
    thread.join()
    rclpy.shutdown(context=context)


main()
