"""The demo's patrol over ROS: its rooms are predicates by /amcl_pose, and its ways goals of NavigateToPose.

``python -m ros2.patrol 120`` has the robot patrol for so many seconds, and says where it came.
"""

from __future__ import annotations

import asyncio
import signal
import sys
import tempfile
import time
from pathlib import Path

from places import EXAMPLES
from ros2.environment import HERE, Watched, generated, interpreter, once, programs, where_possible

DEMO = EXAMPLES / "patrol"

SYSTEM = f"""
[ros2]
node = "patrol"

[places]
graph = "{DEMO}/floor.xml"
grid = "{DEMO}/floor.yaml"
labels = "{DEMO}/labels.png"
margin = 0.2
pose = {{ topic = "/amcl_pose", covariance = 0.5 }}
max_age = 5.0
navigator = {{ ros2 = {{ action = "/navigate_to_pose", type = "nav2_msgs/action/NavigateToPose", silence = 5.0 }} }}

[predicates]
HalfwayThrough = {{ set = "ElevatorHallway.at_goal", reset = "SoccerField.at_goal" }}

[ensembles.patrol]
model = "{DEMO}/patrol.npz"
policy = "{DEMO}/patrol.policy"
on_failed_action = "decide"
safe_action = {{ publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", rate = 20.0, until = 0.2 }}

[ensembles.patrol.states]
halfway = {{ yes = "HalfwayThrough" }}

[ensembles.patrol.states.position]
ElevatorHallway = "ElevatorHallway.reached"
WestCorridor = "WestCorridor.reached"
CoffeeRoom = "CoffeeRoom.reached"
SouthCorridor = "SouthCorridor.reached"
LRM = "LRM.reached"
SoccerField = "SoccerField.reached"

[ensembles.patrol.actions]
Up = {{ way = "Up", then = "decide" }}
Down = {{ way = "Down", then = "decide" }}
Left = {{ way = "Left", then = "decide" }}
Right = {{ way = "Right", then = "decide" }}
"""


async def patrol(python, nav2, folder, enough):
    """Patrol until ``enough`` of what the robot has said holds, and end by a signal; return what both have said."""
    async with programs(python, folder, nav2) as here:
        robot = Watched(await here.start(HERE / "demo_robot_program.py", DEMO))
        await robot.says("spins")
        system = Watched(await here.system(SYSTEM))
        base = Watched(await here.peer("base"))
        base.tell(echo="/cmd_vel", type="geometry_msgs/msg/Twist")
        base.tell(matched="/cmd_vel")
        await base.says("matched")
        await robot.until(lambda: enough(robot.said))
        system.program.signal(signal.SIGTERM)
        await base.says("heard")
        assert await system.ended() == 128 + signal.SIGTERM
        assert "Traceback" not in system.program.said.read_text()
        return robot.said, system.said


def main():
    seconds = float(sys.argv[1])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = interpreter(folder)
        nav2 = once(folder, "nav2", generated(python))
        begin = time.monotonic()
        said, told = asyncio.run(patrol(python, nav2, folder, lambda _: time.monotonic() - begin > seconds))
    goals = {(round(event["x"], 1), round(event["y"], 1)) for event in said if "goal" in event}
    ends = [event["status"] for event in said if "ended" in event]
    faults = [event for event in told if "fault" in event]
    lives = [event["status"] for event in told if event.get("status") not in {None, "running"} and "life" in event]
    print(f"{len(ends)} goals to {len(goals)} rooms: {', '.join(f'{ends.count(each)} {each}' for each in set(ends))}")
    print(f"actions: {', '.join(f'{lives.count(each)} {each}' for each in set(lives))}; {len(faults)} faults")
    for fault in faults:
        print(f"  {fault['source']} {fault['fault']}: {fault['detail']}")
    sys.exit(not (len(goals) >= 5 and lives.count("succeeded") >= 5))


if __name__ == "__main__":
    where_possible(main)
