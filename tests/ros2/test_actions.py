"""Goals, calls and messages as actions of ensembles, over a wire in plain Python and in virtual time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest
from action_lives import lives_of, robot, told
from ros2.stand_in import Server, StandIn
from sentences import refused

from mdm import PredicateManager, load_system
from mdm.errors import ConfigError
from mdm.messages import Fault, Progress
from mdm.ros2.actions import Actions
from mdm.ros2.link import Link
from mdm.ros2.wire import Quality, WireError
from mdm.testing import probe, run_virtual

DOCK, TWIST = "nav2_msgs/action/DockRobot", "geometry_msgs/msg/Twist"


def known(*names):
    predicates = PredicateManager()
    for name in names:
        predicates.sensor(name)
    return predicates


def run(make, scenario, *, safe=None):
    """Run a robot that waits or acts, by what a function makes of the actions of a link; likewise its safe action."""

    async def main(runtime):
        wire = StandIn()
        predicates = known("IsStill", "IsNear")
        actions = Actions(wire, predicates)
        made = {"Wait": lambda: None, "Act": make(actions), **({} if safe is None else {"Safe": safe(actions)})}
        robots = robot(made, predicates=predicates, safe_action=None if safe is None else "Safe")
        bench = SimpleNamespace(runtime=runtime, wire=wire, predicates=predicates, robot=robots)
        bench.lives, bench.faults = lives_of(runtime), probe(runtime.channel("faults", Fault))
        bench.act = lambda: robots.publish_state(1)
        bench.wait = lambda: robots.publish_state(0)
        bench.ends = lambda: [each for each in told(bench.lives) if each[0] == "Act" and each[1] != "running"]
        bench.told = lambda: [(fault.source, fault.kind, fault.detail) for fault in bench.faults]
        bench.sent = lambda topic: [
            (round(time - bench.begin, 6), each.linear.x) for time, each in wire.published[topic]
        ]
        await wire.open(runtime)
        await actions.open(runtime)
        await runtime.start(predicates)
        await runtime.start(robots)
        bench.begin = asyncio.get_running_loop().time()
        await scenario(bench)
        await actions.close()

    run_virtual(main, log=False)


# -- Messages --------------------------------------------------------------------------------------------------------


def test_a_message_of_a_goal_is_made_of_the_file_or_by_a_function():
    def of_action(action):
        return {"dock_id": f"dock {action.index}"}

    for made, dock in (
        (None, ""),
        ({"dock_id": "home"}, "home"),
        (of_action, "dock 1"),
        (lambda: {"dock_id": "any"}, "any"),
        (lambda: SimpleNamespace(dock_id="own"), "own"),
    ):

        async def scenario(bench, dock=dock):
            server = Server(bench.wire, "/dock", takes=1)
            bench.act()
            await asyncio.sleep(2)
            assert [goal.message.dock_id for goal in server.goals] == [dock]
            assert bench.ends() == [("Act", "succeeded")]

        run(lambda actions, made=made: actions.goal("/dock", DOCK, goal=made), scenario)


def test_a_function_that_makes_a_wrong_message_fails_the_action():
    async def scenario(bench):
        server = Server(bench.wire, "/dock", takes=1)
        bench.act()
        await asyncio.sleep(2)
        assert not server.sent
        assert bench.ends() == [("Act", "failed")]
        assert "has no field 'dock'" in bench.lives[-1].detail

    run(lambda actions: actions.goal("/dock", DOCK, goal=lambda: {"dock": 1}), scenario)


@pytest.mark.parametrize(
    "make",
    [
        lambda actions: actions.goal("/dock", DOCK, goal={"dock": "home"}),
        lambda actions: actions.goal("/dock", DOCK, goal={"dock_id": 3}),
        lambda actions: actions.goal("/dock", "nav2_msgs/action/Dock"),
        lambda actions: actions.publish("/cmd_vel", TWIST, message={"linear": {"u": 1.0}}),
        lambda actions: actions.publish("/cmd_vel", TWIST, rate=1.0, last={"linear": 1}),
        lambda actions: actions.call("/lamp", "std_srvs/srv/SetBool", request={"on": True}),
    ],
)
def test_a_wrong_type_or_field_is_refused_before_anything_runs(make):
    with pytest.raises(WireError):
        make(Actions(StandIn()))


async def lasting():
    """Last."""


def two(one, other):
    """Take two arguments."""


WRONG = {
    "silence": lambda actions: actions.goal("/dock", DOCK, silence=0),
    "lasting": lambda actions: actions.goal("/dock", DOCK, goal=lasting),
    "arguments": lambda actions: actions.goal("/dock", DOCK, goal=two),
    "option": lambda actions: actions.goal("/dock", DOCK, gracee=3),
    "until": lambda actions: actions.publish("/cmd_vel", TWIST, until=3.0),
    "last": lambda actions: actions.publish("/cmd_vel", TWIST, last={}),
    "rate": lambda actions: actions.publish("/cmd_vel", TWIST, rate=-1.0),
    "predicate": lambda actions: actions.publish("/cmd_vel", TWIST, rate=1.0, until="IsStil"),
    "past": lambda actions: actions.publish("/cmd_vel", TWIST, rate=1.0, until=-3.0),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_option_is_refused(wrong):
    with refused(ConfigError):
        WRONG[wrong](Actions(StandIn(), known("IsStill")))


# -- Feedback --------------------------------------------------------------------------------------------------------


def test_a_field_of_the_feedback_is_told_as_progress():
    async def scenario(bench):
        Server(bench.wire, "/dock", takes=1.0, feeds=0.3)
        progress = probe(bench.runtime.channel("ros2/progress", Progress))
        bench.act()
        await asyncio.sleep(2)
        assert [(each.place, each.remaining) for each in progress] == [("/dock", 1.0), ("/dock", 2.0), ("/dock", 3.0)]
        assert bench.ends() == [("Act", "succeeded")]

    run(lambda actions: actions.goal("/dock", DOCK, feedback="count"), scenario)


@pytest.mark.parametrize("feedback", ["distance", lambda message: message.distance])
def test_feedback_that_cannot_be_taken_is_told_once_and_the_goal_goes_on(feedback):
    async def scenario(bench):
        Server(bench.wire, "/dock", takes=1.0, feeds=0.3)
        bench.act()
        await asyncio.sleep(2)
        assert bench.ends() == [("Act", "succeeded")]
        [(source, kind, detail)] = bench.told()
        assert (source, kind) == ("ros2/dock", "exception")
        assert "the feedback cannot be taken: AttributeError" in detail

    run(lambda actions: actions.goal("/dock", DOCK, feedback=feedback), scenario)


# -- Services --------------------------------------------------------------------------------------------------------


def lamp(actions, **options):
    return actions.call("/lamp", "std_srvs/srv/SetBool", request={"data": True}, **options)


@pytest.mark.parametrize(
    ("response", "status", "words"),
    [
        ({"success": True, "message": "on"}, "succeeded", ""),
        ({"success": False, "message": "no bulb"}, "failed", "the service /lamp answered without success: 'no bulb'"),
        ({}, "succeeded", ""),
    ],
)
def test_a_call_of_a_service_ends_as_its_response_says(response, status, words):
    async def scenario(bench):
        requests = []

        async def serve(request):
            requests.append(request.data)
            await asyncio.sleep(0.5)
            return SimpleNamespace(**response)

        bench.wire.services["/lamp"] = serve
        bench.act()
        await asyncio.sleep(0.4)
        assert not bench.ends()
        await asyncio.sleep(0.2)
        assert (requests, bench.ends()) == ([True], [("Act", status)])
        assert words in bench.lives[-1].detail

    run(lamp, scenario)


def test_a_service_that_is_not_there_is_waited_for_and_told():
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(2.9)
        assert bench.told() == [("ros2/lamp", "unmatched", "the server of /lamp is not there: an action waits for it")]
        assert not bench.ends()
        await asyncio.sleep(0.2)
        assert bench.ends() == [("Act", "timed_out")]
        bench.wait()
        bench.act()
        bench.wire.services["/lamp"] = lambda _: SimpleNamespace()
        await asyncio.sleep(0.2)
        assert bench.ends()[1:] == [("Act", "succeeded")]

    run(lambda actions: lamp(actions, timeout=3.0), scenario)


def test_a_call_that_is_pre_empted_is_waited_for_no_longer():
    async def scenario(bench):
        async def serve(_):
            await asyncio.sleep(100)

        bench.wire.services["/lamp"] = serve
        bench.act()
        await asyncio.sleep(1)
        bench.wait()
        await asyncio.sleep(0.001)
        assert bench.ends() == [("Act", "preempted")]

    run(lamp, scenario)


# -- Topics ----------------------------------------------------------------------------------------------------------


def test_a_message_is_published_once():
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(1)
        assert bench.sent("/cmd_vel") == [(0, 0.1)]
        assert bench.ends() == [("Act", "succeeded")]
        assert bench.wire.publishers["/cmd_vel"].quality == Quality(reliability="reliable")

    run(lambda actions: actions.publish("/cmd_vel", TWIST, message={"linear": {"x": 0.1}}), scenario)


@pytest.mark.parametrize(("rate", "until", "count"), [(10.0, 0.5, 5), (4.0, 1.0, 4), (10.0, 0.001, 1)])
def test_a_message_is_published_at_a_rate_for_a_time(rate, until, count):
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(3)
        assert bench.sent("/cmd_vel") == [(round(tick / rate, 6), 0) for tick in range(count)]
        assert bench.ends() == [("Act", "succeeded")]

    run(lambda actions: actions.publish("/cmd_vel", TWIST, rate=rate, until=until), scenario)


def test_a_message_is_published_at_a_rate_until_a_predicate_is_true():
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(0.35)
        bench.predicates.sense("IsStill", False)
        await asyncio.sleep(0.3)
        bench.predicates.sense("IsStill", True)
        await asyncio.sleep(1)
        assert [time for time, _ in bench.sent("/cmd_vel")] == [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
        assert bench.ends() == [("Act", "succeeded")]

    run(lambda actions: actions.publish("/cmd_vel", TWIST, rate=10.0, until="IsStill"), scenario)


def test_what_was_held_up_is_not_made_up_for():
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(0.15)
        asyncio.get_running_loop()._virtual.now += 1_020_000_000  # as where the loop does something else for a second
        await asyncio.sleep(0.45)
        assert bench.sent("/cmd_vel") == [(at, 0) for at in (0, 0.1, 1.17, 1.27, 1.37, 1.47, 1.57)]

    run(lambda actions: actions.publish("/cmd_vel", TWIST, rate=10.0), scenario)


@pytest.mark.parametrize(("after", "sent", "end"), [(0.0, 3, "succeeded"), (1.05, 9, "succeeded"), (9.0, 3, "failed")])
def test_what_nobody_has_heard_until_its_end_is_said_for_a_while_more_or_has_failed(after, sent, end):
    async def scenario(bench):
        bench.wire.subscribers["/cmd_vel"] = int(not after)
        bench.act()
        await asyncio.sleep(after)
        bench.wire.subscribers["/cmd_vel"] = 1
        await asyncio.sleep(9)
        assert len(bench.sent("/cmd_vel")) == sent
        assert bench.ends() == [("Act", end)]

    run(lambda actions: actions.publish("/cmd_vel", TWIST, rate=10.0, until=0.3), scenario)


@pytest.mark.parametrize("last", [None, {"linear": {"x": -1.0}}])
@pytest.mark.parametrize("cancelled", [True, False])
def test_the_last_message_ends_what_is_published_at_a_rate(last, cancelled):
    async def scenario(bench):
        bench.act()
        await asyncio.sleep(0.25)
        if cancelled:
            bench.wait()
            await asyncio.sleep(1)
        else:
            await asyncio.sleep(1)
        assert bench.ends() == [("Act", "preempted" if cancelled else "succeeded")]
        times = [(0, 2.0), (0.1, 2.0), (0.2, 2.0)]
        end = 0.25 if cancelled else 0.3
        assert bench.sent("/cmd_vel") == [*times, *([] if last is None else [(end, -1.0)])]

    made = {"message": {"linear": {"x": 2.0}}, "rate": 10.0, "until": 0.3, "last": last}
    run(lambda actions: actions.publish("/cmd_vel", TWIST, **made), scenario)


def test_what_nobody_is_at_some_seconds_after_the_start_is_told_once():
    async def scenario(bench):
        bench.wire.subscribers["/cmd_vel"] = 0
        await asyncio.sleep(4.9)
        assert "unmatched" not in {fault.kind for fault in bench.faults}
        await asyncio.sleep(60)
        assert [each for each in bench.told() if each[1] == "unmatched"] == [
            ("ros2/cmd_vel", "unmatched", "nobody is at /cmd_vel yet, 5 s after the start")
        ]

    run(lambda actions: actions.publish("/cmd_vel", TWIST), scenario)


# -- Safe actions ----------------------------------------------------------------------------------------------------


def hold(actions):
    return actions.publish("/cmd_vel", TWIST, rate=10.0, until="IsStill")


@pytest.mark.parametrize("cause", ["mine", "silence"])
@pytest.mark.parametrize("state", ["sent", "accepted", "feeding", "cancelling", "silent"])
def test_the_safe_action_runs_in_each_state_of_a_goal(state, cause):
    async def scenario(bench):
        answers = 3600.0 if state == "sent" else 0.0
        server = Server(bench.wire, "/dock", answers=answers, feeds=None if state == "accepted" else 0.2, brakes=3.0)
        bench.act()
        await asyncio.sleep(0.5)
        if state == "cancelling":
            bench.wait()
            await asyncio.sleep(0.1)
        elif state == "silent" or cause == "silence":
            server.hold()
        begin = asyncio.get_running_loop().time()
        if cause == "mine":
            bench.robot.safety.endanger("mine", "", bench.runtime.now())
        await asyncio.sleep(3.2)
        asked = bench.wire.published["/cmd_vel"]
        if state == "cancelling" and cause == "silence":
            assert bench.robot.mode == "deciding"  # it was asked to end: that it did not is no cause
            return
        assert asked, "the safe action did not run"
        # A server that brakes while it is heard ends its goal first; else no later than its silence.
        assert asked[0][0] - begin <= 2.01 + (1.01 if state in {"feeding", "cancelling"} else 0)
        assert bench.robot.mode == "safe"
        count = len(asked)
        await asyncio.sleep(1.05)
        assert len(asked) - count in {10, 11}
        bench.predicates.sense("IsStill", True)
        await asyncio.sleep(0.2)
        assert told(bench.lives)[-1] == ("safe action", "succeeded")

    run(lambda actions: actions.goal("/dock", DOCK, silence=2.0), scenario, safe=hold)


def test_a_goal_as_the_safe_action_is_sent_also_where_the_end_of_another_was_not_heard():
    async def scenario(bench):
        server = Server(bench.wire, "/dock", feeds=0.2)
        bench.act()
        await asyncio.sleep(0.5)
        server.hold()
        await asyncio.sleep(2.1)
        server.behaviour.takes = 1.0
        assert [goal.message.dock_id for goal in server.sent] == ["away", "home"]
        server.wake()
        await asyncio.sleep(3)
        assert [goal.status for goal in server.sent] == [5, 4]
        assert told(bench.lives)[-1] == ("safe action", "succeeded")

    run(
        lambda actions: actions.goal("/dock", DOCK, goal={"dock_id": "away"}, silence=2.0),
        scenario,
        safe=lambda actions: actions.goal("/dock", DOCK, goal={"dock_id": "home"}),
    )


@pytest.mark.parametrize("state", ["sent", "accepted", "feeding", "cancelling", "silent"])
def test_the_end_of_a_program_ends_the_goal_in_each_state_and_the_safe_action_has_the_last_word(state):
    wire = StandIn()
    predicates = known("IsStill")
    link = Link(wire, predicates)
    made = {
        "Wait": lambda: None,
        "Act": link.actions.goal("/dock", DOCK, silence=2.0),
        "Safe": link.actions.publish("/cmd_vel", TWIST, rate=10.0, until=0.5),
    }
    robots = robot(made, predicates=predicates, safe_action="Safe")

    async def main(runtime):
        answers = 3600.0 if state == "sent" else 0.0
        server = Server(wire, "/dock", answers=answers, feeds=None if state == "accepted" else 0.2, brakes=1.0)
        await runtime.start(predicates)
        await runtime.start(robots)
        robots.publish_state(1)
        await asyncio.sleep(0.5)
        if state == "cancelling":
            robots.publish_state(0)
        elif state == "silent":
            server.hold()
        await asyncio.sleep(0.1)
        return server, asyncio.get_running_loop().time()

    server, end = run_virtual(main, log=False, extensions=[link])
    times = [time - end for time, _ in wire.published["/cmd_vel"]]
    assert len(times) == 5
    assert times[0] == pytest.approx(
        2.0 if state in {"sent", "silent"} else 0.9 if state == "cancelling" else 1.0, abs=0.01
    )
    assert server.sent[0].status == (None if state in {"sent", "silent"} else 5)
    assert wire.closed


# -- Notes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("silence", [None, 2.0, 0.5])
@pytest.mark.parametrize("written", [True, False])
def test_a_check_says_that_a_server_without_feedback_would_fail(silence, written):
    act = {"action": "/dock", "type": DOCK, **({} if silence is None else {"silence": silence})}
    if written:
        table = {"policy": [0, 1], "actions": {"Act": act, "Wait": {"call": "robot:wait"}}}
        document = {"ros2": {}, "ensembles": {"robot": table}}
        robots = load_system(document, callbacks=False).ensembles["robot"]
    else:
        robots = robot({"Act": Actions(StandIn()).goal("/dock", DOCK, silence=silence), "Wait": lambda: None})
    said = [note for note in robots.notes() if "feedback" in note]
    words = f"fails {silence or 0:g} s after the last feedback or status: leave its silence out where none comes"
    assert said == ([] if silence is None else [f"ensemble 'robot': action 'Act' {words}"])
