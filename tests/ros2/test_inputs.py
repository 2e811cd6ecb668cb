"""Topics as input: predicates, events and poses, in virtual time, and from a thread that floods the loop."""

from __future__ import annotations

import asyncio
import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from ros2.stand_in import StandIn
from rows_of_rooms import row_of_rooms
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error
from mdm.maps import Places
from mdm.messages import PoseUpdate
from mdm.ros2 import Link, Quality
from mdm.testing import probe, run_virtual

BOOL, FLOAT = "std_msgs/msg/Bool", "std_msgs/msg/Float64"
BATTERY, SCAN = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/LaserScan"
AMCL, STAMPED, ODOMETRY = (
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
)
LATCHED = Quality(reliability="reliable", durability="transient_local")


class Robot:
    """A predicate manager behind a link over a stand-in."""

    def __init__(self):
        self.wire = StandIn()
        self.predicates = mdm.PredicateManager()
        self.link = Link(self.wire, self.predicates)
        self.send = self.wire.send

    def run(self, script, *actors):
        async def main(runtime):
            self.faults = probe(runtime.faults)
            for actor in actors or (self.predicates,):
                await runtime.start(actor)
            self.sensed, self.raised = probe(self.predicates.sensed), probe(self.predicates.events)
            return await script(runtime)

        return run_virtual(main, extensions=[self.link])

    @property
    def events(self):
        return [event for update in self.raised for event in update.events]

    def value(self, name):
        return self.predicates.value(name)


def test_the_newest_message_decides_and_grows_old():
    robot = Robot()
    robot.link.topic("/battery", BATTERY).predicate("Low", "percentage < 0.2 until > 0.3", max_age=5.0)
    assert robot.predicates.declared.definition("Low") == (
        "set by /battery: percentage < 0.2 until > 0.3, unknown after 5 s"
    )

    async def script(runtime):
        told = []
        for percentage in (0.25, 0.15, 0.25, math.nan, 0.25, 0.35, 0.25):
            robot.send("/battery", percentage=percentage)
            told.append(robot.value("Low"))
        assert told == [None, True, True, None, True, False, False]
        await asyncio.sleep(4.9)
        assert robot.value("Low") is False
        await asyncio.sleep(0.2)
        assert robot.value("Low") is None
        assert [(fault.source, fault.kind) for fault in robot.faults] == [("predicates", "stale")]
        robot.send("/battery", percentage=0.1)
        assert robot.value("Low") is True

    robot.run(script)


def test_for_hours_a_topic_comes_and_goes():
    robot = Robot()
    robot.link.topic("/ok", BOOL).predicate("Ok", "data", max_age=1.0)

    async def script(runtime):
        for hour in range(6):
            for _ in range(2400):
                robot.send("/ok", data=hour % 2 == 0)
                await asyncio.sleep(0.5)
                assert robot.value("Ok") is (hour % 2 == 0)
            await asyncio.sleep(2400)
            assert robot.value("Ok") is None

    robot.run(script)
    assert robot.link.topics["/ok"].heard == 14_400
    assert [fault.kind for fault in robot.faults] == ["stale"] * 6


def test_all_that_a_message_says_is_one_update():
    robot = Robot()
    topic = robot.link.topic("/scan", SCAN)
    topic.predicate("Near", "ranges[0] < 0.5")
    topic.predicate("Far", lambda scan: min(scan.ranges) > 3)
    topic.event("Touched", lambda scan: scan.ranges[0] == 0)
    assert robot.link.topic("/scan", SCAN) is topic
    assert len(robot.wire.subscribed["/scan"]) == 1

    async def script(runtime):
        robot.send("/scan", ranges=[0, 4])
        event, update = robot.sensed
        assert (event.events, update.predicates) == (("Touched",), (("Near", True), ("Far", False)))
        assert update.sensed == update.time == runtime.now()

    robot.run(script)


def test_each_message_for_which_a_condition_holds_raises_an_event():
    robot = Robot()
    topic = robot.link.topic("/bumper", BOOL)
    topic.event("Bumped", "data")
    topic.event("Heard")

    async def script(runtime):
        for data in (True, True, False, True):
            robot.send("/bumper", data=data)
        assert robot.events == ["Bumped", "Heard", "Bumped", "Heard", "Heard", "Bumped", "Heard"]

    robot.run(script)


@pytest.mark.parametrize("answer", [ZeroDivisionError("no\nscan"), 3, "yes"])
def test_a_function_that_fails_is_one_fault_and_unknown(answer):
    robot = Robot()

    def when(message):
        if message.data is not None:
            return message.data
        if isinstance(answer, Exception):
            raise answer
        return answer

    topic = robot.link.topic("/ok", BOOL)
    topic.predicate("Ok", when)
    topic.event("Raised", when)
    robot.wire._value = lambda kind, name, its, value=None: value

    async def script(runtime):
        robot.send("/ok", data=True)
        assert (robot.value("Ok"), robot.events) == (True, ["Raised"])
        for _ in range(3):
            robot.send("/ok")
            assert robot.value("Ok") is None
        robot.send("/ok", data=True)
        assert (robot.value("Ok"), robot.events) == (True, ["Raised"] * 2)

    robot.run(script)
    assert [(fault.source, fault.kind) for fault in robot.faults] == [("ros2/ok", "sensor")] * 2
    with refused(Error):
        raise Error("\n".join(fault.detail.partition(" (at")[0] for fault in robot.faults))


def test_messages_before_the_start_count_and_events_do_not():
    robot = Robot()
    topic = robot.link.topic("/ok", BOOL)
    topic.predicate("Ok", "data", max_age=3.0)
    topic.event("Heard")

    async def main(runtime):
        robot.send("/ok", data=True)
        await asyncio.sleep(1)
        await runtime.start(robot.predicates)
        assert robot.value("Ok") is True

    run_virtual(main, extensions=[robot.link])


# -- From a thread -------------------------------------------------------------------------------------------------


def flood(robot, messages):
    """Hear messages in a thread, while the event loop is held."""
    (entry,) = robot.wire.subscribed.values()
    ((_, hear, _),) = entry

    def run():
        for message in messages:
            hear(message)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()


def test_of_a_flood_the_newest_message_counts_and_nothing_waits_beside_it():
    robot, asked = Robot(), []
    topic = robot.link.topic("/scan", SCAN)
    topic.predicate("Odd", lambda message: asked.append(message.number) or message.number % 2 == 1)

    async def script(runtime):
        for part in range(3):
            flood(robot, (SimpleNamespace(number=10_000 * part + number) for number in range(10_000)))
            assert len(topic._waiting) == 1
            while len(asked) <= part:
                await asyncio.sleep(0)
            assert robot.value("Odd") is True
        await asyncio.sleep(1)
        assert asked == [9_999, 19_999, 29_999]
        statistics = runtime.statistics().dispatcher
        assert (topic.heard, statistics.replaced, statistics.lost) == (30_000, 29_997, 0)

    robot.run(script)
    assert robot.faults == []


def test_a_message_is_as_old_as_when_it_came():
    robot = Robot()
    robot.link.topic("/ok", BOOL).predicate("Ok", "data", max_age=3.0)
    (entry,) = robot.wire.subscribed["/ok"]

    async def script(runtime):
        came = runtime.clock.now()
        real, runtime.clock.now = runtime.clock.now, lambda: came - 2_000_000_000
        entry[1](SimpleNamespace(data=True))
        runtime.clock.now = real
        assert robot.sensed[-1].sensed == came - 2_000_000_000
        await asyncio.sleep(0.9)
        assert robot.value("Ok") is True
        await asyncio.sleep(0.2)
        assert robot.value("Ok") is None

    robot.run(script)


def test_events_of_a_flood_are_all_raised_up_to_the_bound_of_the_inbox():
    robot = Robot()
    robot.link.topic("/bumper", BOOL).event("Bumped", "data")

    async def script(runtime):
        flood(robot, (SimpleNamespace(data=number % 2 == 0) for number in range(4_000)))
        await asyncio.sleep(1)
        assert (robot.events, robot.faults) == (["Bumped"] * 2_000, [])
        flood(robot, (SimpleNamespace(data=True) for _ in range(4_000)))
        await asyncio.sleep(1)
        assert len(robot.events) == 2_000 + 2_048
        assert [fault.kind for fault in robot.faults] == ["overflow"]

    robot.run(script)


def test_a_function_is_asked_about_as_many_messages_as_the_depth_and_a_fault_tells_of_others():
    robot, asked = Robot(), []
    topic = robot.link.topic("/bumper", BOOL, Quality(depth=5))
    topic.event("Bumped", lambda message: asked.append(message.number) or True)

    async def script(runtime):
        flood(robot, (SimpleNamespace(number=number) for number in range(5)))
        await asyncio.sleep(1)
        assert (asked, robot.faults) == ([*range(5)], [])
        flood(robot, (SimpleNamespace(number=number) for number in range(12)))
        await asyncio.sleep(1)
        assert asked == [*range(5), *range(7, 12)]
        assert (robot.events, topic.lost) == (["Bumped"] * 10, 7)

    robot.run(script)
    (fault,) = robot.faults
    assert (fault.source, fault.kind) == ("ros2/bumper", "overflow")
    assert fault.detail == "messages came faster than functions were asked: 7 were lost"


# -- Stamps --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("age", "quality", "told"),
    [
        (0, None, False),
        (4.9, None, False),
        (5.1, None, True),
        (5.1, LATCHED, False),
        (-0.9, None, False),
        (-1.1, LATCHED, True),
        (1000, None, False),
    ],
)
def test_a_stamp_of_another_clock_is_one_fault_and_changes_nothing(age, quality, told):
    robot = Robot()
    robot.link.topic("/battery", BATTERY, quality).predicate("Low", "percentage < 0.2", max_age=5.0)

    async def script(runtime):
        await asyncio.sleep(1000)  # a stamp of 0 is none
        for _ in range(3):
            await asyncio.sleep(1)
            stamp = 0 if age == 1000 else runtime.clock.now() - round(age * 1e9)
            seconds, nanoseconds = divmod(stamp, 1_000_000_000)
            robot.send("/battery", header={"stamp": {"sec": seconds, "nanosec": nanoseconds}}, percentage=0.1)
            assert robot.value("Low") is True
        return [(fault.source, fault.kind, fault.detail) for fault in robot.faults]

    faults = robot.run(script)
    assert [fault[:2] for fault in faults] == [("ros2/battery", "clock")] * told
    if told:
        assert faults[0][2].startswith(
            "the stamp of a message is 5.1 s old" if age > 0 else "the stamp of a message is 1.1 s ahead"
        )


# -- Poses ---------------------------------------------------------------------------------------------------------


def located(kind, covariance=0.5, **options):
    robot = Robot()
    robot.places = Places(row_of_rooms("Hall", "Kitchen"), robot.predicates, **options)
    robot.link.topic("/pose", kind).pose(robot.places, covariance)
    return robot


def pose(x, y=2.0, yaw=0.0, covariance=None):
    """Return the fields of a message."""
    orientation = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    here = {"position": {"x": float(x), "y": float(y)}, "orientation": orientation}
    if covariance is None:
        return {"pose": here}
    matrix = np.zeros((6, 6))
    matrix[:2, :2] = covariance
    return {"pose": {"pose": here, "covariance": matrix.ravel().tolist()}}


@pytest.mark.parametrize("kind", [AMCL, STAMPED, ODOMETRY])
def test_a_pose_of_each_type_tells_the_place(kind):
    robot = located(kind)
    covariance = None if kind == STAMPED else np.eye(2) * 0.4

    async def script(runtime):
        poses = probe(runtime.channel("places/pose", PoseUpdate))
        for x, place in ((2.0, "Hall"), (6.0, "Kitchen")):
            robot.send("/pose", **pose(x, yaw=x - 4, covariance=covariance))
            assert robot.places.place == place
            assert (poses[-1].x, poses[-1].y, poses[-1].yaw) == pytest.approx((x, 2.0, x - 4))
        await asyncio.sleep(0.6)
        assert robot.places.place is None

    robot.run(script, robot.places)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, 1), st.floats(0.01, 1), st.floats(-math.pi, math.pi))
def test_the_variance_is_that_of_the_axis_in_which_a_pose_is_least_certain(first, second, angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance = turn @ np.diag([first, second]) @ turn.T
    robot = located(AMCL, covariance=0.3)

    async def script(runtime):
        robot.send("/pose", **pose(2.0, covariance=covariance))
        return robot.places.place

    greatest = np.linalg.eigvalsh(covariance)[-1]
    if abs(greatest - 0.3) > 1e-9:
        assert robot.run(script, robot.places) == ("Hall" if greatest < 0.3 else None)


@pytest.mark.parametrize("covariance", [math.nan, -1.0, 0.51])
def test_an_uncertain_pose_is_told_once_and_places_are_unknown(covariance):
    robot = located(AMCL)

    async def script(runtime):
        robot.send("/pose", **pose(2.0, covariance=np.eye(2) * 0.5))
        for _ in range(10):
            robot.send("/pose", **pose(6.0, covariance=np.eye(2) * covariance))
            await asyncio.sleep(0.1)
        assert robot.places.place is None
        robot.send("/pose", **pose(6.0, covariance=np.zeros((2, 2))))
        assert robot.places.place == "Kitchen"

    robot.run(script, robot.places)
    assert [(fault.source, fault.kind) for fault in robot.faults] == [("ros2/pose", "pose"), ("places", "stale")]


@pytest.mark.parametrize("frame", ["", "map", "/map", "robot1/map", "odom", "maps"])
def test_a_pose_of_another_frame_than_the_map_is_told_once_and_taken(frame):
    robot = located(STAMPED)

    async def script(runtime):
        for _ in range(3):
            robot.send("/pose", header={"frame_id": frame}, **pose(2.0))
            await asyncio.sleep(0.1)
        assert robot.places.place == "Hall"

    robot.run(script, robot.places)
    text = f"poses in the frame {frame!r} are taken as of the map: there is no tf2 here"
    assert [fault.detail for fault in robot.faults] == ([text] if frame in {"odom", "maps"} else [])


def test_a_pose_that_came_before_the_start_counts_then():
    robot = located(AMCL, max_age=5.0)

    async def main(runtime):
        robot.send("/pose", **pose(2.0, covariance=np.zeros((2, 2))))
        await asyncio.sleep(1)
        await runtime.start(robot.places)
        assert robot.places.place == "Hall"
        await asyncio.sleep(4.1)
        assert robot.places.place is None

    run_virtual(main, extensions=[robot.link])


# -- Refused -------------------------------------------------------------------------------------------------------


def test_what_cannot_be_declared_is_refused():
    robot = Robot()
    robot.link.topic("/ok", BOOL).predicate("Ok", "data")
    topic = robot.link.topic("/ok", BOOL)

    async def later(message):
        return True

    for number, when in enumerate(("dat", "data < 3", "data <", later, 3)):
        with refused(Error):
            topic.predicate(f"Other{number}", when)
    with refused(ConfigError):
        topic.predicate("Ok", "data")
    with refused(ConfigError):
        robot.link.topic("/ok", FLOAT)
    with refused(ConfigError):
        robot.link.topic("/ok", BOOL, LATCHED)
    with refused(ConfigError):
        topic.pose(None)
    with refused(Error):
        robot.link.topic("/other", "std_msgs/msg/Boolean")
