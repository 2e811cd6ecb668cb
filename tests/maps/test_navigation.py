"""Navigation: goals that depend on the room, lives that are told right, and sentences where nothing can be done."""

from __future__ import annotations

import asyncio
import threading

import pytest
from drives import Replacing, Reporting, Robot, patroller
from rows_of_rooms import row_of_rooms
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error, MapError
from mdm.maps import Edge, Floors, Graph, Lift, Map, Navigation, Places, Pose
from mdm.messages import Action, ActionLife, Heading, Progress
from mdm.testing import capture_decisions, probe, run_virtual

THREE = row_of_rooms("A", "B", "C")


class Driven:
    """A robot in three rooms, its ensemble, and all that they tell."""

    def __init__(self, kind=Robot, policy=None, *, x=2.0, floor=THREE, navigation=None, **options):
        self.predicates = mdm.PredicateManager()
        self.other = self.predicates.sensor("Other", initial=False)
        self.robot = kind(floor, self.predicates, x, 2.0)
        self.navigation = Navigation(floor, self.robot, self.robot.places)
        policy = policy or {"A": "Right", "B": "Right", "C": "Stay"}
        self.ensemble = patroller(self.navigation, policy, self.predicates, navigation or {}, **options)

    async def start(self, runtime):
        self.runtime = runtime
        self.faults = probe(runtime.faults)
        self.lives = probe(runtime.channel("robot/lives", ActionLife))
        self.progress = probe(runtime.channel("navigation/progress", Progress))
        await runtime.start(self.robot.places)
        await runtime.start(self.ensemble)
        self.living = asyncio.create_task(self.robot.live())
        return self

    @property
    def told(self):
        return [(life.action, life.status) for life in self.lives]


def drive(script, *arguments, **options):
    async def main(runtime):
        driven = await Driven(*arguments, **options).start(runtime)
        try:
            return await script(driven)
        finally:
            driven.living.cancel()
            driven.robot.goal = None

    return run_virtual(main)


def test_the_same_action_chosen_anew_in_the_next_room_goes_on_to_the_next_goal():
    async def script(driven):
        with capture_decisions(driven.runtime) as decisions:
            await asyncio.sleep(60)
        assert [decision.action_name for decision in decisions] == ["Right", "Right", "Stay"]
        assert driven.robot.said == ["go 6", "stop", "go 10", "stop"]

    drive(script, policy={"A": "Right", "B": "Right", "C": "Stay"})


def test_the_life_of_each_drive_is_told():
    async def script(driven):
        await asyncio.sleep(60)
        assert driven.told == [
            ("Right", "running"),
            ("Right", "preempted"),
            ("Right", "running"),
            ("Right", "preempted"),
            ("Stay", "running"),
            ("Stay", "succeeded"),
        ]
        assert driven.faults == []

    drive(script)


def test_a_drive_that_arrives_has_succeeded():
    async def script(driven):
        await asyncio.sleep(60)
        assert driven.told[-2:] == [("Left", "running"), ("Left", "succeeded")]
        assert driven.robot.x == 2.0

    drive(script, policy={"A": "Left", "B": "Left", "C": "Left"}, x=6.0, floor=looped())


def looped():
    """Three rooms, and a way from the first to itself."""
    edges = (*THREE.graph.edges, Edge("A", "A", "Left"), Edge("C", "C", "Right"))
    return Map(THREE.labels, Graph(THREE.graph.nodes, edges))


def test_a_new_goal_replaces_the_old_one_without_a_stop_and_the_lives_are_the_same():
    async def script(driven):
        await asyncio.sleep(60)
        assert driven.robot.said == ["go 6", "go 10", "stop"]
        assert driven.told == [
            ("Right", "running"),
            ("Right", "preempted"),
            ("Right", "running"),
            ("Right", "preempted"),
            ("Stay", "running"),
            ("Stay", "succeeded"),
        ]
        statistics = driven.ensemble.action.statistics()
        assert statistics.ended == {"preempted": 2, "succeeded": 1}
        assert statistics.work == 0
        assert driven.faults == []

    drive(script, Replacing)


def test_chosen_again_in_the_same_room_a_drive_goes_on():
    """At a fixed rate a robot that started anew at each decision would not come far."""

    async def script(driven):
        await asyncio.sleep(60)
        assert driven.robot.said == ["go 6", "stop", "go 10", "stop"]
        assert driven.ensemble.control.decisions > 500

    drive(script, drive=10.0)


def test_chosen_again_where_it_leads_nowhere_by_now_a_drive_fails():
    """The robot has been carried to where no way has this label."""

    async def script(driven):
        await asyncio.sleep(1)
        driven.robot.x = 10.0
        await asyncio.sleep(1)
        assert ("Right", "failed") in driven.told
        sentence = "action 'Right' failed: Error: from 'C' no way is called 'Right'; there are 'Left' to 'B'"
        assert driven.faults[0].detail.startswith(sentence)
        assert driven.robot.said == ["go 6", "stop"]

    drive(script, policy={"A": "Right", "B": "Right", "C": "Right"})


@pytest.mark.parametrize("kind", [Robot, Replacing])
def test_a_way_that_is_not_there_fails_with_a_sentence_and_moves_nothing(kind):
    async def script(driven):
        await asyncio.sleep(0.9)  # before it is decided again
        assert driven.told == [("Left", "running"), ("Left", "failed")]
        assert "from 'A' no way is called 'Left'; there are 'Right' to 'B'" in driven.faults[0].detail
        assert driven.robot.said == []

    drive(script, kind, policy={"A": "Left", "B": "Left", "C": "Left"})


def test_the_safe_action_waits_for_all_that_drives():
    """Even where a drive that was replaced takes its time, nothing moves beside the safe action."""

    class Slow(Replacing):
        async def go(self, goal):
            try:
                await super().go(goal)
            finally:
                await asyncio.sleep(1.5)
                self.said.append("ended")

    async def script(driven):
        while len(driven.robot.said) < 2:  # the second drive has begun, and the first one has yet to end
            await asyncio.sleep(0.05)
        driven.living.cancel()
        driven.robot.places.see(Pose(float("nan"), 0.0))  # a cause of the safe mode
        await asyncio.sleep(5)
        assert driven.robot.said == ["go 6", "go 10", "stop", "ended", "ended", "safe"]
        assert driven.ensemble.mode == "safe"
        assert driven.ensemble.action.statistics().work == 0

    said = []

    class Told(Slow):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.said = said

    drive(script, Told, safe_action=lambda: said.append("safe"))


def test_a_replaced_drive_that_does_not_end_is_abandoned_and_one_that_fails_is_told():
    class Stubborn(Replacing):
        async def go(self, goal):
            try:
                await super().go(goal)
            except asyncio.CancelledError:
                if goal.x == 10:
                    raise OSError("the wheels are stuck") from None
                await asyncio.sleep(1000)

    async def script(driven):
        await asyncio.sleep(40)
        assert [fault.detail.partition(" (at ")[0] for fault in driven.faults if fault.kind == "action"][:3] == [
            "action 'Right', which was replaced, abandoned: did not end within 2 s of being cancelled",
            "action 'Right' failed: still runs since 12.7 s ago, abandoned: it is not begun beside itself",
            "action 'Right', which was replaced, failed: OSError: the wheels are stuck",
        ]
        assert driven.robot.said == ["go 6", "go 10", "stop"]
        assert [status for _, status in driven.told].count("abandoned") == 0

    floor = row_of_rooms("A", "B", "C", "D")
    edges = (*floor.graph.edges, Edge("D", "D", "Right"))
    floor = Map(floor.labels, Graph(floor.graph.nodes, edges))
    policy = dict.fromkeys("ABCD", "Right")
    drive(script, Stubborn, policy, floor=floor, navigation={"grace": 2.0})


@pytest.mark.parametrize("drive", [None, 1.0, 10.0])
@pytest.mark.parametrize("end", ["", ".reached"])
def test_a_round_between_goals_goes_on_at_any_rate(drive, end):
    """The latch turns at goals, and the policy decides at goals or at borders: what is drawn on the way agrees."""

    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = Robot(THREE, predicates, 5.0, 1.0)  # at no goal
        predicates.latch("Back", set="C.at_goal", reset="A.at_goal")
        states = ["Right", "Left"] * 3  # at the end of a half, what stays there
        labels = list(THREE.graph.labels)
        ensemble = mdm.Ensemble(
            "robot",
            policy=mdm.policies.DeterministicPolicy([labels.index(label) for label in states], 2),
            predicates=predicates,
            states=[
                mdm.StateFactor("place", [f"{room}{end}" for room in "ABC"]),
                mdm.StateFactor("back", ["Back"]),
            ],
            actions=Navigation(THREE, robot, robot.places).actions(),
            **({} if drive is None else {"drive": mdm.FixedRate(drive)}),
        )
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.live())
        turns = probe(predicates.events)
        await asyncio.sleep(200)
        living.cancel()
        robot.goal = None
        arrived = [event for update in turns for event in update.events if event.endswith(".arrived")]
        ends = [event for event in arrived if event[0] != "B"]
        assert len(ends) >= 9
        assert ends == ["C.arrived", "A.arrived"] * (len(ends) // 2) + ["C.arrived"] * (len(ends) % 2)
        failed = ensemble.action.ended.get("failed", 0)
        assert failed == 0
        if end:
            assert set(ensemble.action.ended) == {"succeeded"}

    run_virtual(main)


def test_what_decides_at_a_goal_does_not_end_the_drive_short_of_it():
    async def main(runtime):
        lives = probe(runtime.channel("robot/lives", ActionLife))
        stopped = []

        class Turning(Robot):
            async def go(self, goal):
                await super().go(goal)
                await asyncio.sleep(2.0)  # to its yaw
                stopped.append((self.x, self.y))

        robot = Turning(THREE, predicates := mdm.PredicateManager(), 2.0, 2.0)
        ensemble = mdm.Ensemble(
            "robot",
            policy=[0, 0, 1],
            predicates=predicates,
            states=[mdm.StateFactor("place", ["A.reached", "B.reached", "C.reached"])],
            actions=Navigation(THREE, robot, robot.places).actions(),
        )
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.live())
        await asyncio.sleep(25)
        living.cancel()
        assert stopped == [(6.0, 2.0), (10.0, 2.0)]
        assert [life.status for life in lives] == ["running", "succeeded", "running", "succeeded", "running"]

    run_virtual(main)


def test_a_drive_that_ends_elsewhere_has_failed():
    class Hasty(Robot):
        async def go(self, goal):
            await asyncio.sleep(2.0)

    async def script(driven):
        await asyncio.sleep(3)
        assert driven.told == [("Right", "running"), ("Right", "failed")]
        assert (
            "the drive to 'B' has ended, and the robot is 4 m from the goal: at most 0.6 m" in driven.faults[0].detail
        )

    drive(script, Hasty)


def test_a_robot_that_settles_for_long_counts_as_there():
    """The navigator never says that it is there; what depends on the goal is told all the same."""

    class Endless(Robot):
        async def go(self, goal):
            await super().go(goal)
            await asyncio.sleep(1000)

    async def script(driven):
        async def told(predicate):
            while driven.predicates.value(predicate) is not True:
                await asyncio.sleep(0.1)
            return driven.runtime.clock.time()

        there = await told("B") + 2.8  # until the goal is near, at half a metre a second
        assert there + 9.0 < await told("B.at_goal") < there + 11.0

    policy = {"A": "Right", "B": "Left", "C": "Left"}
    drive(script, Endless, policy, floor=looped_at("B"))


def looped_at(name):
    """Three rooms, of which the middle one is left by its own way to itself."""
    edges = (*(edge for edge in THREE.graph.edges if edge.source != name), Edge(name, name, "Left"))
    return Map(THREE.labels, Graph(THREE.graph.nodes, edges))


def test_where_each_drive_leads_is_told_and_why():
    async def script(driven):
        headings = probe(driven.runtime.channel("navigation/headings", Heading))
        assert driven.navigation.heading is None
        await asyncio.sleep(1)
        assert driven.navigation.heading is headings[0]
        await asyncio.sleep(58)
        assert [(heading.label, heading.source, heading.target, heading.why) for heading in headings] == told
        assert driven.navigation.heading is None

    policy = dict.fromkeys("ABC", "Right")
    told = [("Right", "A", "B", "Right from A, decided on"), ("Right", "B", "C", "Right from B, decided on")]
    drive(script, policy=policy)
    told = [("Right", "C", "C", "no way from C, decided on, is called Right: it finishes its way there")]
    drive(script, policy=policy, x=9.0)


def test_a_place_that_is_not_known_fails_with_a_sentence():
    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = Robot(THREE, predicates, 2.0, 2.0)
        navigation = Navigation(THREE, robot, robot.places)
        await runtime.start(robot.places)
        go = navigation.actions()["Right"].function
        with refused(Error):
            go()
        robot.places.see(Pose(2, 2))
        assert navigation.place() == "A"
        assert navigation.target("Right").goal == Pose(6, 2)
        go().close()

    run_virtual(main)


def test_predicates_of_others_may_tell_the_place():
    async def main(runtime):
        predicates = mdm.PredicateManager()
        sensors = [predicates.sensor(f"In{name}", initial=False) for name in "ABC"]
        robot = Robot(THREE, mdm.PredicateManager(), 2.0, 2.0)
        navigation = Navigation(THREE.graph, robot, predicates, prefix="In")
        await runtime.start(predicates)
        with refused(Error):
            navigation.place()
        sensors[0].set(True)
        assert navigation.place() == "A"
        sensors[2].set(True)
        with refused(Error):
            navigation.place()

    run_virtual(main)


def test_what_remains_is_told_while_a_drive_lives():
    async def script(driven):
        await asyncio.sleep(60)
        assert [(update.place, round(update.remaining)) for update in driven.progress] == [("B", 4), ("C", 6)]
        driven.robot.feedback(1.0)  # too late
        assert len(driven.progress) == 2

    drive(script, Reporting)


def test_a_drive_that_fails_says_what_the_navigator_says():
    class Blocked(Robot):
        async def go(self, goal):
            await asyncio.sleep(1)
            raise OSError("a chair is in the way")

    async def script(driven):
        await asyncio.sleep(1.5)
        assert driven.told == [("Right", "running"), ("Right", "failed")]
        assert "a chair is in the way" in driven.faults[0].detail

    drive(script, Blocked)


def test_a_drive_may_take_a_time_at_most():
    async def script(driven):
        await asyncio.sleep(2)
        assert driven.told[:2] == [("Right", "running"), ("Right", "timed_out")]
        assert driven.robot.said == ["go 6", "stop"]

    drive(script, navigation={"timeout": 1.0})


@pytest.mark.parametrize("kind", [Robot, Replacing])
def test_a_goal_may_be_given_by_its_name(kind):
    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = kind(THREE, predicates, 2.0, 2.0)
        navigation = Navigation(THREE, robot, robot.places)
        ensemble = mdm.Ensemble("robot", policy=[0], actions={"GoToC": navigation.go_to("C")})
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        lives = probe(runtime.channel("robot/lives", ActionLife))
        runtime.channel("robot/action", Action).publish(Action(runtime.clock.now(), 0, 0))
        living = asyncio.create_task(robot.live())
        await asyncio.sleep(30)
        living.cancel()
        assert robot.said == ["go 10", "stop"]
        assert [life.status for life in lives] == ["running", "succeeded"]

    run_virtual(main)


def test_goals_by_name_replace_each_other_and_ways_without_a_stop():
    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = Replacing(THREE, predicates, 2.0, 2.0)
        navigation = Navigation(THREE, robot, robot.places)
        actions = {"C": navigation.go_to("C"), "A": navigation.go_to("A"), "Right": navigation.way("Right")}
        ensemble = mdm.Ensemble("robot", policy=mdm.policies.DeterministicPolicy([0], 3), actions=actions)
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.live())
        for action, seconds in ((0, 1.0), (1, 0.5), (2, 0.5)):
            runtime.channel("robot/action", Action).publish(Action(runtime.clock.now(), action, action))
            await asyncio.sleep(seconds)
        living.cancel()
        assert robot.said == ["go 10", "go 2", "go 6"]

    run_virtual(main)


def test_what_does_not_fit_is_refused():
    predicates = mdm.PredicateManager()
    robot = Robot(THREE, predicates, 2.0, 2.0)
    navigation = Navigation(THREE, robot, robot.places)
    assert list(navigation.actions(stay="Stay")) == ["Right", "Left", "Stay"]
    assert navigation.actions()["Left"].on_repeat == "restart"
    assert navigation.go_to("C").function.__qualname__ == "Navigation.go_to('C')"
    assert navigation.way("Left").function.__qualname__ == "Navigation.way('Left')"
    with refused(ConfigError):
        navigation.actions(stay="Left")
    with refused(MapError):
        navigation.go_to("D")
    with refused(ConfigError):
        navigation.way("Up")
    with refused(ConfigError):
        Navigation(THREE, robot, robot.places, prefix="In")
    with refused(ConfigError):
        Navigation(THREE, robot, predicates, prefix="In")
    with refused(ConfigError):
        Navigation(THREE, "robot", predicates)

    class Idle:
        async def go(self):
            pass

    with refused(ConfigError):
        Navigation(THREE, Idle(), predicates)
    with refused(ConfigError):
        Navigation(THREE, Robot, robot.places)

    class Yielding:
        async def go(self, goal):
            yield goal

    with refused(ConfigError):
        Navigation(THREE, Yielding(), robot.places)
    robot.replaces = "yes"
    with refused(ConfigError):
        Navigation(THREE, robot, robot.places)


@pytest.mark.parametrize("result", [None, 5.0])
def test_a_drive_that_cannot_be_awaited_fails_with_a_sentence(result):
    class Plain(Robot):
        def go(self, goal):
            return result

    async def script(driven):
        await asyncio.sleep(0.9)
        assert driven.told == [("Right", "running"), ("Right", "failed")]
        assert f"a navigator's 'go' is an async function, and this one returned {result}" in driven.faults[0].detail

    drive(script, Plain)


def test_a_plain_function_may_return_what_is_awaited():
    class Plain(Robot):
        def go(self, goal):
            return asyncio.ensure_future(super().go(goal))

    async def script(driven):
        await asyncio.sleep(60)
        assert driven.robot.said == ["go 6", "stop", "go 10", "stop"]
        assert driven.faults == []

    drive(script, Plain)


def test_an_option_of_a_drive_is_not_taken_for_its_feedback():
    class Fast(Robot):
        async def go(self, goal, speed=2.0):
            self.speed = speed
            await super().go(goal)

    class Telling(Robot):
        async def go(self, goal, feedback=None):
            feedback(1.0)
            await super().go(goal)

    async def script(driven):
        await asyncio.sleep(60)
        assert driven.robot.said == ["go 6", "stop", "go 10", "stop"]
        assert driven.robot.speed == (2.0 if isinstance(driven.robot, Fast) else 0.5)
        assert bool(driven.progress) == isinstance(driven.robot, Telling)

    drive(script, Fast)
    drive(script, Telling)


def test_feedback_from_a_thread_keeps_the_newest_and_loses_none_that_counts():
    class Chatty(Robot):
        async def go(self, goal, feedback):
            thread = threading.Thread(target=lambda: [feedback(float(left)) for left in range(5_000, -1, -1)])
            thread.start()
            thread.join()
            await super().go(goal)

    async def script(driven):
        await asyncio.sleep(1)
        assert driven.progress[-1].remaining == 0.0
        assert driven.faults == []

    drive(script, Chatty)


def test_a_way_decides_again_after_a_failure_as_its_binding_says():
    class Blocked(Robot):
        async def go(self, goal):
            await asyncio.sleep(1)
            if self.said.append("tried") or len(self.said) < 3:
                raise OSError("a chair is in the way")
            await super().go(goal)

    async def script(driven):
        await asyncio.sleep(40)
        assert driven.robot.said[:3] == ["tried"] * 3
        assert driven.robot.places.place == "C"

    drive(script, Blocked, navigation={"then": "decide", "pause": 2.0})


ROOMS = {floor: row_of_rooms("Hall", "Shaft") for floor in ("ground", "first", "roof")}
TOWER = Floors(
    ROOMS,
    (
        Lift("lift", ("ground.Shaft", "first.Shaft"), 20.0),
        Lift("stairs", ("first.Hall", "roof.Hall"), 30.0),
    ),
)


class Lifted:
    """A robot on three floors that is at once where it is told to go, and tells its poses if it has places."""

    def __init__(self, *, localised=True, at="ground.Hall"):
        self.predicates = mdm.PredicateManager()
        self.places = Places(TOWER, self.predicates, max_age=5.0)
        self.localised = localised
        self.at = TOWER.graph.node(at).goal
        self.said = []
        self.navigation = Navigation(TOWER, self, self.places)

    async def go(self, goal):
        assert goal.floor == self.at.floor
        self.said.append(f"go {goal.floor} {goal.x:g}")
        await self._be(goal)

    async def ride(self, lift, goal):
        assert goal.floor != self.at.floor
        self.said.append(f"{lift} to {goal.floor}")
        await self._be(goal)

    async def _be(self, goal):
        await asyncio.sleep(1.0)
        self.at = goal
        self.tell()

    def tell(self):
        if self.localised:
            self.places.see(self.at)

    def do(self, binding):
        """Return what it says while it does an action."""

        async def main(runtime):
            await runtime.start(self.places)
            self.tell()
            await asyncio.sleep(0.1)
            await binding(self.navigation).function()
            return self.said

        return run_virtual(main)


@pytest.mark.parametrize(
    ("at", "act", "said"),
    [
        ("ground.Hall", lambda navigation: navigation.go_to("ground.Shaft"), ["go ground 6"]),
        ("ground.Shaft", lambda navigation: navigation.way("lift to first"), ["go ground 6", "lift to first"]),
        ("ground.Hall", lambda navigation: navigation.way("Right"), ["go ground 6"]),
        (
            "ground.Hall",
            lambda navigation: navigation.go_to("roof.Shaft"),
            ["go ground 6", "lift to first", "go first 2", "stairs to roof", "go roof 6"],
        ),
        ("roof.Shaft", lambda navigation: navigation.go_to("first.Hall"), ["go roof 2", "stairs to first"]),
    ],
)
def test_a_place_on_another_floor_is_reached_by_lifts(at, act, said):
    assert Lifted(at=at).do(act) == said


def test_a_robot_that_is_up_already_drives_to_the_goal_of_a_lift_s_way():
    robot = Lifted(at="first.Hall")
    state = Action(0, 0, 0, 0)

    class Position:
        def of(self, action):
            return "ground.Shaft"

    async def main(runtime):
        await runtime.start(robot.places)
        robot.tell()
        await asyncio.sleep(0.1)
        node, heading = robot.navigation.resolve("lift to first", state, Position())
        await robot.navigation._drive(node, heading)
        return robot.said, heading.target

    assert run_virtual(main) == (["go first 6"], "first.Shaft")


def test_where_no_lift_leads_there_is_a_sentence():
    one_way = Floors({"a": THREE, "b": THREE}, (Lift("slide", ("b.A", "a.A"), 3.0, one_way=True),))
    predicates = mdm.PredicateManager()
    for name in one_way.names:
        predicates.sensor(name, initial=name == "a.B")

    class Wheels:
        async def go(self, goal):
            pass

        async def ride(self, lift, goal):
            pass

    navigation = Navigation(one_way, Wheels(), predicates)

    async def main(runtime):
        await runtime.start(predicates)
        with refused(MapError):
            await navigation.go_to("b.C").function()

    run_virtual(main)


def test_several_floors_take_a_navigator_that_rides():
    class Wheels:
        async def go(self, goal):
            pass

    predicates = mdm.PredicateManager()
    with refused(ConfigError):
        Navigation(TOWER, Wheels(), Places(TOWER, predicates))


def test_a_ride_that_is_no_async_function_is_told():
    robot = Lifted(at="ground.Shaft")
    robot.ride = lambda lift, goal: None
    with refused(Error):
        robot.do(lambda navigation: navigation.way("lift to first"))


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_a_drive_whose_last_pose_comes_after_its_end_has_succeeded(late):
    """What is decided where it has come does not pre-empt it."""
    robot = Lifted(at="ground.Shaft")
    policy = dict.fromkeys(TOWER.names, "Stay") | {"ground.Shaft": "lift to first", "first.Shaft": "Left"}
    actions = robot.navigation.actions(stay="Stay")
    ensemble = mdm.Ensemble(
        "robot",
        policy=mdm.policies.QTable([[float(label == policy[room]) for label in actions] for room in TOWER.names]),
        predicates=robot.predicates,
        states=[mdm.StateFactor("room", {room: f"{room}.reached" for room in TOWER.names})],
        actions=actions,
    )

    async def be(goal):
        await asyncio.sleep(1.0)
        robot.at = goal
        asyncio.get_running_loop().call_later(late, robot.tell)

    async def main(runtime):
        robot._be = be
        lives = probe(runtime.channel("robot/lives", ActionLife))
        await runtime.start(robot.places)
        robot.tell()
        await runtime.start(ensemble)
        await asyncio.sleep(4.9)
        return [(life.action, life.status) for life in lives][:4]

    ways = ["lift to first", "Left"]
    assert run_virtual(main) == [(way, status) for way in ways for status in ("running", "succeeded")]


# -- Ways that can be gone again --------------------------------------------------------------------------------------


class Blocked(Robot):
    """Gets nowhere for half a minute, and says so each time."""

    async def go(self, goal):
        if asyncio.get_running_loop().time() < 30.0:
            self.said.append("blocked")
            await asyncio.sleep(1.0)
            raise OSError("a chair is in the way")
        await super().go(goal)


@pytest.mark.parametrize("safe", [None, "Stay", lambda: None])
@pytest.mark.parametrize("rate", ["event", 2.0])
def test_a_robot_that_was_blocked_goes_on_when_its_way_is_free(rate, safe):
    """Nothing but the drive would change the place that is decided on: blocked once, it stood for ever."""

    async def script(driven):
        await asyncio.sleep(100)
        assert driven.robot.places.place == "C"
        assert 3 < driven.robot.said.count("blocked") < 31

    drive(script, Blocked, drive=rate, **({} if safe is None else {"safe_action": safe}))


def test_a_place_that_was_blocked_is_gone_to_again_and_one_that_is_reached_is_not():
    async def script(driven):
        await asyncio.sleep(100)
        assert (driven.robot.x, driven.robot.said.count("go 10")) == (10.0, 1)

    class Home(Driven):
        def __init__(self):
            super().__init__(Blocked)
            self.ensemble = mdm.Ensemble("robot", policy=[0], actions={"Home": self.navigation.go_to("C")})

        async def start(self, runtime):
            await super().start(runtime)
            self.ensemble.publish_state(0)
            return self

    async def main(runtime):
        driven = await Home().start(runtime)
        await script(driven)
        driven.living.cancel()

    run_virtual(main)


def test_with_wait_a_robot_that_was_blocked_waits_on_purpose():
    async def script(driven):
        await asyncio.sleep(100)
        assert driven.robot.said == ["blocked"]
        assert [fault.kind for fault in driven.faults] == ["action"]

    drive(script, Blocked, navigation={"then": "wait"})


@pytest.mark.parametrize("end", ["", ".reached"])
@pytest.mark.parametrize(("outside", "gap"), [("unknown", 0.1), ("keep", 2.0)])
@pytest.mark.parametrize("rate", ["event", 2.0])
def test_a_robot_that_starts_between_places_goes_to_the_nearest_first(rate, outside, gap, end):
    """No place was known, so that it decided nothing, and stood for ever."""
    floor = row_of_rooms("A", "B", "C", gap=gap)
    ends = [*floor.graph.edges, Edge("C", "C", "Right")]
    floor = Map(floor.labels, Graph(floor.graph.nodes, tuple(ends)))

    class Begun(Robot):
        def __init__(self, floor, predicates, x, y):
            super().__init__(floor, predicates, x, y, outside=outside)

    async def main(runtime):
        predicates = mdm.PredicateManager()
        robot = Begun(floor, predicates, 4.0 + gap / 4, 2.0)
        navigation = Navigation(floor, robot, robot.places)
        ensemble = mdm.Ensemble(
            "robot",
            policy=[0, 0, 0],
            predicates=predicates,
            states=[mdm.StateFactor("room", [f"{room}{end}" for room in "ABC"])],
            actions={"Right": navigation.way("Right")},
            drive=rate,
            safe_action=lambda: None,
        )
        headings = probe(runtime.channel("navigation/headings", Heading))
        await runtime.start(robot.places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.live())
        await asyncio.sleep(60)
        living.cancel()
        robot.goal = None
        assert robot.said[:2] == ["go 2", "stop"]
        assert headings[0].why == "Right from A, decided on, the nearest place, where it goes first"
        assert robot.x == floor.graph.node("C").goal.x

    run_virtual(main)


def test_a_way_from_nowhere_leads_to_the_nearest_place():
    """Of a robot that has left all places for long, and of which nothing that is decided on says where it is."""

    async def script(driven):
        await asyncio.sleep(0.2)
        driven.robot.x = 5.0  # between places
        await asyncio.sleep(1.0)
        assert driven.robot.places.place is None
        node, heading = driven.navigation.resolve("Right")
        assert (node.name, heading.target, heading.source) == ("A", "A", None)
        assert heading.why == "in no place: it goes to the nearest"
        driven.living.cancel()
        await asyncio.sleep(1.0)  # by now no pose counts, either
        with pytest.raises(Error, match="it is not known in which place the robot is"):
            driven.navigation.resolve("Right")

    drive(script, floor=row_of_rooms("A", "B", gap=3.0), policy={"A": "Stay", "B": "Stay"})


class Fetching(Driven):
    """A robot that fetches something from C, unless `Other` calls it home; it decides at each goal, too."""

    def __init__(self, fetch, kind=Robot, **options):
        super().__init__(kind)
        actions = {"Fetch": self.navigation.task(fetch, **options), "Home": self.navigation.go_to("A")}
        self.ensemble = mdm.Ensemble(
            "robot",
            policy=[0, 1] * 3,
            predicates=self.predicates,
            states=[
                mdm.StateFactor("at", ["A.reached", "B.reached", "C.reached"]),
                mdm.StateFactor("called", {1: "Other"}),
            ],
            actions=actions,
        )


def fetching(script, *arguments, **options):
    async def main(runtime):
        driven = await Fetching(*arguments, **options).start(runtime)
        driven.headings = probe(runtime.channel("navigation/headings", Heading))
        try:
            return await script(driven)
        finally:
            driven.living.cancel()
            driven.robot.goal = None

    return run_virtual(main)


@pytest.mark.parametrize("kind", [Robot, Replacing])
def test_an_action_drives_and_works_and_is_one_life_whatever_is_decided_on_its_way(kind):
    worked = []

    async def fetch(navigate):
        await navigate("C")
        worked.append("grips")
        await asyncio.sleep(1)
        await navigate("B")

    async def script(driven):
        with capture_decisions(driven.runtime) as decisions:
            await asyncio.sleep(30)
        assert [decision.action_name for decision in decisions] == ["Fetch"] * 3  # as A, C and B are reached
        assert driven.told == [("Fetch", "running"), ("Fetch", "succeeded")]
        assert [(heading.target, heading.why) for heading in driven.headings] == [
            ("C", "an action goes there, to work"),
            ("B", "an action goes there, to work"),
        ]
        assert (driven.robot.said, worked) == (["go 10", "stop", "go 6", "stop"], ["grips"])
        assert (driven.navigation.heading, list(driven.faults)) == (None, [])

    fetching(script, fetch, kind)


def test_an_action_that_is_called_away_on_its_way_has_ended_when_the_robot_stands():
    said = []

    async def fetch(navigate):
        try:
            await navigate("C")
        finally:
            said.append([*driven_by[0].robot.said])

    driven_by = []

    async def script(driven):
        driven_by.append(driven)
        await asyncio.sleep(3)
        assert driven.navigation.heading.target == "C"
        driven.other.set(True)
        await asyncio.sleep(10)
        assert said == [["go 10", "stop"]]
        assert driven.told == [
            ("Fetch", "running"),
            ("Fetch", "preempted"),
            ("Home", "running"),
            ("Home", "succeeded"),
        ]
        assert driven.robot.said == ["go 10", "stop", "go 2", "stop"]

    fetching(script, fetch)


def test_what_an_action_cannot_drive_to_fails_with_a_sentence_and_is_decided_again():
    tries = []

    async def fetch(navigate):
        tries.append(None)
        if len(tries) == 1:
            await navigate("D")
        first = asyncio.create_task(navigate("C"))
        await asyncio.sleep(1)
        try:
            await (navigate("B") if len(tries) == 2 else first)
        finally:
            first.cancel()
            await asyncio.wait([first])

    async def script(driven):
        await asyncio.sleep(40)
        details = [life.detail for life in driven.lives if life.status == "failed"]
        assert len(details) == 2
        assert "there is no place 'D'" in details[0]
        assert "the robot cannot go to 'B' yet: its drive to 'C' has not ended" in details[1]
        assert driven.told[-1] == ("Fetch", "succeeded")

    fetching(script, fetch)


def test_a_task_that_could_not_drive_is_refused():
    async def stand():
        pass

    with refused(ConfigError):
        Driven().navigation.task(stand)
