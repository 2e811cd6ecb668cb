"""What a file needs of ROS, held against a graph that the test makes."""

from __future__ import annotations

import asyncio
import json

import msgspec
import pytest
from patience import PATIENCE
from places import EXAMPLES
from ros2.environment import programs
from ros2.stand_in import StandIn

from mdm.ros2.doctor import Noting, Part
from mdm.ros2.wire import Peer, Quality
from mdm.testing import run_virtual

PATROL = EXAMPLES / "ros2" / "patrol.toml"
BATTERY, TWIST = "sensor_msgs/msg/BatteryState", "geometry_msgs/msg/Twist"
RELIABLE, KEPT = Quality(reliability="reliable"), Quality(reliability="reliable", durability="transient_local")


def looked(make, graph, *, seconds=2.0, send=None):
    """Return the parts that are found on a wire with this graph, and after how many seconds."""
    wire = StandIn()
    wire.graph = graph
    noting = Noting(wire)
    make(noting)

    async def main(runtime):
        loop = asyncio.get_running_loop()
        began = loop.time()
        if send is not None:
            loop.call_later(0.5, lambda: send(wire))
        parts = await noting.look(seconds)
        return parts, round(loop.time() - began, 1), wire

    return run_virtual(main)


def everything(noting):
    noting.subscribe("/battery", BATTERY, lambda _: pytest.fail("nothing of the program is called"), Quality())
    noting.publish("/cmd_vel", TWIST, RELIABLE)
    noting.call("/lamp", "std_srvs/srv/SetBool")
    noting.action("/dock", "nav2_msgs/action/DockRobot")


THERE = {
    ("publisher", "/battery"): (Peer("/robot", BATTERY, RELIABLE),),
    ("subscription", "/cmd_vel"): (Peer("/base", TWIST, RELIABLE),),
    ("service", "/lamp"): (Peer("/lamp", "std_srvs/srv/SetBool"),),
    ("action", "/dock"): (Peer("/docking", "nav2_msgs/action/DockRobot"),),
}


def test_all_that_is_there_and_heard_ends_the_look():
    parts, after, wire = looked(everything, THERE, send=lambda wire: wire.send("/battery", percentage=0.5))
    assert [problem for part in parts for problem in part.problems] == []
    assert [part.name for part in parts] == ["/battery", "/cmd_vel", "/lamp", "/dock"]
    assert parts[0].heard.percentage == 0.5
    assert 0.5 <= after < 0.8
    assert wire.closed
    assert not wire.published


@pytest.mark.parametrize("missing", THERE)
def test_each_that_is_missing_is_named_with_the_way_out(missing):
    graph = {key: peers for key, peers in THERE.items() if key != missing}
    parts, after, _ = looked(everything, graph, send=lambda wire: wire.send("/battery", percentage=0.5))
    [problem] = [problem for part in parts for problem in part.problems]
    assert problem.startswith("nobody ")
    assert missing[1] in problem
    assert "remap" in problem
    assert after == 2.0


def test_a_topic_on_which_nothing_comes_is_waited_for_and_no_problem():
    [battery, *_], after, _ = looked(everything, THERE)
    assert (battery.problems, battery.heard) == ([], None)
    assert after == 2.0


def part(role, kind, quality, *peers):
    return [*Part(role, "/name", kind, quality, peers).judge()]


def test_another_type_is_told():
    [problem] = part("publisher", BATTERY, Quality(), Peer("/robot", TWIST, Quality()))
    assert all(word in problem for word in ("/robot", BATTERY, TWIST))
    assert part("action", "a/action/B", None, Peer("/robot", "a/action/C"))


@pytest.mark.parametrize("theirs", ["best_effort", "reliable"])
@pytest.mark.parametrize("ours", ["best_effort", "reliable"])
@pytest.mark.parametrize("role", ["publisher", "subscription"])
def test_reliability_is_judged_by_the_table_of_dds(role, ours, theirs):
    problems = part(role, TWIST, Quality(reliability=ours), Peer("/n", TWIST, Quality(reliability=theirs)))
    offered, wanted = (theirs, ours) if role == "publisher" else (ours, theirs)
    assert len(problems) == (offered == "best_effort" and wanted == "reliable")
    if problems:
        assert f'qos = {{ reliability = "{theirs}" }}' in problems[0]


@pytest.mark.parametrize("theirs", ["volatile", "transient_local"])
@pytest.mark.parametrize("ours", ["volatile", "transient_local"])
@pytest.mark.parametrize("role", ["publisher", "subscription"])
def test_durability_is_judged_by_the_table_of_dds(role, ours, theirs):
    ours_, theirs_ = (Quality(reliability="reliable", durability=each) for each in (ours, theirs))
    problems = part(role, TWIST, ours_, Peer("/n", TWIST, theirs_))
    offered, wanted = (theirs, ours) if role == "publisher" else (ours, theirs)
    assert len(problems) == (offered == "volatile" and wanted == "transient_local")
    if problems:
        assert f'qos = {{ durability = "{theirs}" }}' in problems[0]


def test_a_kept_message_is_not_asked_for_where_it_cannot_come():
    """DDS hands kept messages to reliable readers alone; the slow test hears one."""
    with pytest.raises(msgspec.ValidationError, match="reliability"):
        msgspec.convert({"durability": "transient_local"}, Quality)
    assert msgspec.convert({"durability": "transient_local", "reliability": "reliable"}, Quality) == KEPT


@pytest.mark.slow
def test_the_doctor_says_what_is_missing_and_what_is_heard(ros, nav2, tmp_path):
    async def run():
        async with programs(ros, tmp_path, nav2) as here:

            async def call(*words):
                process = await here.start("-m", "mdm", *words)
                async with asyncio.timeout(PATIENCE):
                    text = (await process.process.stdout.read()).decode()
                    return await process.process.wait(), text, process.said.read_text()

            status, _, said = await call("ros2", "doctor", PATROL, "--seconds", "2")
            assert status == 1
            names = ["/battery_state", "/amcl_pose", "/cmd_vel", "/navigate_to_pose", "/dock_robot"]
            for name in names:
                assert f" {name} (" in said
            await here.start(PATROL.parent / "robot.py")
            status, text, said = await call("ros2", "doctor", PATROL, "--seconds", "20")
            assert status == 0, said
            assert "publisher /robot: reliable, transient_local" in text
            assert "action /robot" in text
            assert "nothing is missing" in text
            status, text, _ = await call("ros2", "doctor", PATROL, "--json")
            told = json.loads(text)
            assert (status, told["problems"]) == (0, [])
            assert {part["name"] for part in told["parts"]} == set(names)
            [pose] = [part for part in told["parts"] if part["name"] == "/amcl_pose"]
            assert pose["heard"]["header"]["frame_id"] == "map"  # kept: the robot stands
            [battery] = [part for part in told["parts"] if part["name"] == "/battery_state"]
            assert 0 <= battery["heard"]["percentage"] <= 1
            assert told["ros"]["domain"] == str(here.number)
            status, text, said = await call("check", "--live", PATROL)
            assert status == 0, text + said

    asyncio.run(run())


@pytest.mark.slow
def test_the_doctor_prints_names_as_ros_has_them(ros, tmp_path):
    (tmp_path / "robot.toml").write_text(RELATIVE)

    async def run():
        async with programs(ros, tmp_path) as here:
            process = await here.start("-m", "mdm", "ros2", "doctor", "robot.toml", "--seconds", "0.1", "--json")
            async with asyncio.timeout(PATIENCE):
                told = json.loads(await process.process.stdout.read())
            names = ["/ada/go", "/front_scan", "/lamp"]
            assert [part["name"] for part in told["parts"]] == names
            assert [problem.split()[2] for problem in told["problems"]] == names  # nobody publishes NAME

    asyncio.run(run())


RELATIVE = """
[ros2]
node = "robot"
namespace = "/ada"
remap = { scan = "/front_scan" }

[predicates]
Go = { topic = "go", type = "std_msgs/msg/Bool", when = "data" }
Near = { topic = "scan", type = "std_msgs/msg/Bool", when = "data" }

[ensembles.robot]
policy = [0, 0, 0, 0]
states = { near = { yes = "Near" }, go = { yes = "Go" } }
actions = { 0 = { service = "/lamp", type = "std_srvs/srv/Trigger" } }
"""
