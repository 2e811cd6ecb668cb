"""Places: rooms with hysteresis, goals, unknown, and one update a change; in virtual time."""

from __future__ import annotations

import asyncio
import math
import threading

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from rows_of_rooms import row_of_rooms
from sentences import refused

import mdm
from mdm.errors import ConfigError, Error, MapError
from mdm.maps import Floors, Frame, Graph, Grid, Labels, Lift, Map, Node, Places, Pose
from mdm.messages import Journey, PoseUpdate
from mdm.testing import crash, probe, run_virtual

TWO = row_of_rooms("Hall", "Kitchen")


class Watched:
    """Places that run, with all that they tell."""

    def __init__(self, floor=TWO, **options):
        self.predicates = mdm.PredicateManager()
        self.places = Places(floor, self.predicates, **options)

    async def start(self, runtime):
        await runtime.start(self.places)
        self.sensed = probe(self.predicates.sensed)
        self.raised = probe(self.predicates.events)
        self.faults = probe(runtime.faults)
        return self

    def see(self, x, y=2.0, **options):
        self.places.see(Pose(x, y), **options)

    @property
    def values(self):
        return {name: value for name, value in self.predicates.values().items() if "." not in name}

    @property
    def events(self):
        return [event for update in self.raised for event in update.events]


def watch(script, *arguments, **options):
    async def main(runtime):
        return await script(await Watched(*arguments, **options).start(runtime))

    return run_virtual(main)


def test_a_robot_is_in_one_room_and_in_no_other():
    async def script(watched):
        assert watched.values == {"Hall": None, "Kitchen": None}
        assert watched.places.place is None
        watched.see(1)
        assert watched.values == {"Hall": True, "Kitchen": False}
        watched.see(7)
        assert watched.values == {"Hall": False, "Kitchen": True}
        assert watched.places.place == "Kitchen"
        assert watched.events == ["Hall.entered", "Hall.left", "Kitchen.entered"]

    watch(script)


def test_what_a_pose_changes_is_one_update_and_what_it_does_not_change_is_none():
    async def script(watched):
        watched.see(1)
        watched.see(1.1)
        watched.see(3.9)
        watched.see(6.0)
        assert [len(update.predicates) for update in watched.sensed] == [6, 5]
        assert watched.sensed[1].events == ("Hall.left", "Kitchen.entered", "Kitchen.arrived")
        assert watched.sensed[1].predicates == (
            *(("Hall", False), ("Kitchen", True)),
            *(("Hall.reached", False), ("Kitchen.at_goal", True), ("Kitchen.reached", True)),
        )

    watch(script)


def test_the_goal_that_was_reached_last_stays_so_until_another_is():
    async def script(watched):
        def reached():
            return [watched.predicates.value(f"{name}.reached") for name in ("Hall", "Kitchen")]

        assert reached() == [None, None]
        watched.see(4.1)
        assert reached() == [False, True]  # it has not been at a goal yet: the place where it is counts
        for x, want in ((2.0, [True, False]), (3.9, [True, False]), (6.0, [False, True]), (4.1, [False, True])):
            watched.see(x)
            assert reached() == want
        await asyncio.sleep(1.0)
        assert reached() == [None, None]  # no pose came
        watched.see(4.1)
        assert reached() == [False, True]

    watch(script)


@pytest.mark.parametrize("seed", range(10))
def test_a_robot_parked_on_a_border_changes_room_at_most_five_times_a_minute(seed):
    async def script(watched):
        random = np.random.default_rng(seed)
        for _ in range(600):
            watched.see(4.0 + random.normal(scale=0.1))
            await asyncio.sleep(0.1)
        return len([event for event in watched.events if event.endswith(".left")])

    assert watch(script) <= 5


@pytest.mark.parametrize("seed", range(20))
def test_a_robot_through_a_door_changes_room_once(seed):
    async def script(watched):
        random = np.random.default_rng(seed)
        for x in np.arange(2.5, 5.5, 0.03):  # 0.3 m/s at 10 Hz
            watched.see(x + random.normal(scale=0.1))
            await asyncio.sleep(0.1)
        assert [event for event in watched.events if event.endswith((".left", ".entered"))] == [
            "Hall.entered",
            "Hall.left",
            "Kitchen.entered",
        ]

    watch(script)


def test_a_first_pose_counts_wherever_it_is():
    async def script(watched):
        watched.see(4.01)
        assert watched.values == {"Hall": False, "Kitchen": True}

    watch(script)


def test_rooms_are_unknown_half_a_second_after_the_poses_stop_and_known_again_with_the_next():
    async def script(watched):
        for _ in range(10):
            watched.see(1)
            await asyncio.sleep(0.1)  # the last pose was at 0.9 s
        await asyncio.sleep(0.399)
        assert watched.values == {"Hall": True, "Kitchen": False}
        await asyncio.sleep(0.002)
        assert watched.values == {"Hall": None, "Kitchen": None}
        assert [fault.kind for fault in watched.faults] == ["stale"]
        assert "there was no pose for 0.5 s" in watched.faults[0].detail
        watched.see(4.01)  # in the margin
        assert watched.values == {"Hall": False, "Kitchen": True}
        assert watched.events == ["Hall.entered", "Hall.left", "Kitchen.entered"]

    watch(script)


def test_the_age_of_a_pose_is_that_of_its_stamp():
    async def script(watched):
        clock = watched.places.runtime.clock
        await asyncio.sleep(10)
        watched.see(1, stamp=clock.time() - 0.3)
        await asyncio.sleep(0.19)
        assert watched.values["Hall"] is True
        await asyncio.sleep(0.02)
        assert watched.values["Hall"] is None
        watched.see(1, stamp=clock.time() - 0.5)
        assert watched.values["Hall"] is None
        watched.see(1, stamp=clock.time() + 100)  # another's clock: no pose is from the future
        watched.see(7, stamp=clock.time() - 0.1)  # older than the last one
        assert watched.values["Hall"] is True
        assert watched.places.late == 2
        for stamp in ("now", math.nan, math.inf):
            with refused(Error):
                watched.see(1, stamp=stamp)

    watch(script)


def test_poses_that_all_come_too_late_are_told_as_such_once():
    async def script(watched):
        await asyncio.sleep(10)
        for _ in range(50):
            watched.see(1, stamp=watched.places.runtime.clock.time() - 0.7)
            await asyncio.sleep(0.1)
        assert watched.values["Hall"] is None
        assert [fault.kind for fault in watched.faults] == ["late"]
        assert "a pose is 0.7 s old, and none counts that is 0.5 s old" in watched.faults[0].detail
        watched.see(1)
        watched.see(1, stamp=watched.places.runtime.clock.time() - 0.7)  # out of order: nothing is wrong
        assert len(watched.faults) == 1

    watch(script)


@pytest.mark.parametrize("far", [1e200, -1e308])
def test_a_pose_far_away_is_outside_of_all_places(far):
    async def script(watched):
        watched.see(2)
        watched.see(far, far)
        assert watched.predicates.value("Hall.at_goal") is False
        watched.see(2)
        assert watched.predicates.value("Hall.at_goal") is True

    watch(script)


@pytest.mark.parametrize("pose", [None, (1.0, 2.0), Pose("here", 2.0), Pose(1.0, None), Pose(10**400, 0.0)])
def test_a_pose_that_is_none_is_refused(pose):
    async def script(watched):
        with refused(Error):
            watched.places.see(pose)

    watch(script)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("part", ["x", "y", "yaw"])
def test_a_pose_that_is_not_finite_leaves_all_unknown_and_is_told_once(part, bad):
    async def script(watched):
        watched.see(2)
        assert watched.predicates.value("Hall.at_goal") is True
        for _ in range(50):
            watched.places.see(Pose(**{"x": 2.0, "y": 2.0, part: bad}))
            assert set(watched.predicates.values().values()) == {None}
            await asyncio.sleep(0.1)
        assert [fault.kind for fault in watched.faults] == ["pose"]
        assert f"{part} = {bad}" in watched.faults[0].detail
        watched.see(2)
        assert watched.values["Hall"] is True
        assert watched.events == ["Hall.entered", "Hall.arrived"]  # it was there all the time

    watch(script)


def test_a_cell_of_no_place_is_of_the_last_one_for_a_while():
    async def script(watched):
        watched.see(1)
        for _ in range(4):
            await asyncio.sleep(0.1)
            watched.see(4.5)  # in the gap
            assert watched.values == {"Hall": True, "Kitchen": False}
        await asyncio.sleep(0.2)
        assert watched.values == {"Hall": None, "Kitchen": None}
        assert watched.predicates.value("Hall.at_goal") is False  # where the robot is, is known
        assert "outside of all places for 0.5 s" in watched.faults[0].detail
        watched.see(4.5)
        assert watched.values == {"Hall": None, "Kitchen": None}
        watched.see(5.1)
        assert watched.values == {"Hall": False, "Kitchen": True}

    watch(script, row_of_rooms("Hall", "Kitchen", gap=1.0))


def test_between_islands_the_last_place_may_be_kept():
    async def script(watched):
        watched.see(1)
        for _ in range(100):
            await asyncio.sleep(0.1)
            watched.see(4.5)
        assert watched.values == {"Hall": True, "Kitchen": False}
        await asyncio.sleep(0.6)
        assert watched.values == {"Hall": None, "Kitchen": None}

    watch(script, row_of_rooms("Hall", "Kitchen", gap=1.0), outside="keep")


@pytest.mark.parametrize("outside", ["unknown", "keep"])
def test_a_first_pose_between_places_is_of_the_nearest_until_one_is_entered(outside):
    async def script(watched):
        for _ in range(20):  # for longer than the max_age
            watched.see(4.6)
            await asyncio.sleep(0.1)
            assert watched.values == {"Hall": False, "Kitchen": True}
        assert (watched.places.between, watched.events) == ("Kitchen", [])
        watched.see(3.9)  # in the margin of another place than the nearest
        assert watched.values == {"Hall": True, "Kitchen": False}
        assert (watched.places.between, watched.events) == (None, ["Hall.entered"])
        watched.see(4.6)
        await asyncio.sleep(0.6)  # all is unknown, and the robot between places: as at first
        watched.see(4.6)
        assert (watched.values, watched.places.between) == ({"Hall": False, "Kitchen": True}, "Kitchen")
        watched.see(5.1)
        assert (watched.places.between, watched.events) == (None, ["Hall.entered", "Hall.left", "Kitchen.entered"])

    watch(script, row_of_rooms("Hall", "Kitchen", gap=1.0), outside=outside)


def test_a_first_pose_off_the_map_is_of_no_place():
    async def script(watched):
        watched.see(4.6, 40.0)
        assert watched.values == {"Hall": None, "Kitchen": None}
        watched.see(4.6)  # by now a pose counts
        assert watched.values == {"Hall": None, "Kitchen": None}

    watch(script, row_of_rooms("Hall", "Kitchen", gap=1.0))


def test_the_nearest_place_is_that_by_path():
    """Of a robot in a corridor behind a wall the near goal takes the longer way; in a wall there is none at all."""
    labels = np.zeros((40, 120), dtype=np.uint16)
    labels[:15, :50], labels[:15, 70:] = 1, 2
    free = np.ones((40, 120), dtype=bool)
    free[20, 10:] = False  # the wall, with a door at the far left
    frame = Frame(40, 120, 0.1)
    nodes = (Node("Near", Pose(7.5, 3.5)), Node("Far", Pose(1.0, 3.5)))
    floor = Map(Labels(frame, labels, ("Far", "Near")), Graph(nodes, ()), Grid(frame, free, ~free))

    async def script(watched):
        watched.see(7.5, 1.0)
        assert (watched.places.place, watched.places.nearest()) == ("Far", "Far")
        await asyncio.sleep(1.0)
        watched.see(7.5, 1.95)
        assert watched.places.place is None

    watch(script, floor)


def test_a_goal_is_left_farther_away_than_it_is_reached():
    async def script(watched):
        at = {}
        for x in (1.0, 1.65, 1.75, 1.65, 1.35, 1.45, 1.75):
            watched.see(x)
            at.setdefault(x, []).append(watched.predicates.value("Hall.at_goal"))
        assert at == {1.0: [False], 1.65: [False, True], 1.75: [True, True], 1.35: [False], 1.45: [False]}
        assert watched.events.count("Hall.arrived") == 2

    watch(script)


def test_a_goal_is_not_reached_by_its_margin_after_all_was_unknown():
    async def script(watched):
        watched.see(2)
        await asyncio.sleep(1.0)
        watched.see(2.5)
        assert watched.predicates.value("Hall.at_goal") is False
        assert watched.predicates.value("Hall.reached") is True

    watch(script)


def test_of_goals_within_reach_of_each_other_the_last_one_is_reached():
    nodes = (Node("Hall", Pose(3.9, 2)), Node("Kitchen", Pose(4.3, 2)))

    async def script(watched):
        for x, last in ((3.5, "Hall"), (3.8, "Hall"), (4.1, "Kitchen"), (4.05, "Kitchen")):
            watched.see(x)
            reached = [name for name in ("Hall", "Kitchen") if watched.predicates.value(f"{name}.reached")]
            assert reached == [last]
        assert watched.predicates.value("Hall.at_goal") is True
        assert watched.predicates.value("Kitchen.at_goal") is True

    watch(script, Map(TWO.labels, Graph(nodes, ())))


def test_the_graph_may_say_how_near_is_there():
    node = Node("Hall", Pose(2, 2), tolerance=1.0)
    floor = Map(Labels(TWO.labels.frame, TWO.labels.raster * 0 + 1, ("Hall",)), Graph((node,), ()))

    async def script(watched):
        watched.see(1.1)
        assert watched.predicates.value("Hall.at_goal") is True

    watch(script, floor)


def test_a_tolerance_may_be_beyond_all_floors():
    async def script(watched):
        watched.see(7)
        assert watched.predicates.value("Hall.at_goal") is True

    watch(script, tolerance=1e300)


def test_labels_alone_have_rooms_and_no_goals():
    async def script(watched):
        watched.see(1)
        assert watched.predicates.values() == {"Hall": True, "Kitchen": False}

    watch(script, TWO.labels)


def test_names_may_have_a_prefix():
    async def script(watched):
        watched.see(2)
        assert watched.predicates.value("IsInHall") is True
        assert watched.predicates.value("IsInHall.at_goal") is True
        assert watched.events == ["IsInHall.entered", "IsInHall.arrived"]
        assert watched.places.place == "Hall"

    watch(script, prefix="IsIn")


def test_names_stand_in_formulas():
    predicates = mdm.PredicateManager()
    Places(row_of_rooms("Soccer field", "Hall"), predicates)
    predicates.define("Out", '"Soccer field" and not Hall.at_goal')
    predicates.latch("Played", set='"Soccer field.entered"', reset="Hall.arrived")
    assert predicates.network().compile() is not None


@pytest.mark.parametrize(
    ("name", "words"), [("up/down", "another agent's predicate"), ("Up.failed", "the end of an action")]
)
def test_a_name_that_reads_as_something_else_is_refused(name, words):
    with refused(ConfigError):
        Places(row_of_rooms(name, "Hall"), mdm.PredicateManager())


def test_a_name_that_is_taken_is_refused():
    predicates = mdm.PredicateManager()
    predicates.sensor("Hall")
    with refused(ConfigError):
        Places(TWO, predicates)


def test_a_place_that_could_not_be_entered_is_refused():
    floor = row_of_rooms("Hall", "Closet", "Kitchen", width=0.5)
    with refused(MapError):
        Places(floor, mdm.PredicateManager())
    assert Places(floor, mdm.PredicateManager(), margin=0.2).labels is floor.labels
    frame = Frame(1, 1, 1.0)
    with refused(MapError):
        Places(Labels(frame, np.array([[1]], dtype=np.uint16), ("a", "b")), mdm.PredicateManager())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"margin": -0.1}, "margin: a finite number of metres of at least 0 was expected, not -0.1"),
        ({"margin": math.nan}, "margin: a finite number of metres of at least 0 was expected, not nan"),
        ({"tolerance": "1"}, "tolerance: a finite number of metres of at least 0 was expected, not '1'"),
        ({"max_age": 0}, "max_age: a number of seconds above 0 and at most 1,000,000,000 was expected"),
        ({"outside": "forget"}, "outside"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        Places(TWO, mdm.PredicateManager(), **options)


def test_poses_come_on_the_channel_too():
    async def script(watched):
        runtime = watched.places.runtime
        runtime.channel("places/pose", PoseUpdate).publish(PoseUpdate(runtime.clock.now(), 1.0, 1.0))
        assert watched.values["Hall"] is True

    watch(script)


def test_poses_come_from_any_thread():
    async def main():
        async with mdm.Runtime(log=None) as runtime:
            watched = await Watched(max_age=60.0).start(runtime)
            thread = threading.Thread(target=watched.see, args=(7.0,))
            thread.start()
            while watched.values["Kitchen"] is None:
                await asyncio.sleep(0.001)
            thread.join()

    mdm.run(main)


def test_of_a_flood_of_poses_the_newest_counts_and_none_is_lost_that_does():
    async def script(watched):
        def flood():
            for index in range(5_000):
                watched.see(2.0 if index % 2 else 6.0)
            watched.see(2.0)

        thread = threading.Thread(target=flood)
        thread.start()
        thread.join()
        await asyncio.sleep(0.01)
        assert watched.values == {"Hall": True, "Kitchen": False}
        assert watched.faults == []

    watch(script)


def test_a_pose_before_the_start_is_refused():
    with refused(Error):
        Places(TWO, mdm.PredicateManager()).see(Pose(1, 1))


def test_all_is_unknown_when_it_has_failed_and_told_anew_after_its_restart():
    async def script(watched):
        watched.see(2)
        crash(watched.places)
        assert set(watched.predicates.values().values()) == {None}
        await asyncio.sleep(0.2)
        watched.see(2)
        assert watched.values["Hall"] is True
        assert watched.predicates.value("Hall.at_goal") is True

    watch(script, supervision=mdm.Restart(3))


def test_all_is_unknown_when_it_is_stopped_and_told_anew_when_it_is_started_again():
    async def main(runtime):
        watched = Watched()
        await runtime.start(watched.predicates)
        await watched.start(runtime)
        watched.see(2)
        await runtime.stop(watched.places)
        assert set(watched.predicates.values().values()) == {None}
        watched.see(7)  # whoever localises the robot need not know
        assert watched.places.place is None
        await runtime.start(watched.places)
        assert set(watched.predicates.values().values()) == {None}
        watched.see(2)
        assert watched.values == {"Hall": True, "Kitchen": False}
        assert watched.events == ["Hall.entered", "Hall.arrived"] * 2

    run_virtual(main)


def test_all_is_told_anew_after_a_restart_of_the_predicate_manager():
    async def main(runtime):
        predicates = mdm.PredicateManager(supervision=mdm.Restart(3))
        places = Places(TWO, predicates)
        await runtime.start(predicates)
        await runtime.start(places)
        places.see(Pose(2, 2))
        crash(predicates)
        await asyncio.sleep(0.2)
        assert predicates.value("Hall") is None
        places.see(Pose(2, 2))
        assert predicates.values() == {
            "Hall": True,
            "Kitchen": False,
            "Hall.at_goal": True,
            "Hall.reached": True,
            "Kitchen.at_goal": False,
            "Kitchen.reached": False,
        }

    run_virtual(main)


def test_a_lost_pose_is_input_that_is_too_old():
    """A cause of the safe mode, with its way back, as of any sensor with a `max_age`."""
    predicates = mdm.PredicateManager()
    places = Places(TWO, predicates)
    robot = mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("room", {"Hall": "Hall", "Kitchen": "Kitchen"})],
        actions={"Go": lambda: None, "Come": lambda: None},
        safe_action=lambda: None,
    )
    assert predicates.declared.definition("Hall") == "told by the robot's pose on the map, unknown after 0.5 s"

    async def main(runtime):
        await runtime.start(places)
        await runtime.start(robot)
        places.see(Pose(1, 1))
        await asyncio.sleep(0.4)
        assert robot.mode == "deciding"
        await asyncio.sleep(0.2)
        assert robot.mode == "safe"
        assert [cause.kind for cause in robot.causes] == ["stale_input"]
        places.see(Pose(1, 1))
        await asyncio.sleep(0.1)
        assert robot.mode == "deciding"

    run_virtual(main)


class Plain:
    """The same rules as plainly as can be: no raster of codes, no timers, no differences."""

    def __init__(self, floor, margin, max_age):
        self.labels, self.margin, self.max_age = floor.labels, margin, max_age
        self.goals = {node.name: node.goal for node in floor.graph.nodes}
        self.room, self.placed, self.seen, self.between, self.located = None, -math.inf, -math.inf, False, False

    def pass_to(self, time):
        if time >= self.seen + self.max_age:
            self.room, self.located, self.between = None, False, False
        if time >= self.placed + self.max_age:
            self.room = None

    def see(self, time, x, y):
        self.pass_to(time)
        if not (math.isfinite(x) and math.isfinite(y)):
            self.room, self.located, self.between = None, False, False
            return
        self.seen, first, self.located = time, not self.located, True
        name = self.labels.name(x, y)
        if name is None and first and self.labels.frame.cell(x, y) is not None:
            self.room = min(self.goals, key=lambda room: math.hypot(self.goals[room].x - x, self.goals[room].y - y))
            self.between = True
        if name is not None or self.between:
            self.placed = time
        if name is None:
            return
        enters, self.between = self.room is None or self.between, False
        if enters or self.labels.depth[self.labels.frame.cell(x, y)] - 0.025 >= self.margin - 1e-9:
            self.room = name


STEPS = st.lists(
    st.tuples(
        st.sampled_from([0.1, 0.2, 0.45, 0.6]),
        st.floats(-0.5, 6.5) | st.floats(1.7, 2.3) | st.just(math.nan),
        st.floats(-0.2, 2.2),
    ),
    max_size=25,
)


@settings(max_examples=60, deadline=None)
@given(STEPS, st.sampled_from([0.0, 0.3, 0.6]), st.sampled_from([0.0, 0.2]))
def test_rooms_are_those_of_a_plain_recomputation(steps, margin, gap):
    floor = row_of_rooms("a", "b", "c", width=2.0, height=2.0, gap=gap)
    plain = Plain(floor, margin, 0.5)

    async def script(watched):
        time = 0.0
        for pause, x, y in steps:
            await asyncio.sleep(pause)
            time += pause
            watched.see(x, y)
            plain.see(time, x, y)
            assert watched.places.place == plain.room
            assert watched.values == {name: None if plain.room is None else name == plain.room for name in "abc"}
        await asyncio.sleep(0.501)
        assert watched.places.place is None

    watch(script, floor, margin=margin, max_age=0.5)


def test_nobody_is_told_of_faults_where_there_are_none():
    async def script(watched):
        for x in np.arange(0.1, 7.9, 0.1):
            watched.see(x)
            await asyncio.sleep(0.1)
        assert watched.faults == []

    watch(script)


def test_a_tour_tells_which_place_is_next():
    """Of those in the tour one at a time, from the first pose on, and anew after the last."""
    floor = row_of_rooms("A", "B", "C", "D")

    def following(watched):
        values = watched.predicates.values()
        return {name for name in "ABCD" if values.get(f"{name}.next")}

    async def script(watched):
        assert "B.next" not in watched.predicates.values()
        assert watched.predicates.values()["A.next"] is None
        watched.see(6.0)  # in B, of which the tour knows nothing
        assert following(watched) == {"A"}
        for x, expected in ((14.0, "A"), (2.0, "D"), (10.0, "D"), (14.0, "C"), (6.0, "C"), (10.0, "A"), (2.0, "D")):
            watched.see(x)
            assert following(watched) == {expected}, x
        await asyncio.sleep(1)
        assert watched.predicates.values()["D.next"] is None  # as all else
        watched.see(6.0)
        assert following(watched) == {"D"}

    watch(script, floor, tour=["A", "D", "C"])


@pytest.mark.parametrize(
    ("tour", "words"),
    [
        (["Hall"], "a tour takes two places or more, each of them once, not Hall"),
        (["Hall", "Kitchen", "Hall"], "a tour takes two places or more, each of them once"),
        (["Hall", "Attic"], "the tour comes to 'Attic', and there are goals in Hall, Kitchen"),
    ],
)
def test_tours_that_cannot_be_are_refused(tour, words):
    with pytest.raises(ConfigError, match=words):
        Places(TWO, mdm.PredicateManager(), tour=tour)


BUILDING = Floors(
    {"ground": TWO, "upper": row_of_rooms("Hall", "Loft")}, (Lift("lift", ("ground.Hall", "upper.Hall"), 10.0),)
)


def test_a_pose_counts_on_its_own_floor():
    async def script(watched):
        places = watched.places
        see = places.see
        see(Pose(2.0, 2.0, floor="ground"))
        await asyncio.sleep(0.1)
        assert (places.place, places.pose) == ("ground.Hall", Pose(2.0, 2.0, floor="ground"))
        see(Pose(2.0, 2.0, floor="upper"))
        await asyncio.sleep(0.1)
        assert places.place == "upper.Hall"
        assert places.labels.name(6.0, 2.0) == "upper.Loft"
        # On another floor no margin keeps it in the place of the last one, though it is near a border.
        see(Pose(4.1, 2.0, floor="ground"))
        await asyncio.sleep(0.1)
        assert places.place == "ground.Kitchen"
        assert watched.events == [
            "ground.Hall.entered",
            "ground.Hall.arrived",
            "ground.Hall.left",
            "upper.Hall.entered",
            "upper.Hall.arrived",
            "upper.Hall.left",
            "ground.Kitchen.entered",
        ]
        reached = [name for name, value in watched.predicates.values().items() if name.endswith("reached") and value]
        assert reached == ["upper.Hall.reached"]
        assert watched.faults == []

    watch(script, BUILDING)


def test_of_all_floors_it_is_in_one_place():
    async def script(watched):
        for floor, x in (("ground", 2.0), ("upper", 6.0), ("upper", 2.0), ("ground", 6.0), ("upper", 6.0)):
            watched.places.see(Pose(x, 2.0, floor=floor))
            await asyncio.sleep(0.05)
            values = watched.predicates.values()
            own = f"{floor}.{BUILDING.maps[floor].labels.name(x, 2.0)}"
            for end in ("", ".at_goal", ".reached"):
                assert [name for name in BUILDING.names if values[f"{name}{end}"]] == [own]

    watch(script, BUILDING)


@pytest.mark.parametrize(
    ("floor", "given", "words"),
    [
        (BUILDING, "", "a pose is on the floor '', which there is not (there are ground, upper): places are unknown"),
        (BUILDING, "cellar", "a pose is on the floor 'cellar', which there is not (there are ground, upper)"),
        (TWO, "upper", "a pose is on the floor 'upper', which there is not (the map is of one floor without a name)"),
    ],
)
def test_a_floor_that_there_is_not_is_told(floor, given, words):
    async def script(watched):
        watched.places.see(Pose(2.0, 2.0, floor=given))
        await asyncio.sleep(0.1)
        assert [fault.detail.startswith(words) for fault in watched.faults] == [True]
        assert watched.places.place is None

    watch(script, floor)


def test_the_nearest_goal_is_one_of_the_floor():
    async def script(watched):
        watched.places.see(Pose(9.0, 2.0, floor="upper"))  # in no place
        await asyncio.sleep(0.1)
        assert watched.predicates.value("upper.Loft.reached")

    watch(script, BUILDING)


def test_a_place_too_shallow_is_told_of_its_floor():
    shallow = {"ground": TWO, "upper": row_of_rooms("Hall", "Slot", "Loft", width=0.4)}
    with refused(MapError):
        Places(Floors(shallow), mdm.PredicateManager())


def test_drives_are_heard_on_a_channel_and_count_from_there():
    async def script(watched):
        places = watched.places
        journeys = probe(places.channel("journeys", Journey))
        watched.see(0.5)
        places.set_out("Kitchen")
        await asyncio.sleep(1)
        places.set_out(None)
        return [(journey.time, journey.place, journey.arrived) for journey in journeys]

    assert watch(script, max_age=10.0) == [(0, "Kitchen", False), (1_000_000_000, None, False)]
