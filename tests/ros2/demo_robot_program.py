"""The demo's robot behind NavigateToPose: it drives on the demo's floor in real time, and tells where it is.

A new goal replaces the one that it pursues, which is aborted, as Nav2 does. It prints each goal, and how it ended.
"""

import asyncio
import json
import math
import sys
import threading
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

import mdm
from mdm.maps import Pose, load_map
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building
from mdm.simulation.building.robot import DriveError

DEMO = Path(sys.argv[1])


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def message_of(pose):
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map"
    message.pose.pose.position.x, message.pose.pose.position.y = pose.x, pose.y
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)
    message.pose.covariance[0] = message.pose.covariance[7] = 0.05**2
    return message


class Driver:
    """Pursues goals: rclpy's thread takes them, and the event loop drives."""

    def __init__(self, node, executor, robot, loop):
        self.executor, self.robot, self.loop = executor, robot, loop
        self.task, self.number = None, 0
        self.poses = node.create_publisher(PoseWithCovarianceStamped, "/amcl_pose", 10)
        self.server = ActionServer(
            *(node, NavigateToPose, "/navigate_to_pose", self.pursue),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    async def pursue(self, handle):
        over = Future()
        self.loop.call_soon_threadsafe(self.drive, handle, over)
        status = await over
        getattr(handle, status)()
        return NavigateToPose.Result()

    def drive(self, handle, over):
        if self.task is not None:
            self.task.cancel()
        self.number += 1
        self.task = self.loop.create_task(self.go(handle, over, self.number))

    async def go(self, handle, over, number):
        at, q = handle.request.pose.pose.position, handle.request.pose.pose.orientation
        tell(goal=number, x=at.x, y=at.y)
        driving = self.loop.create_task(self.robot.go(Pose(at.x, at.y, 2 * math.atan2(q.z, q.w))))
        status = "abort"
        try:
            while not driving.done():
                await asyncio.wait([driving], timeout=0.1)
                if handle.is_cancel_requested:
                    driving.cancel()
                    status = "canceled"
                elif not driving.done() and self.number == number:
                    handle.publish_feedback(NavigateToPose.Feedback(distance_remaining=self.robot.remaining))
            if status != "canceled":
                driving.result()
                status = "succeed"
        except DriveError as error:
            tell(error=str(error))
        finally:
            driving.cancel()
            tell(ended=number, status=status)
            over.set_result(status)
            self.executor.wake()


async def main():
    floor = load_map(DEMO / "floor.xml", grid=DEMO / "floor.yaml", labels=DEMO / "labels.png")
    building = Building(floor, seed=3)
    robot = building.robot("robot", at=floor.graph.names[0], speed=2.0, noise=0.05)
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("robot", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    driver = Driver(node, executor, robot, asyncio.get_running_loop())
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        async with mdm.Runtime(log=None) as runtime:
            runtime.channel("building/robot/pose", PoseUpdate).subscribe(
                lambda it: driver.poses.publish(message_of(it))
            )
            await runtime.start(building)
            tell(spins=True)
            await runtime.wait()
    finally:
        executor.shutdown()
        thread.join()
        rclpy.shutdown(context=context)


mdm.run(main)
