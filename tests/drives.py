"""Navigators that tests of maps share: a robot that drives straight to its goals in virtual time, and tells all."""

from __future__ import annotations

import asyncio
import math

import mdm
from mdm.maps import Places, Pose

STEP = 0.1


class Robot:
    """Drives straight on, and tells its pose to places ten times a second, whether it drives or not."""

    def __init__(self, floor, predicates, x, y, *, speed=0.5, **options):
        self.places = Places(floor, predicates, **options)
        self.x, self.y, self.speed = x, y, speed
        self.goal = None
        self.said = []

    async def live(self):
        while True:
            if self.goal is not None:
                self._drive()
            self.places.see(Pose(self.x, self.y))
            await asyncio.sleep(STEP)

    @property
    def remaining(self):
        return math.hypot(self.goal.x - self.x, self.goal.y - self.y)

    def _drive(self):
        left, step = self.remaining, self.speed * STEP
        if left <= step:
            self.x, self.y = self.goal.x, self.goal.y
        else:
            self.x += (self.goal.x - self.x) * step / left
            self.y += (self.goal.y - self.y) * step / left

    async def go(self, goal):
        """Stop when the goal is reached, or another way to end comes."""
        self.said.append(f"go {goal.x:g}")
        self.goal = goal
        try:
            while self.goal is goal and self.remaining > 0:
                await asyncio.sleep(STEP)
        finally:
            if self.goal is goal:  # else a newer one has it
                self.goal = None
                self.said.append("stop")


class Replacing(Robot):
    """Goes on to a new goal without a stop."""

    replaces = True


class Reporting(Robot):
    """Tells how far it is, once."""

    async def go(self, goal, feedback):
        feedback(math.hypot(goal.x - self.x, goal.y - self.y))
        self.feedback = feedback
        await super().go(goal)


def patroller(navigation, policy, predicates, limits, **options):
    """Return an ensemble whose state is the room, and whose actions are the ways of the map."""
    actions = navigation.actions(stay="Stay", **limits)
    rooms = list(navigation.graph.names)
    return mdm.Ensemble(
        "robot",
        policy=mdm.policies.QTable([[float(label == policy[room]) for label in actions] for room in rooms]),
        predicates=predicates,
        states=[mdm.StateFactor("room", {room: room for room in rooms})],
        actions=actions,
        **options,
    )
