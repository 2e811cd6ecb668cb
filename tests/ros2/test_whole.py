"""Whole systems of a file beside real nodes: topics, services, actions, and what ROS sees of the robot."""

from __future__ import annotations

import asyncio
import json
import math
import signal
import subprocess
import sys

import pytest
from places import ROOT
from ros2.environment import Watched, programs

pytestmark = pytest.mark.slow

TYPES = {
    "std_msgs/msg/Bool": ("data", {"data": True}, {"data": True}),
    "std_msgs/msg/String": ('data == "go"', {"data": "go"}, {"data": 'grün "—" 你好'}),
    "std_msgs/msg/Int64": ("data >= 9007199254740993", {"data": 9007199254740993}, {"data": -9007199254740993}),
    "sensor_msgs/msg/BatteryState": (
        "percentage > 0.3 until < 0.2",
        {"percentage": 0.31},
        {"percentage": 0.5, "present": True, "power_supply_status": 2, "cell_voltage": [3.7, math.inf]},
    ),
    "sensor_msgs/msg/LaserScan": (
        "ranges[1] >= 1.5",
        {"ranges": [0.25, 1.5]},
        {"header": {"frame_id": "laser"}, "ranges": [0.5] * 1000, "angle_max": 3.5},
    ),
    "geometry_msgs/msg/Twist": (
        "angular.z > 0.1",
        {"angular": {"z": 0.2}},
        {"linear": {"x": 0.1}, "angular": {"z": -0.25}},
    ),
    "nav_msgs/msg/Odometry": (
        "pose.pose.position.x > 1",
        {"pose": {"pose": {"position": {"x": 1.5}}}},
        {
            "child_frame_id": "base",
            "pose": {"covariance": [0.5, *[0.0] * 34, 0.25]},
            "header": {"stamp": {"sec": 7, "nanosec": 9}},
        },
    ),
    "sensor_msgs/msg/JointState": (
        "position[-1] > 0.5",
        {"name": ["a", "b"], "position": [0.0, 1.0]},
        {"name": ["lift", "arm"], "position": [0.125, 2.0], "velocity": []},
    ),
    "sensor_msgs/msg/CompressedImage": (
        "data[0] == 255",
        {"data": [255, 0]},
        {"format": "jpeg", "data": [0, 127, 255]},
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        'status[0].values[0].value == "hot"',
        {"status": [{"values": [{"key": "motor", "value": "hot"}]}]},
        {"status": [{"level": 2, "name": "arm", "values": [{"key": "a", "value": "b"}, {"key": "c", "value": ""}]}]},
    ),
}
"""Of each type: a condition, a message for which it holds, and one that the robot publishes then."""


FALSE = {
    "sensor_msgs/msg/LaserScan": {"ranges": [1.5, 1.0]},
    "sensor_msgs/msg/JointState": {"position": [0.5]},
    "sensor_msgs/msg/CompressedImage": {"data": [0]},
    "diagnostic_msgs/msg/DiagnosticArray": {"status": [{"values": [{"value": "cold"}]}]},
}
"""Messages for which conditions do not hold, where zeros have not what these look at."""


def toml(value):
    """Return a value as TOML has it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return "inf" if value == math.inf else json.dumps(value)


def ensemble(index, kind, message):
    return f"""
[ensembles.e{index}]
policy = [0, 1]
states.is = {{ yes = "P{index}" }}
[ensembles.e{index}.actions]
0 = {{ publish = "/out{index}", type = "{kind}" }}
1 = {{ publish = "/out{index}", type = "{kind}", message = {toml(message)} }}
"""


def has(message, fields):
    """Whether a message has these fields, to the precision of a float32."""
    if isinstance(fields, dict):
        return all(has(message[name], value) for name, value in fields.items())
    if isinstance(fields, list):
        return len(message) == len(fields) and all(map(has, message, fields))
    return message == fields or (isinstance(fields, float) and math.isclose(message, fields, rel_tol=1e-6))


def test_ten_types_come_in_and_go_out(ros, tmp_path):
    """A message for which a condition does not hold brings zeros out, and one for which it does another message."""
    rows = list(enumerate(TYPES.items()))
    predicates = [f"P{i} = {{ topic = '/in{i}', type = '{kind}', when = '{row[0]}' }}" for i, (kind, row) in rows]
    text = "[ros2]\nnode = 'carrier'\n[predicates]\n" + "\n".join(predicates)
    text += "".join(ensemble(index, kind, row[2]) for index, (kind, row) in rows)

    async def main():
        async with programs(ros, tmp_path) as here:
            peer = Watched(await here.peer())
            for index, (kind, _) in rows:
                peer.tell(echo=f"/out{index}", type=kind)
            carrier = Watched(await here.system(text))
            for index, (kind, (_, holds, _)) in rows:
                peer.tell(publish=f"/in{index}", type=kind, turns=[FALSE.get(kind, {}), holds], rate=20)
            for index, (_, (_, _, published)) in rows:
                for other in (True, False):
                    is_so = lambda event, index=index, fields=published, other=other: (
                        event["heard"] == f"/out{index}" and has(event["message"], fields) is not other
                    )
                    await peer.says("heard", where=is_so)
            assert {event["fault"] for event in carrier.said if "fault" in event} <= {"waiting", "livelock"}

    asyncio.run(main())


SERVICES = """
[ros2]
node = "caller"
[predicates]
On = { topic = "/on", type = "std_msgs/msg/Bool", when = "data" }
[ensembles.caller]
policy = [0, 1]
states.on = { yes = "On" }
[ensembles.caller.actions]
0 = { service = "/reset", type = "std_srvs/srv/Trigger" }
1 = { service = "/lamp", type = "std_srvs/srv/SetBool", request = { data = true }, timeout = 60.0 }
"""


def test_two_services_are_called_answer_refuse_and_are_waited_for(ros, tmp_path):
    async def main():
        async with programs(ros, tmp_path) as here:
            peer = Watched(await here.peer())
            peer.tell(serve="/reset", type="std_srvs/srv/Trigger", response={"success": True})
            peer.tell(publish="/on", type="std_msgs/msg/Bool", latched=False, quiet=True)
            caller = Watched(await here.system(SERVICES))
            peer.tell(matched="/on")
            await peer.says("matched")

            async def call(on, status):
                since = len(caller.said)
                peer.tell(publish="/on", type="std_msgs/msg/Bool", message={"data": on}, rate=20)
                name = str(int(on))
                return await caller.says(
                    "life", since=since, where=lambda event: event["life"] == name and event["status"] == status
                )

            await call(False, "succeeded")
            assert peer.last("request") == {"request": "/reset", "fields": {}}
            await call(True, "running")
            await caller.says("fault", where=lambda event: "/lamp" in event["detail"])  # it waits, and says so
            peer.tell(serve="/lamp", type="std_srvs/srv/SetBool", response={"success": True})
            await caller.says("life", where=lambda event: event["life"] == "1" and event["status"] == "succeeded")
            assert peer.last("request") == {"request": "/lamp", "fields": {"data": True}}
            peer.tell(remove="/reset")
            await peer.says("removed")
            peer.tell(serve="/reset", type="std_srvs/srv/Trigger", response={"success": False, "message": "no power"})
            assert "no power" in (await call(False, "failed"))["detail"]

    asyncio.run(main())


ACTION = """
[ros2]
node = "docker"
[predicates]
Dock = { topic = "/dock", type = "std_msgs/msg/Bool", when = "data" }
[ensembles.docker]
policy = [0, 1]
states.dock = { yes = "Dock" }
safe_action = { publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", rate = 20.0, until = 0.2 }
on_failed_action = "continue"
[ensembles.docker.actions]
0 = { publish = "/lamp", type = "std_msgs/msg/Bool" }
1 = { action = "/dock_robot", type = "nav2_msgs/action/DockRobot", goal = { dock_id = "home" }, silence = 2.0 }
"""


def test_a_goal_ends_in_each_way_that_a_server_has(ros, nav2, tmp_path):
    """Each end, and the codes of the result, are told; held and killed servers are within a silence."""

    async def main():
        async with programs(ros, tmp_path, nav2) as here:
            here.leave_shared_memory()
            robot, sensor = Watched(await here.peer()), Watched(await here.peer("sensor"))
            act = {"act": "/dock_robot", "type": "nav2_msgs/action/DockRobot", "beat": 20}
            robot.tell(**act)
            sensor.tell(publish="/dock", type="std_msgs/msg/Bool", quiet=True)
            docker = Watched(await here.system(ACTION))
            sensor.tell(matched="/dock")
            await sensor.says("matched")
            robot.tell(matched="/dock_robot/_action/send_goal")
            await robot.says("matched")

            def want(dock):
                sensor.tell(publish="/dock", type="std_msgs/msg/Bool", message={"data": dock}, rate=20)

            async def told(since, *statuses):
                return await docker.says(
                    "life", since=since, where=lambda event: event["life"] == "1" and event["status"] in statuses
                )

            ends = ("succeeded", "failed", "preempted", "timed_out", "abandoned")

            async def goal(what, *, name="accepted"):
                """Send one; return how its life ends after something was done."""
                while True:
                    since, goals = len(docker.said), len(robot.said)
                    want(False)
                    await docker.until(lambda: docker.last("decision") and docker.last("decision")["decision"] == "0")
                    want(True)
                    heard, refused = (
                        asyncio.create_task(robot.says(name, since=goals)),
                        asyncio.create_task(told(since, "failed")),
                    )
                    await asyncio.wait([heard, refused], return_when=asyncio.FIRST_COMPLETED)
                    if heard.done():
                        await heard
                        refused.cancel()
                        break
                    heard.cancel()  # the end of the one before was said by its server, and not yet heard
                    assert "whose end was not heard" in (await refused)["detail"]
                what()
                return await told(since, *ends)

            async def set_to(**options):
                """Change what the server does, before the next goal comes to it."""
                said = len(robot.said)
                robot.tell(options=options)
                robot.tell(echoed=said)
                await robot.says("echoed", since=said)

            ended = await goal(lambda: robot.tell(finish=4, result={"success": True}))
            assert ended["status"] == "succeeded"
            assert next(event for event in robot.said if "goal" in event)["fields"]["dock_id"] == "home"
            ended = await goal(lambda: robot.tell(finish=6, result={"error_code": 905, "error_msg": "slipped"}))
            assert ended["status"] == "failed"
            assert "905" in ended["detail"]
            assert "slipped" in ended["detail"]
            await set_to(answer=False)
            ended = await goal(lambda: None, name="goal")
            assert ended["status"] == "failed"
            assert "reject" in ended["detail"]
            await set_to(answer=True)
            ended = await goal(lambda: want(False))
            assert ended["status"] == "preempted"
            assert robot.last("ended")["status"] == 5
            await set_to(brake="reach")
            ended = await goal(lambda: want(False))  # it is reached while it is being cancelled
            assert ended["status"] == "succeeded"
            await set_to(brake=0.0)
            ended = await goal(lambda: sensor.tell(cancel_all="/dock_robot"))  # by somebody else
            assert ended["status"] == "failed"
            assert "cancel" in ended["detail"]

            ended = await goal(lambda: robot.program.signal(signal.SIGSTOP))
            assert ended["status"] == "failed"
            assert "told nothing for 2 s" in ended["detail"]
            since = len(robot.said)
            robot.program.signal(signal.SIGCONT)
            assert (await robot.says("ended", since=since))["status"] == 5  # the goal that it went on with
            ended = await goal(lambda: robot.program.signal(signal.SIGKILL))
            assert ended["status"] == "failed"
            live = [event["live"] for event in robot.said if "accepted" in event]
            assert live == [1] * len(live)

    asyncio.run(main())


SEEN = """
[ros2]
node = "watched"
services = true
diagnostics = true
[predicates]
Go = { topic = "/go", type = "std_msgs/msg/Bool", when = "data", max_age = 1.0 }
[ensembles.watched]
policy = [0, 1]
states.go = { yes = "Go" }
safe_action = { publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", rate = 20.0, until = 0.2 }
[ensembles.watched.actions]
0 = { publish = "/lamp", type = "std_msgs/msg/Bool" }
1 = { publish = "/lamp", type = "std_msgs/msg/Bool", message = { data = true } }
"""


def test_a_real_node_reads_diagnostics_and_stops_the_robot(ros, tmp_path):
    async def main():
        async with programs(ros, tmp_path) as here:
            peer = Watched(await here.peer())
            go = {"publish": "/go", "type": "std_msgs/msg/Bool", "rate": 20, "message": {"data": True}}
            peer.tell(echo="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
            peer.tell(echo="/cmd_vel", type="geometry_msgs/msg/Twist")
            peer.tell(**go)
            watched = Watched(await here.system(SEEN))

            def level(wanted, since=0, word=""):
                def is_so(event):
                    return event["heard"] == "/diagnostics" and any(
                        each["level"] == wanted and word in str(each) for each in event["message"]["status"]
                    )

                return peer.says("heard", since=since, where=is_so)

            await level(0)
            since = len(peer.said)
            peer.tell(**{**go, "rate": 0})
            await level(2, since, "Go")
            peer.tell(**go)
            await level(0, len(peer.said))
            since = len(watched.said)
            peer.tell(call="/watched/stop", type="std_srvs/srv/Trigger")
            assert (await peer.says("response"))["fields"]["success"]
            await watched.says("mode", since=since, where=lambda event: event["mode"] == "stopped")

    asyncio.run(main())


def test_the_benchmark_measures_both_ways(ros, tmp_path):
    output = tmp_path / "out.json"
    program = [sys.executable, ROOT / "benchmarks" / "ros2.py", "--quick", "--ros", ros, "--output", output]
    done = subprocess.run(program, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    [run] = json.loads(output.read_text())["runs"]
    assert run["mdm_us"] > 0
    assert run["ratio"] == pytest.approx(run["mdm_us"] / run["bare_us"])
