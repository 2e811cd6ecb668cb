"""The wire over rclpy, in a program of its own, beside a robot by rclpy itself."""

from __future__ import annotations

import asyncio
import json
import math
import signal
import struct
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from ros2.environment import programs
from sentences import refused

from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.wire import WireError

slow = pytest.mark.slow
PROGRAM = Path(__file__).parent / "wire_program.py"
FIBONACCI = {"actions": {"/count": "test_msgs/action/Fibonacci"}}


def test_without_rclpy_the_way_to_it_is_said():
    with refused(WireError):
        RclpyWire("patrol")


@pytest.mark.parametrize("domain", ["233", "-1", "one"])
def test_a_domain_that_would_end_the_process_is_refused(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with refused(WireError):
        RclpyWire("patrol")


@asynccontextmanager
async def wire(here, **options):
    """Start a program with a wire, and end it in order: nothing but its answers is said."""
    program = await here.start(PROGRAM, json.dumps(options))
    await program.hear("opened", "refused")
    yield program
    program.process.stdin.close()
    await program.rest()
    assert await program.end() == 0
    assert program.said.read_text() == ""


@asynccontextmanager
async def pursuing(here):
    """Give a robot, and a program with a wire whose goal 1 it pursues."""
    robot = await here.peer()
    robot.tell(act="/count", type="test_msgs/action/Fibonacci")
    async with wire(here, **FIBONACCI) as ours:
        ours.tell(ready="/count")
        await ours.hear("ready")
        ours.tell(send="/count", goal={"order": 5}, number=1)
        await ours.hear("accepted")
        yield robot, ours


def run(ros, tmp_path, main):
    async def whole():
        async with programs(ros, tmp_path) as here:
            await main(here)

    asyncio.run(whole())


def single(number):
    """Return a number as 32 bits have it."""
    return struct.unpack("f", struct.pack("f", number))[0]


POSE = {"position": {"x": 1.5, "y": -2.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
HEADER = {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"}
COVARIANCE = [float(number) for number in range(36)]
TYPES = {
    "std_msgs/msg/Bool": {"data": True},
    "std_msgs/msg/String": {"data": "Küche 🤖"},
    "sensor_msgs/msg/LaserScan": {"header": HEADER, "range_max": 12.5, "ranges": [0.5, math.inf, single(0.1)]},
    "sensor_msgs/msg/BatteryState": {"percentage": 0.25, "power_supply_status": 2, "cell_voltage": [3.5, 3.75]},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {"header": HEADER, "pose": {"pose": POSE, "covariance": COVARIANCE}},
    "nav_msgs/msg/Odometry": {"child_frame_id": "base", "pose": {"pose": POSE, "covariance": COVARIANCE}},
    "diagnostic_msgs/msg/DiagnosticArray": {
        "status": [{"level": 2, "name": "a", "values": [{"key": "k", "value": "v"}]}]
    },
    "test_msgs/msg/Arrays": {
        "bool_values": [True, False, True],
        "int64_values": [-(2**63), 0, 2**63 - 1],
        "string_values": ["", "ä", "c"],
    },
    "test_msgs/msg/BoundedSequences": {
        "uint64_values": [2**64 - 1],
        "float32_values": [0.5],
        "basic_types_values": [{"int8_value": -128}],
    },
    "test_msgs/msg/WStrings": {"wstring_value": "ハロー", "array_of_wstrings": ["1", "zwei", "三"]},
    "test_msgs/msg/MultiNested": {"bounded_sequence_of_unbounded_sequences": [{"string_values": ["x", "y"]}]},
}


def within(part, whole):
    """Whether a message has these fields; an octet may be told as a list of one."""
    if isinstance(part, dict):
        return all(within(value, whole[name]) for name, value in part.items())
    if isinstance(part, list):
        return len(part) == len(whole) and all(map(within, part, whole))
    return whole in (part, [part])


@slow
def test_eleven_types_go_both_ways(ros, tmp_path):
    async def main(here):
        out, back = ({f"/{way}{number}": kind for number, kind in enumerate(TYPES)} for way in ("out", "back"))
        robot = await here.peer()
        async with wire(here, topics=back, publishers=out, quality={"reliability": "reliable"}) as ours:
            for number, (kind, message) in enumerate(TYPES.items()):
                robot.tell(echo=f"/out{number}", type=kind)
                ours.tell(matched=f"/out{number}")
                await ours.hear("matched")
                robot.tell(matched=f"/out{number}")
                await robot.hear("matched")
                ours.tell(publish=f"/out{number}", message=message)
                assert within(message, (await robot.hear("heard"))["message"]), kind
                robot.tell(publish=f"/back{number}", type=kind, message=message, latched=True, rate=20)
                heard = await ours.hear("heard")
                assert within(message, heard["message"]), kind
                assert heard["thread"]
                robot.tell(publish=f"/back{number}", type=kind, rate=0)

    run(ros, tmp_path, main)


@slow
def test_what_others_have_set_is_corrected_or_refused(ros, tmp_path):
    """rclpy sends 1 as 5e-324, and 300 in an int8 as 44."""

    async def main(here):
        robot = await here.peer()
        kinds = {"/velocity": "geometry_msgs/msg/Twist", "/battery": "sensor_msgs/msg/BatteryState"}
        async with wire(here, publishers=kinds, quality={"reliability": "reliable"}) as ours:
            for topic, kind in kinds.items():
                robot.tell(echo=topic, type=kind)
                ours.tell(matched=topic)
                await ours.hear("matched")
                robot.tell(matched=topic)
                await robot.hear("matched")
            ours.tell(publish="/velocity", made=kinds["/velocity"], message={"linear.x": 1})
            assert (await robot.hear("heard"))["message"]["linear"]["x"] == 1.0
            ours.tell(publish="/velocity", made=kinds["/velocity"], message={"linear.x": "fast"})
            assert "linear.x is of the type double, and cannot be 'fast'" in (await ours.hear("error"))["error"]
            ours.tell(publish="/battery", made=kinds["/battery"], message={"power_supply_status": 300})
            assert "power_supply_status is of the type uint8, and cannot be 300" in (await ours.hear("error"))["error"]
            ours.tell(publish="/battery", made=kinds["/battery"], message={"voltage": math.nan})
            assert math.isnan((await robot.hear("heard"))["message"]["voltage"])

    run(ros, tmp_path, main)


@slow
def test_services_are_called_and_answered(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        clients = {"/lamp": "std_srvs/srv/SetBool", "/trigger": "std_srvs/srv/Trigger"}
        services = {"~/start": "std_srvs/srv/Trigger", "/switch": "std_srvs/srv/SetBool"}
        async with wire(here, clients=clients, services=services, topics={"/talk": "std_msgs/msg/Bool"}) as ours:
            robot.tell(serve="/lamp", type=clients["/lamp"], response={"success": True, "message": "on"})
            robot.tell(serve="/trigger", type=clients["/trigger"], response={"success": False, "message": "no"})
            for name, request, answered in (("/lamp", {"data": True}, "on"), ("/trigger", {}, "no")):
                ours.tell(ready=name)
                await ours.hear("ready")
                ours.tell(call=name, request=request)
                assert (await robot.hear("request")) == {"request": name, "fields": request}
                assert (await ours.hear("response"))["response"]["message"] == answered
            ours.tell(call="/lamp", request={"dat": True})
            assert "did you mean 'data'?" in (await ours.hear("error"))["error"]
            robot.tell(call="/ours/start", type=services["~/start"])
            assert await ours.hear("asked") == {"asked": {}, "thread": False}
            assert (await robot.hear("response"))["fields"] == {"success": True, "message": "done"}
            robot.tell(call="/switch", type=services["/switch"], request={"data": False})
            fault = await ours.hear("fault")
            assert (fault["fault"], fault["kind"]) == ("ros2/switch", "exception")
            assert (await robot.hear("response"))["fields"] == {"success": False, "message": ""}
            ours.tell(peers="/lamp", role="service", wanted=[["/robot", "std_srvs/srv/SetBool", None]])
            await ours.hear("peers")

    run(ros, tmp_path, main)


@slow
def test_a_goal_succeeds_is_rejected_aborted_cancelled(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        robot.tell(act="/counts", type="test_msgs/action/Fibonacci")
        async with wire(here, remap={"/count": "/counts"}, **FIBONACCI) as ours:
            ours.tell(ready="/count")
            await ours.hear("ready")
            ours.tell(peers="/count", role="action", wanted=[["/robot", "test_msgs/action/Fibonacci", None]])
            await ours.hear("peers")
            for number, status in enumerate((4, 6), 1):
                ours.tell(send="/count", goal={"order": 5}, number=number)
                assert (await robot.hear("goal"))["fields"] == {"order": 5}
                assert (await ours.hear("accepted"))["accepted"]
                robot.tell(feedback={"sequence": [0, 1, 1]})
                assert await ours.hear("feedback") == {"feedback": {"sequence": [0, 1, 1]}, "of": number}
                robot.tell(finish=status, result={"sequence": [8]})
                ended = {"ended": number, "status": status, "result": {"sequence": [8]}}
                assert await ours.hear("ended") == ended
                assert {"status": 2, "of": number} in ours.heard
            robot.tell(options={"answer": False}, echoed=1)
            await robot.hear("echoed")
            ours.tell(send="/count", goal={"order": -1}, number=3)
            assert await ours.hear("accepted") == {"accepted": False, "of": 3}
            robot.tell(options={"answer": True}, echoed=1)
            await robot.hear("echoed")
            ours.tell(send="/count", goal={"order": 1}, number=4)
            ours.tell(send="/count", goal={"order": 2}, number=5)
            for _ in range(2):
                await ours.hear("accepted")
            ours.tell(cancel=5)
            assert await ours.hear("code") == {"code": 0, "of": 5}
            assert (await ours.hear("ended"))["ended"] == 5  # and the other goal of the same server goes on
            ours.tell(cancel=5)
            assert (await ours.hear("code"))["code"] in {2, 3}
            robot.tell(options={"on_cancel": False}, echoed=1)
            await robot.hear("echoed")
            ours.tell(cancel=4)
            assert await ours.hear("code") == {"code": 1, "of": 4}
            robot.tell(finish=4)
            assert (await ours.hear("ended"))["ended"] == 4

    run(ros, tmp_path, main)


@slow
def test_the_newest_feedback_takes_the_place_of_what_waits(ros, tmp_path):
    async def main(here):
        async with pursuing(here) as (robot, ours):
            ours.tell(hold=str(tmp_path / "go_on"))
            await ours.hear("holds")
            for number in range(100):
                robot.tell(feedback={"sequence": [number]})
            robot.tell(echoed=1)
            await robot.hear("echoed")
            (tmp_path / "go_on").touch()
            heard = []
            while heard[-1:] != [[99]]:
                heard.append((await ours.hear("feedback"))["feedback"]["sequence"])
            assert len(heard) < 50  # all of them, if the loop was not held
            robot.tell(finish=4)
            assert (await ours.hear("ended"))["status"] == 4

    run(ros, tmp_path, main)


@slow
def test_who_was_cancelled_still_gets_the_goal_and_its_end(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        robot.tell(act="/count", type="test_msgs/action/Fibonacci", answer=None)
        async with wire(here, **FIBONACCI) as ours:
            ours.tell(ready="/count")
            await ours.hear("ready")
            ours.tell(send="/count", goal={"order": 5}, number=1)
            await robot.hear("goal")
            ours.tell(give_up=1)
            await ours.hear("gave_up")
            robot.tell(answer=True)
            assert await ours.hear("accepted") == {"accepted": True, "of": 1}
            ours.tell(give_up=1)
            await ours.hear("gave_up")
            robot.tell(finish=4)
            assert (await ours.hear("ended"))["status"] == 4

    run(ros, tmp_path, main)


@slow
def test_a_goal_whose_status_comes_was_accepted_though_the_answer_was_lost(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        robot.tell(
            serve="/count/_action/send_goal", type="test_msgs/action/Fibonacci.Impl.SendGoalService", silent=True
        )
        robot.tell(
            serve="/count/_action/get_result", type="test_msgs/action/Fibonacci.Impl.GetResultService", silent=True
        )
        robot.tell(serve="/count/_action/cancel_goal", type="action_msgs/srv/CancelGoal", response={"return_code": 3})
        async with wire(here, **FIBONACCI) as ours:
            ours.tell(ready="/count")
            await ours.hear("ready")
            ours.tell(send="/count", goal={"order": 3}, number=1)
            identity = (await robot.hear("request"))["fields"]["goal_id"]
            goals = [{"goal_info": {"goal_id": identity}, "status": 2}]
            status = {"type": "action_msgs/msg/GoalStatusArray", "message": {"status_list": goals}, "latched": True}
            robot.tell(publish="/count/_action/status", **status)
            assert await ours.hear("accepted") == {"accepted": True, "of": 1}
            ours.tell(cancel=1)
            assert await ours.hear("code") == {"code": 3, "of": 1}

    run(ros, tmp_path, main)


@slow
def test_a_killed_server_answers_nothing_and_the_wire_closes(ros, tmp_path):
    async def main(here):
        here.leave_shared_memory()
        async with pursuing(here) as (robot, ours):
            robot.signal(signal.SIGKILL)
            await robot.end()
            ours.tell(cancel=1)
            ours.tell(close=True)
            heard = [await ours.hear("error", "closed") for _ in range(3)]
            [closed] = [event["closed"] for event in heard if "closed" in event]
            assert closed < 2
            [one, other] = [event["error"] for event in heard if "error" in event]  # of the cancellation and the goal
            assert one == other == "WireError: the link to ROS 2 has ended"
            ours.tell(send="/count", goal={"order": 5}, number=2)
            assert "the link to ROS 2 is not open" in (await ours.hear("error"))["error"]
            ours.tell(threads=True)
            assert "mdm:ros2" not in (await ours.hear("threads"))["threads"]

    run(ros, tmp_path, main)


@slow
def test_a_callback_that_raises_is_a_fault_and_the_others_hear_on(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        topics = {"/bad": "std_msgs/msg/Bool", "/good": "std_msgs/msg/Bool"}
        async with wire(here, topics=topics, raises=["/bad"]) as ours:
            robot.tell(publish="/bad", type="std_msgs/msg/Bool", rate=200)
            fault = await ours.hear("fault")
            assert (fault["fault"], fault["kind"]) == ("ros2/bad", "exception")
            assert fault["detail"].startswith("ValueError: a sensor's mistake")
            robot.tell(publish="/good", type="std_msgs/msg/Bool", message={"data": True}, rate=10)
            for _ in range(10):
                assert (await ours.hear("heard"))["message"] == {"data": True}
            assert sum("fault" in event for event in ours.heard) <= 3  # of 200 a second

    run(ros, tmp_path, main)


@slow
def test_another_quality_is_told_on_either_side(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        kind = "std_msgs/msg/Bool"
        async with wire(here, topics={"/in": kind}, quality={"reliability": "reliable"}) as ours:
            robot.tell(publish="/in", type=kind, reliable=False, quiet=True)
            fault = await ours.hear("fault")
            assert (fault["fault"], fault["kind"]) == ("ros2/in", "quality")
            assert "reliability" in fault["detail"]
            ours.tell(peers="/in", role="publisher", wanted=[["/robot", kind, "best_effort"]])
            await ours.hear("peers")
            robot.tell(remove="/in")
            robot.tell(publish="/in", type="std_msgs/msg/String", quiet=True)
            await ours.hear("fault", where=lambda event: "/robot publishes std_msgs/msg/String" in event["detail"])
        async with wire(here, publishers={"/out": kind}) as ours:
            robot.tell(echo="/out", type=kind)
            fault = await ours.hear("fault")
            assert (fault["fault"], fault["kind"]) == ("ros2/out", "quality")

    run(ros, tmp_path, main)


@slow
def test_a_callback_that_hangs_is_told_and_the_program_ends(ros, tmp_path):
    async def main(here):
        robot = await here.peer()
        program = await here.start(
            PROGRAM,
            json.dumps(
                {
                    "topics": {"/scan": "std_msgs/msg/Bool"},
                    "hangs": ["/scan"],
                    "clients": {"/a": "std_srvs/srv/Trigger"},
                }
            ),
        )
        await program.hear("opened")
        robot.tell(publish="/scan", type="std_msgs/msg/Bool", rate=10)
        await program.hear("hangs")
        program.process.stdin.close()
        fault = await program.hear("fault")
        assert "is not closed after 2 s" in fault["detail"]
        assert await program.end() == 0
        assert "terminate" not in program.said.read_text()

    run(ros, tmp_path, main)


@slow
def test_rclpy_shut_down_by_another_is_a_fault(ros, tmp_path):
    async def main(here):
        async with wire(here, topics={"/scan": "std_msgs/msg/Bool"}, clients={"/a": "std_srvs/srv/Trigger"}) as ours:
            ours.tell(shut=True)
            await ours.hear("fault", where=lambda event: "shut rclpy down" in event["detail"])
            ours.tell(call="/a", request={})
            assert "is not open" in (await ours.hear("error"))["error"]

    run(ros, tmp_path, main)


@slow
@pytest.mark.parametrize(
    "options",
    [
        {"node": "bad node"},
        {"namespace": "/a//b"},
        {"remap": {"/scan": "/front scan"}},
        {"topics": {"/scan/": "std_msgs/msg/Bool"}},
        {"topics": {"/scan": "std_msgs/msg/Bol"}},
        {"topics": {"/scan": "std_srvs/srv/SetBool"}},
        {"clients": {"/lamp": "nav9_msgs/srv/SetBool"}},
        {"actions": {"/nav": "test_msgs/action/Fibonaci"}},
    ],
    ids=repr,
)
def test_what_cannot_be_is_refused_where_it_is_made(ros, tmp_path, options):
    async def main(here):
        program = await here.start(PROGRAM, json.dumps(options))
        with refused(WireError):
            raise WireError((await program.hear("refused", "opened"))["refused"])
        assert await program.end() == 0

    run(ros, tmp_path, main)


@slow
def test_a_node_that_cannot_begin_leaves_no_thread(ros, tmp_path):
    """rclpy refuses so long a name when the node begins."""

    async def main(here):
        program = await here.start(PROGRAM, json.dumps({"topics": {f"/{'a' * 300}": "std_msgs/msg/Bool"}}))
        told = await program.hear("refused", "opened")
        assert "the node 'ours' cannot begin" in told["refused"]
        assert "mdm:ros2" not in told["threads"]
        assert await program.end() == 0
        assert program.said.read_text() == ""

    run(ros, tmp_path, main)
