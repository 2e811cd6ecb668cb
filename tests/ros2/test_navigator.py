"""The navigator over ``NavigateToPose``, below the navigation of a map, over a wire in plain Python."""

from __future__ import annotations

import asyncio
import math

import pytest
from drives import patroller
from ros2.stand_in import Server, StandIn
from rows_of_rooms import row_of_rooms

import mdm
from mdm.maps import Navigation, Places, Pose
from mdm.messages import ActionLife, Progress
from mdm.ros2.actions import Actions
from mdm.ros2.navigator import GoalNavigator, NavigatorTable
from mdm.ros2.wire import WireError
from mdm.testing import probe, run_virtual

FLOOR = row_of_rooms("A", "B", "C")
STEP, SPEED = 0.1, 0.5


class Base:
    """A robot behind a server that takes a new goal without a stop: it drives straight to the newest goal's pose."""

    def __init__(self, wire, places):
        self.server = Server(wire, "/navigate_to_pose", replaces=True, answers=0.05, brakes=0.4)
        self.places = places
        self.x, self.y = 2.0, 2.0
        self.stands = 0.0

    async def live(self):
        while True:
            moved = False
            for goal in self.server.live:
                position = goal.message.pose.pose.position
                left = math.hypot(position.x - self.x, position.y - self.y)
                step = min(SPEED * STEP, left)
                if left:
                    self.x += (position.x - self.x) * step / left
                    self.y += (position.y - self.y) * step / left
                moved = True
                goal.feed(distance_remaining=left - step)
                if left <= step:
                    goal.end(4)
            self.stands += 0 if moved else STEP
            self.places.see(Pose(self.x, self.y))
            await asyncio.sleep(STEP)


def drive(policy, scenario, silence=None):
    async def main(runtime):
        wire = StandIn()
        actions = Actions(wire)
        predicates = mdm.PredicateManager()
        places = Places(FLOOR, predicates)
        navigator = GoalNavigator(actions, NavigatorTable(silence=silence, behavior_tree="tree.xml"))
        navigation = Navigation(FLOOR, navigator, places)
        base = Base(wire, places)
        base.robot = patroller(navigation, policy, predicates, {})
        base.lives = probe(runtime.channel("robot/lives", ActionLife))
        base.progress = probe(runtime.channel("navigation/progress", Progress))
        base.faults = probe(runtime.faults)
        base.navigation = navigation
        await wire.open(runtime)
        await actions.open(runtime)
        await runtime.start(places)
        await runtime.start(base.robot)
        living = asyncio.create_task(base.live())
        try:
            await scenario(base)
        finally:
            living.cancel()
            await actions.close()

    run_virtual(main, log=False)


def test_a_robot_drives_on_from_goal_to_goal_without_a_stop():
    async def scenario(base):
        await asyncio.sleep(60)
        goals = base.server.goals
        assert [(goal.message.pose.pose.position.x, goal.status, goal.cancels) for goal in goals[:-1]] == [(6.0, 6, 0)]
        assert (goals[-1].message.pose.pose.position.x, goals[-1].status) == (10.0, 5)
        assert goals[0].message.pose.header.frame_id == "map"
        assert goals[0].message.behavior_tree == "tree.xml"
        assert [(life.action, life.status) for life in base.lives] == [
            ("Right", "running"),
            ("Right", "preempted"),
            ("Right", "running"),
            ("Right", "preempted"),
            ("Stay", "running"),
            ("Stay", "succeeded"),
        ]
        assert {each.place for each in base.progress} == {"B", "C"}
        assert base.faults == []

    drive({"A": "Right", "B": "Right", "C": "Stay"}, scenario)


def test_of_a_group_two_goals_are_open_for_a_moment_and_one_drives():
    most = []

    async def scenario(base):
        for _ in range(400):
            most.append(len(base.server.live))
            await asyncio.sleep(0.05)
        assert max(most) == 1  # by the server's own count: it aborts the old goal in the step that accepts the new one
        assert base.server.most == 1

    drive({"A": "Right", "B": "Right", "C": "Stay"}, scenario)


def test_a_drive_that_arrives_while_it_is_cancelled_goes_no_further():
    async def main(runtime):
        wire = StandIn()
        actions = Actions(wire)
        navigator = GoalNavigator(actions)
        server = Server(wire, "/navigate_to_pose", cancelled=4, brakes=0.5)
        await actions.open(runtime)
        went = []

        async def legs():
            for x in (1.0, 2.0):
                await navigator.go(Pose(x, 0.0, math.pi / 2), went.append)

        task = asyncio.create_task(legs())
        await asyncio.sleep(1)
        orientation = server.goals[0].message.pose.pose.orientation
        assert (orientation.z, orientation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
        server.goals[0].feed(distance_remaining=3.0)
        server.goals[0].feed(number_of_recoveries=1)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        assert (went, [goal.status for goal in server.goals]) == ([3.0], [4])
        await actions.close()

    run_virtual(main)


def test_a_silent_server_has_the_drive_fail():
    async def scenario(base):
        await asyncio.sleep(2)
        base.server.hold()
        await asyncio.sleep(1.6)
        assert [(life.action, life.status) for life in base.lives][:2] == [("Right", "running"), ("Right", "failed")]
        assert "/navigate_to_pose told nothing for 1.5 s" in base.lives[1].detail

    drive({"A": "Right", "B": "Right", "C": "Stay"}, scenario, silence=1.5)


def test_a_type_without_a_pose_is_refused():
    with pytest.raises(WireError):
        GoalNavigator(Actions(StandIn()), NavigatorTable(type="nav2_msgs/action/DockRobot"))
