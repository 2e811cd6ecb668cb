"""Topics of a real ROS 2 as the input of a robot from a file, run by the command."""

from __future__ import annotations

import asyncio
import signal

import pytest
from ros2.environment import programs

from mdm.testing import replay

pytestmark = pytest.mark.slow

FILE = """
tasks = ["robot_code:watch"]

[ros2]
node = "patrol"

[predicates]
Near = { topic = "/scan", type = "sensor_msgs/msg/LaserScan", when = "robot_code:is_near" }

[predicates.Low]
topic = "/battery_state"
type = "sensor_msgs/msg/BatteryState"
when = "percentage < 0.2 until > 0.3"
max_age = 1.0

[events.Bumped]
topic = "/bumper"
type = "std_msgs/msg/Bool"
when = "data"
qos = { depth = 1000, reliability = "reliable" }

[ensembles.top]
policy = [0, 1]
safe_action = "robot_code:brake"
states = { low = ["Low"] }
actions = { Drive = "robot_code:drive", Dock = "robot_code:dock" }
"""

CODE = """
import asyncio, json
def say(**told):
    print(json.dumps(told), flush=True)
def drive(): say(acts="drive")
def dock(): say(acts="dock")
def brake(): say(acts="brake")
def is_near(scan):
    return min(scan.ranges) < 0.5 if len(scan.ranges) else None
async def watch(system):
    runtime = system.runtime
    runtime.faults.subscribe(lambda fault: say(fault=fault.kind, source=fault.source, detail=fault.detail))
    bumps = 0
    async for update in system.predicates.events.stream(capacity=10_000):
        bumps += update.events.count("Bumped")
        say(bumps=bumps, near=system.predicates.value("Near"), heard=system.extensions[0].topics["/scan"].heard)
"""


RUN = ("-m", "mdm", "run", "robot.toml", "--record", "run.mcap")


def test_a_battery_decides_and_a_silent_topic_makes_safe(ros, tmp_path):
    (tmp_path / "robot.toml").write_text(FILE)
    (tmp_path / "robot_code.py").write_text(CODE)
    battery = {"publish": "/battery_state", "type": "sensor_msgs/msg/BatteryState", "rate": 20}

    async def main():
        async with programs(ros, tmp_path) as here:
            peer, robot = await asyncio.gather(here.peer(), here.start(*RUN))
            for percentage, acts in ((0.9, "drive"), (0.1, "dock")):
                peer.tell(**battery, message={"percentage": percentage})
                assert (await robot.hear("acts"))["acts"] == acts
            peer.tell(**battery, message={"percentage": 0.25})
            peer.tell(**battery, message={"percentage": 0.35})
            assert (await robot.hear("acts"))["acts"] == "drive"
            peer.tell(**{**battery, "rate": 0}, message={"percentage": 0.35})
            fault = await robot.hear("fault", where=lambda event: event["fault"] != "clock")
            assert (fault["fault"], fault["source"]) == ("stale", "predicates")
            assert (await robot.hear("acts"))["acts"] == "brake"
            peer.tell(**battery, message={"percentage": 0.35})
            assert (await robot.hear("acts"))["acts"] == "drive"
            peer.tell(publish="/scan", type="sensor_msgs/msg/LaserScan", message={"ranges": [2.0, 0.4]}, rate=50)
            bumper = {"publish": "/bumper", "type": "std_msgs/msg/Bool"}
            peer.tell(**bumper, quiet=True)
            peer.tell(matched="/bumper")
            await peer.hear("matched")
            for _ in range(100):
                peer.tell(**bumper, message={"data": True})
                peer.tell(**bumper, message={"data": False})
            await robot.hear("bumps", where=lambda event: event["bumps"] == 100)
            peer.tell(publish="/scan", type="sensor_msgs/msg/LaserScan", message={"ranges": [2.0, 0.4]}, rate=50)
            while not (await bump(peer, robot, bumper))["near"]:
                await asyncio.sleep(0.1)
            robot.signal(signal.SIGTERM)
            await robot.rest()

    async def bump(peer, robot, bumper):
        peer.tell(**bumper, message={"data": True})
        return await robot.hear("bumps")

    asyncio.run(main())
    # What came is in the record, by which it decides alike in an interpreter that has no rclpy.
    assert replay(tmp_path / "run.mcap") >= 4
