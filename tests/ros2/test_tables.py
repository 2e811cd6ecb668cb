"""A file with a table `ros2`: topics decide, actions act, what is wrong is told with its key; recorded and replayed."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import tomllib

import pytest
from ros2.stand_in import Server, StandIn
from rows_of_rooms import row_of_rooms
from sentences import refused
from team_file import write

import mdm
from mdm import ConfigError, load_system
from mdm.cli.robots.ensembles import facts
from mdm.config.builder import look_over
from mdm.config.recorded import attach_configuration
from mdm.maps import save_graph
from mdm.recording import Recorder
from mdm.ros2 import Quality
from mdm.ros2.tables import Ros2Reader, notes
from mdm.runtime import VirtualClock
from mdm.team.transport.network import Network
from mdm.testing import capture_decisions, probe, replay, run_virtual

ROBOT = """
told = []
def is_low(message):
    return message.percentage < 0.2
def home(action):
    return {"dock_id": "home"}
def hear(message):
    told.append(message.count)
async def later(message):
    return True
"""

FILE = """
[ros2]
node = "patrol"
namespace = "/robot1"
remap = { "/battery_state" = "/battery" }
services = true
decisions = true

[predicates]
Charging = {}

[predicates.Low]
topic = "/battery"
type = "sensor_msgs/msg/BatteryState"
when = "percentage < 0.2 until > 0.3"
max_age = 5.0

[events.Bumped]
topic = "/bumper"
type = "std_msgs/msg/Bool"
when = "data"
qos = { depth = 100, reliability = "reliable" }

[ensembles.top]
policy = [0, 1]
safe_action = { service = "/brake", type = "std_srvs/srv/SetBool", request = { data = true } }

[ensembles.top.states]
low = ["Low"]

[ensembles.top.actions]
Creep = { publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", message = { linear = { x = 0.1 } } }

[ensembles.top.actions.Dock]
action = "/dock_robot"
type = "nav2_msgs/action/DockRobot"
goal = "robot_code:home"
silence = 2.0
feedback = { predicate = "Charging", when = "count > 1" }
"""


def reader_of(wire):
    """Return a reader whose wire is the one given."""

    class Reader(Ros2Reader):
        def wire(self, node, namespace, remap):
            wire.named = node, namespace, remap
            return wire

    return {"ros2": Reader}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Give a folder with the file and its code."""
    monkeypatch.delitem(sys.modules, "robot_code", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "robot_code.py").write_text(ROBOT)
    save_graph(row_of_rooms("Hall", "Kitchen").graph, tmp_path / "floor.xml")
    (tmp_path / "robot.toml").write_text(FILE)
    return tmp_path


class Peers(StandIn):
    """The other side: a dock, and a brake."""

    def __init__(self):
        super().__init__()
        self.braked = []
        self.services["/brake"] = self.brake
        self.dock = Server(self, "/dock_robot", takes=3.0, feeds=0.5)

    def brake(self, request):
        self.braked.append(asyncio.get_running_loop().time())
        return self.make("std_srvs/srv/SetBool_Response", {"success": True})


async def drive(system, wire, runtime):
    """Run a battery down and up, and pull its topic for a while; return what was decided."""
    with capture_decisions(runtime) as decisions:
        await runtime.start(system)
        for percentage in (0.5, 0.25, 0.1, 0.25, 0.35):
            for _ in range(4):
                wire.send("/battery", percentage=percentage)
                await asyncio.sleep(1)
        await asyncio.sleep(10)  # the topic is pulled
        assert (system.predicates.value("Low"), system.ensembles["top"].mode) == (None, "safe")
        wire.send("/battery", percentage=0.5)
        await asyncio.sleep(1)
        assert system.ensembles["top"].mode == "deciding"
    return [decision.action_name for decision in decisions]


def test_topics_decide_and_actions_act(folder):
    wire = Peers()
    system = load_system(folder / "robot.toml", tables=reader_of(wire))
    assert wire.named == ("patrol", "/robot1", {"/battery_state": "/battery"})
    ((kind, _, quality),) = wire.subscribed["/bumper"]
    assert (kind, quality) == ("std_msgs/msg/Bool", Quality(depth=100, reliability="reliable"))

    async def main(runtime):
        faults, rising = probe(runtime.faults), []
        updates = runtime.channel("predicates/updates", mdm.messages.PredicateUpdate)
        updates.subscribe(lambda update: rising.extend(update.rising))
        return await drive(system, wire, runtime), faults, rising

    decided, faults, rising = run_virtual(main)
    assert decided == ["Creep", "Dock", "Creep", "Creep"]
    assert "Charging" in rising
    assert [goal.message.dock_id for goal in wire.dock.goals] == ["home"]
    assert [message.linear.x for _, message in wire.published["/cmd_vel"]] == [0.1] * 3
    assert wire.braked == [24.0, 31.0]  # the last message came after 19 s; and at the end
    assert {fault.kind for fault in faults} == {"stale", "stale_input"}
    assert {"/robot1/patrol"} != set(wire.served) >= {"~/start", "~/stop", "~/reset", "~/release"}
    assert (wire.opened, wire.closed) == (True, True)
    assert wire.published["/diagnostics"]


@pytest.mark.parametrize(("agent", "namespace"), [("a", "/ada"), ("b", "")])
def test_each_agent_of_a_team_has_its_own_node(agent, namespace, tmp_path):
    ros = '[ros2]\nnamespace = { a = "/ada" }\n'
    lab = 'InLab = { topic = "lab", type = "std_msgs/msg/Bool", when = "data" }'
    path = write(tmp_path, ("[team]", f"{ros}[team]"), ("InLab = {}", lab))
    wire, network = StandIn(), Network(VirtualClock(), team="rooms")
    system = load_system(path, agent=agent, transport=network.transport(agent), tables=reader_of(wire))
    assert wire.named == ("mdm", namespace, {})
    assert [*wire.subscribed] == ["lab"]
    assert system.predicates.declared.definition("InLab") == "set by lab: data"


def test_an_agent_that_the_team_has_not_is_refused(tmp_path):
    path = write(tmp_path, ("[team]", '[ros2]\nnamespace = { c = "/ada" }\n[team]'))
    with refused(ConfigError):
        load_system(path, agent="a", callbacks=False)


def test_a_topic_that_nobody_publishes_is_named_by_who_waits_for_it(folder):
    system = load_system(folder / "robot.toml", tables=reader_of(Peers()))

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(system)
        await asyncio.sleep(30)
        return [fault.detail for fault in faults if fault.kind == "waiting"]

    details = run_virtual(main)
    assert details == ["cannot decide while Low (/battery: percentage < 0.2 until > 0.3) is unknown"]


@pytest.mark.slow
def test_hours_of_it(folder):
    wire = Peers()
    system = load_system(folder / "robot.toml", tables=reader_of(wire))

    async def main(runtime):
        await runtime.start(system)
        for hour in range(6):
            for second in range(1800):
                wire.send("/battery", percentage=0.1 if hour % 2 else 0.9)
                wire.send("/bumper", data=second % 600 == 0)
                await asyncio.sleep(1)
            await asyncio.sleep(1800)
            assert system.ensembles["top"].mode == "safe"
        return runtime.statistics().dispatcher

    statistics = run_virtual(main)
    assert (len(wire.braked), len(wire.dock.goals)) == (6 + 1, 3)  # at the end, too
    assert (statistics.lost, statistics.interrupted) == (0, 0)


def command(*arguments, folder):
    """Run the command where importing rclpy, though it is found, is an error."""
    (folder / "rclpy.py").write_text("raise AssertionError('rclpy is imported')")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    program = [sys.executable, "-m", "mdm", *map(str, arguments)]
    return subprocess.run(
        program, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def test_a_run_is_recorded_and_repeated(folder):
    recorded(folder)


def recorded(folder):
    """Return the record of a run, which is repeated alike."""
    wire = Peers()
    record = folder / "run.mcap"
    recorder = Recorder(record)
    attach_configuration(recorder, folder / "robot.toml")
    system = load_system(folder / "robot.toml", tables=reader_of(wire))
    decided = run_virtual(lambda runtime: drive(system, wire, runtime), record=recorder)
    assert replay(record) == len(decided) == 4
    return record


def test_a_file_is_described_alike_with_and_without_ros(folder):
    path = folder / "robot.toml"
    linked, looked = load_system(path, tables=reader_of(Peers())), look_over(path)
    virtual = load_system(path, virtual=True)
    assert facts(linked) == facts(looked) == facts(virtual)
    assert facts(linked)["definitions"] == {
        "Low": "set by /battery: percentage < 0.2 until > 0.3, unknown after 5 s",
        "Charging": "set by code",
        "Bumped": "raised by /bumper: data",
    }
    assert (len(linked.extensions), looked.extensions, virtual.extensions) == (1, (), ())


@pytest.mark.slow
def test_the_command_looks_at_records_and_files_without_ros(folder):
    record = recorded(folder)
    for words in (
        ("replay", record),
        ("explain", record),
        ("watch", record, "--once"),
        ("check", "robot.toml"),
        ("info", "robot.toml"),
        ("run", "robot.toml", "--virtual", "--quiet", "--seconds", "60"),
    ):
        done = command(*words, folder=folder)
        assert (done.returncode, done.stderr) == (0, ""), (words, done.stdout, done.stderr)


BRAKE = 'safe_action = { service = "/brake", type = "std_srvs/srv/SetBool", request = { data = true } }'


@pytest.mark.parametrize(
    "safe_action",
    [
        BRAKE,
        'safe_action = { publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", rate = 10.0, until = 1.0 }',
        'safe_action = { publish = "/stop", type = "std_msgs/msg/Bool" }',
        'safe_action = { action = "/dock_robot", type = "nav2_msgs/action/DockRobot" }',
    ],
)
def test_a_safe_action_has_an_end_in_virtual_time_without_ros(folder, safe_action):
    (folder / "robot.toml").write_text(FILE.replace(BRAKE, safe_action))
    system, faults = load_system(folder / "robot.toml", virtual=True), []

    async def main(runtime):
        runtime.faults.subscribe(faults.append)
        await runtime.start(system)
        system.predicates.sense("Low", True)
        await asyncio.sleep(6)  # it is too old
        return system.ensembles["top"].action.statistics().safe_ended

    assert run_virtual(main) == {"succeeded": 1}
    assert {fault.kind for fault in faults} == {"stale", "stale_input"}


def test_a_robot_runs_in_virtual_time_on_another_wire(folder):
    wired = 'wire = "wires:wire"\n'
    (folder / "robot.toml").write_text((folder / "robot.toml").read_text().replace("[ros2]\n", f"[ros2]\n{wired}"))
    (folder / "wires.py").write_text(
        "def wire(node, namespace, remap):\n"
        "    from ros2.stand_in import StandIn\n"
        "    assert (node, namespace, remap) == ('patrol', '/robot1', {'/battery_state': '/battery'})\n"
        "    return StandIn()\n"
    )
    system = load_system(folder / "robot.toml")
    (link,) = system.extensions
    assert isinstance(link.wire, StandIn)

    async def main(runtime):
        await runtime.start(system)
        link.wire.send("/battery", percentage=0.9)
        assert system.predicates.value("Low") is False

    run_virtual(main)


PLACES = """
[ros2]
[places]
graph = "floor.xml"
reach = 1.9
max_age = 5.0
pose = { topic = "/amcl_pose", covariance = 0.2, qos = { reliability = "reliable", durability = "transient_local" } }
navigator = { ros2 = { action = "/navigate_to_pose", silence = 3.0 } }
[ensembles.top]
policy = [0, 1]
states = { place = { predicates = ["Hall.reached", "Kitchen.reached"] } }
actions = { Right = { way = "Right" }, Left = { way = "Left" } }
"""


def test_a_robot_drives_from_room_to_room_by_poses_and_goals(folder):
    """Its server drives it; each pose comes from there."""
    wire = StandIn()
    server = Server(wire, "/navigate_to_pose", takes=None, feeds=1.0)
    (folder / "places.toml").write_text(PLACES)
    system = load_system(folder / "places.toml", tables=reader_of(wire))

    def at(x, variance=0.1):
        pose = {"position": {"x": x, "y": 2.0}, "orientation": {"w": 1.0}}
        wire.send("/amcl_pose", pose={"pose": pose, "covariance": [variance, *[0.0] * 6, variance, *[0.0] * 28]})

    async def main(runtime):
        await runtime.start(system)
        at(2.0)
        for _ in range(3):
            await asyncio.sleep(4)
            goal = server.live[0]
            at(goal.message.pose.pose.position.x)
            goal.end(4)
        await asyncio.sleep(1)
        at(2.0, variance=0.3)
        at(2.0)
        await asyncio.sleep(4)
        return [goal.message.pose.pose.position.x for goal in server.goals]

    assert run_virtual(main) == [6.0, 2.0, 6.0, 2.0]
    assert [message.frame_id for message in [server.goals[0].message.pose.header]] == ["map"]


def changed(**tables):
    """Return the document of the file with some keys replaced; None leaves one out."""
    document = tomllib.loads(FILE)
    for path, value in tables.items():
        *above, last = path.split("__")
        table = document
        for key in above:
            table = table[key]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return document


def toml(value):
    """Yield the lines of a document, whose values are written in place."""
    for name, each in value.items():
        yield f"{name} = {inline(each)}"


def inline(value):
    """Return a value as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name!r} = {inline(each)}" for name, each in value.items()) + "}"
    return json.dumps(value)


BATTERY = {"topic": "/battery", "type": "sensor_msgs/msg/BatteryState", "when": "percentage < 0.2"}
TWIST = "geometry_msgs/msg/Twist"
DOCK = {"action": "/dock", "type": "nav2_msgs/action/DockRobot"}
WRONG = [
    {"ros2": 3},
    {"ros2": {"nod": "x"}},
    {"ros2": {"namespace": {"ada": "/ada"}}},
    {"ros2": {"services": ["begin"]}},
    {"ros2": {"wire": "robot_code:Wire"}},
    {"ros2": None},
    {"predicates__Low": {"topic": "/battery", "type": "sensor_msgs/msg/BatteryState"}},
    {"predicates__Low": {**BATTERY, "whenn": "data"}},
    {"predicates__Low": {**BATTERY, "formula": "Charging"}},
    {"predicates__Low": {**BATTERY, "when": "percentage < low"}},
    {"predicates__Low": {**BATTERY, "when": "robot_code:is_lo"}},
    {"predicates__Low": {**BATTERY, "max_age": 0}},
    {"predicates__Low": {**BATTERY, "qos": {"dept": 3}}},
    {"predicates__Low": {**BATTERY, "qos": {"depth": 0}}},
    {"predicates__Low": {**BATTERY, "qos": {"reliability": "best"}}},
    {"predicates__Low": {**BATTERY, "qos": "reliable"}},
    {"events__Bumped": {"topic": "/bumper"}},
    {"ros2": {}, "places": {"graph": "floor.xml", "reach": 1.9, "pose": {"topic": "/p", "type": "std_msgs/msg/Bool"}}},
    {"ros2": {}, "places": {"graph": "floor.xml", "reach": 1.9, "pose": {"topic": "/p", "covariance": 0}}},
    {"ros2": {}, "places": {"graph": "floor.xml", "reach": 1.9, "navigator": {"ros2": {"actions": "/p"}}}},
    {"places": {"graph": "floor.xml", "reach": 1.9, "navigator": {"ros2": "/navigate"}}},
    {"events__Bumped": {**BATTERY, "max_age": 3.0}},
    {"ensembles__top__actions__Dock": {"action": "/dock"}},
    {"ensembles__top__actions__Dock": {**DOCK, "goals": {}}},
    {"ensembles__top__actions__Dock": {**DOCK, "goal": "robot_code:hom"}},
    {"ensembles__top__actions__Dock": {**DOCK, "feedback": {"predicate": "Nearby", "when": "x"}}},
    {"ensembles__top__actions__Dock": {**DOCK, "feedback": {"when": "x"}}},
    {"ros2": {"node": "my robot"}},
    {"ros2": {"namespace": "/a//b"}},
    {"ros2": {"remap": {"/scan": "/front scan"}}},
    {"predicates__Low": {**BATTERY, "topic": "/2nd"}},
    {"predicates__Low": {**BATTERY, "type": "sensor_msgs/BatteryState"}},
    {"events__Bumped": {**BATTERY, "topic": "/robot//bumper", "type": "sensor_msgs/srv/BatteryState"}},
    {"ensembles__top__actions__Dock": {**DOCK, "action": "/dock/"}},
    {"ensembles__top__actions__Dock": {**DOCK, "type": "nav2_msgs/action/DockRobot_Goal"}},
    {"ros2": {}, "places": {"graph": "floor.xml", "reach": 1.9, "navigator": {"ros2": {"action": "/to pose"}}}},
    {"ensembles__top__actions__Dock": {"service": "/dock", "type": "std_srvs/srv/SetBool", "silence": 3.0}},
    {"ensembles__top__actions__Dock": {"publish": "/cmd_vel", "type": TWIST, "rate": 0}},
    {"ensembles__top__actions__Dock": {"publish": "/cmd_vel", "type": TWIST, "until": 3.0}},
    {"ensembles__top__actions__Dock": {"publish": "/cmd_vel", "type": TWIST, "rate": 9.0, "until": "Lo"}},
    {"ensembles__top__safe_action": {"publish": "/cmd_vel", "type": TWIST, "rate": 9.0}},
]
UNCHECKED = [
    {"ros2": {"wire": "robot_code:home"}},
    {"predicates__Low": {**BATTERY, "type": "sensor_msgs/msg/Battery"}},
    {"predicates__Low": {**BATTERY, "when": "percentag < 0.2"}},
    {"predicates__Low": {**BATTERY, "when": "robot_code:later"}},
    {"events__Bumped": {**BATTERY, "type": "std_msgs/msg/Bool", "when": "data"}},
    {"events__Bumped": {**BATTERY, "qos": {"depth": 3}}},
    {"ensembles__top__actions__Dock": {"action": "/dock", "type": "nav2_msgs/action/Dock"}},
    {"ensembles__top__actions__Dock": {"service": "/x", "type": "std_srvs/srv/SetBool", "request": {"dat": True}}},
    {"ensembles__top__actions__Dock": {**DOCK, "feedback": "cont"}},
    {"ensembles__top__actions__Dock": {**DOCK, "feedback": {"predicate": "Charging", "when": "cont > 1"}}},
]


@pytest.mark.parametrize("change", WRONG, ids=str)
def test_what_is_wrong_is_told_with_and_without_ros(change, folder):
    """The same without rclpy, as a document, and while the wire is there."""
    with refused(ConfigError) as caught:
        load_system(changed(**change), folder=folder, tables=reader_of(Peers()))
    path = folder / "robot.toml"
    path.write_text("\n".join(toml(changed(**change))))
    with pytest.raises(ConfigError) as looked:
        look_over(path)
    assert [error.key for error in looked.value.problems] == [error.key for error in caught.value.problems]


@pytest.mark.parametrize("change", UNCHECKED, ids=str)
def test_what_ros_says_is_wrong_is_told_where_it_is_there(change, folder):
    with refused(ConfigError):
        load_system(changed(**change), folder=folder, tables=reader_of(Peers()))


@pytest.mark.parametrize("change", UNCHECKED, ids=str)
def test_without_ros_types_are_unchecked(change, folder):
    load_system(changed(**change), folder=folder, callbacks=False)


def test_all_problems_are_told_at_once(folder):
    with refused(ConfigError) as caught:
        load_system(
            changed(ros2={"nod": "x"}, predicates__Low={**BATTERY, "when": "<"}, events__Bumped={"topic": 3}),
            folder=folder,
            callbacks=False,
        )
    assert len(caught.value.problems) == 3


def test_without_rclpy_one_sentence_says_how_it_is_had(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with refused(ConfigError) as caught:
        load_system(folder / "robot.toml")
    assert len(caught.value.problems) == 1
    look_over(folder / "robot.toml")


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize(
    "written",
    [
        {"action": "/dock_robot", "type": "nav2_msgs/action/DockRobot"},
        {"service": "/brake", "type": "std_srvs/srv/SetBool"},
        {"publish": "/cmd_vel", "type": TWIST},
    ],
    ids=["goal", "call", "message"],
)
def test_the_options_of_an_action_are_those_of_its_binding(times, written, folder):
    own = {"timeout": 10.0 * times, "grace": 2.0 * times, "pause": 0.25 * times, "attempts": 2 * times}
    own["then"] = "decide"
    more = {"rate": 5.0 * times, "until": 2.0 * times} if "publish" in written else {}
    document = changed(ensembles__top__actions__Dock={**written, **own, **more})
    system = load_system(document, folder=folder, tables=reader_of(Peers()))
    action = system.ensembles["top"].action
    binding = action.bindings[action.names.index("Dock")]
    sequel = binding.sequel
    assert (binding.timeout, binding.grace) == (own["timeout"], own["grace"])
    assert (sequel.pause, sequel.attempts, sequel.then) == (own["pause"], own["attempts"], "decide")


@pytest.mark.parametrize(
    ("space", "remapped", "left"),
    [
        (
            "",
            ["/battery", "bumper", "/cmd_vel", "/dock_robot", "/brake", "~/start", "/patrol/stop", "/diagnostics"],
            [],
        ),
        ("", ["/batteries", "battery/", "/start"], ["/batteries", "battery/", "/start"]),
        ("/robot1", ["/battery", "battery", "/robot1/patrol/modes", "/patrol/modes"], ["battery", "/patrol/modes"]),
        ({"a": "/ada"}, ["/battery", "/navigate_to_pose"], []),
    ],
)
def test_of_remapped_names_those_are_told_that_nothing_has(space, remapped, left):
    table = {"node": "patrol", "namespace": space, "remap": dict.fromkeys(remapped, "/other")}
    expected = [(("ros2", "remap", name), f"ros2.remap: nothing in this file uses {name!r}") for name in left]
    assert [*notes(changed(ros2=table))] == expected


def test_a_predicate_by_feedback_knows_nothing_of_the_goal_before(folder):
    wire = Peers()
    wire.types["nav2_msgs/action/DockRobot_Feedback"] = {"count": "int32"}
    feedback = {"predicate": "Charging", "when": "count > 2 until < 1"}
    document = changed(ensembles__top__actions__Dock={**DOCK, "action": "/dock_robot", "feedback": feedback})
    system = load_system(document, folder=folder, tables=reader_of(wire))

    async def main(runtime):
        await runtime.start(system)
        told = []
        for percentage in (0.1, 0.1, 0.5, 0.1):
            wire.send("/battery", percentage=percentage)
            await asyncio.sleep(0.1)
            for goal in wire.dock.live:
                for count in (2, 3, 2) if not told else (2,):
                    goal.feed(count=count)
                    told.append(system.predicates.value("Charging"))
        return told

    assert run_virtual(main) == [None, True, True, True, None]


@pytest.mark.parametrize("silence", [0.5, 2.0])
def test_a_drive_of_a_silent_navigator_fails(silence, folder):
    wire = StandIn()
    Server(wire, "/navigate_to_pose", takes=None)
    (folder / "places.toml").write_text(PLACES.replace("silence = 3.0", f"silence = {silence}"))
    system = load_system(folder / "places.toml", tables=reader_of(wire))

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(system)
        pose = {"position": {"x": 2.0, "y": 2.0}, "orientation": {"w": 1.0}}
        wire.send("/amcl_pose", pose={"pose": pose, "covariance": [0.1, *[0.0] * 6, 0.1, *[0.0] * 28]})
        await asyncio.sleep(silence + 0.5)
        assert f"told nothing for {silence:g} s" in next(each.detail for each in faults if each.kind == "action")

    run_virtual(main)
