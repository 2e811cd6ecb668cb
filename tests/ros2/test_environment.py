"""The peers that tests have, by each other."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from ros2.environment import programs

pytestmark = pytest.mark.slow

CLIENT = """
import json
import rclpy
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient

def hear(message):
    told = message.feedback
    values = [told.distance_remaining, told.number_of_recoveries, told.navigation_time.sec]
    print(json.dumps({"feedback": values}), flush=True)

rclpy.init()
node = rclpy.create_node("client")
client = ActionClient(node, NavigateToPose, "/navigate_to_pose")
client.wait_for_server()
goal = NavigateToPose.Goal(behavior_tree="tree")
goal.pose.pose.position.x, goal.pose.pose.position.y = 1.5, -2.0
sent = client.send_goal_async(goal, feedback_callback=hear)
rclpy.spin_until_future_complete(node, sent)
ended = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, ended)
end = ended.result()
print(json.dumps({"end": [end.status, end.result.error_code, end.result.error_msg]}), flush=True)
"""


def test_two_peers_speak_to_each_other(ros, tmp_path):
    async def main():
        async with programs(ros, tmp_path) as here:
            one, other = await asyncio.gather(here.peer("one"), here.peer("other"))
            one.tell(publish="/level", type="std_msgs/msg/Float64", message={"data": 0.5}, rate=20)
            other.tell(echo="/level", type="std_msgs/msg/Float64")
            assert await other.hear("heard") == {"heard": "/level", "message": {"data": 0.5}}
            one.tell(serve="/lamp", type="std_srvs/srv/SetBool", response={"success": True, "message": "on"})
            other.tell(call="/lamp", type="std_srvs/srv/SetBool", request={"data": True})
            assert await one.hear("request") == {"request": "/lamp", "fields": {"data": True}}
            answered = await other.hear("response")
            assert answered == {"response": "/lamp", "fields": {"success": True, "message": "on"}}

    asyncio.run(main())


def mapped(number):
    """Return what of memory a process has mapped."""
    return Path(f"/proc/{number}/maps").read_text()


@pytest.mark.parametrize("leaves", [True, False])
def test_programs_may_leave_fast_dds_shared_memory(ros, tmp_path, leaves):
    async def main():
        async with programs(ros, tmp_path) as here:
            if leaves:
                here.leave_shared_memory()
            one, other = await asyncio.gather(here.peer("one"), here.peer("other"))
            one.tell(publish="/level", type="std_msgs/msg/Float64", message={"data": 0.5}, rate=20)
            other.tell(echo="/level", type="std_msgs/msg/Float64")
            await other.hear("heard")
            assert ("/dev/shm/fast" in mapped(other.process.pid)) is not leaves

    asyncio.run(main())


def test_actions_of_nav2_are_generated_and_carried(ros, nav2, tmp_path):
    """Fields of each kind arrive, and a goal is accepted, fed back and ended by command; by one of rclpy's clients."""
    client = tmp_path / "client.py"
    client.write_text(CLIENT)

    async def main():
        async with programs(ros, tmp_path, nav2) as here:
            robot = await here.peer()
            robot.tell(act="/navigate_to_pose", type="nav2_msgs/action/NavigateToPose", answer=None)
            asking = await here.start(client)
            goal = (await robot.hear("goal"))["fields"]
            assert goal["behavior_tree"] == "tree"
            assert goal["pose"]["pose"]["position"] == {"x": 1.5, "y": -2.0, "z": 0.0}
            robot.tell(answer=True)
            assert (await robot.hear("accepted"))["live"] == 1
            robot.tell(feedback={"distance_remaining": 0.5, "number_of_recoveries": 3, "navigation_time": {"sec": 7}})
            assert await asking.hear("feedback") == {"feedback": [0.5, 3, 7]}
            robot.tell(finish=6, result={"error_code": 104, "error_msg": "no way"})
            assert await asking.hear("end") == {"end": [6, 104, "no way"]}

    asyncio.run(main())
