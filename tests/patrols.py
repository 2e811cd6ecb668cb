"""Patrols of random floors, with all that disturbs them; what is checked is that the robot goes on.

A robot that knows the floor drives from room to room at 10 Hz of virtual time, on straight lines through doors. It is
pushed aside, stopped and started, loses its poses, starts anywhere, and finds goals blocked. The whole of Places,
Navigation and an ensemble drives it, with decisions at a rate or by events, on `reached` or on the places themselves.

``python -m patrols 2000`` runs that many, and says which did not go on.
"""

from __future__ import annotations

import asyncio
import math
import sys
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

import mdm
from mdm.maps import Edge, Frame, Graph, Labels, Map, Navigation, Node, Places, Pose
from mdm.testing import run_virtual

STEP = 0.2
PATIENCE = 4.0
"""Seconds for which the robot waits before a blocked goal until its drive fails."""
LABELS = {(1, 0): "Up", (-1, 0): "Down", (0, 1): "Right", (0, -1): "Left"}


@dataclass
class Case:
    """A patrol: its floor, its robot, how it decides, and what disturbs it."""

    seed: int
    random: np.random.Generator = field(init=False)

    def __post_init__(self):
        self.random = random = np.random.default_rng(self.seed)
        self.rows, self.columns = int(random.integers(1, 3)), int(random.integers(1, 4))
        if self.rows * self.columns == 1:
            self.columns = 2
        self.width, self.height = random.uniform(3.0, 5.0, size=2).tolist()
        self.noise = float(random.choice([0.0, 0.05, 0.1]))
        self.margin = max(0.05, 3 * self.noise)
        self.speed = float(random.uniform(0.4, 1.0))
        self.turning = float(random.choice([0.0, 2.0]))
        self.replaces = bool(random.integers(2))
        self.rate = random.choice([0.0, 0.5, 1.0, 5.0])  # 0: by events
        self.by = str(random.choice(["reached", "place"]))
        self.cells = [(row, column) for row in range(self.rows) for column in range(self.columns)]
        self.names = {cell: f"R{index}" for index, cell in enumerate(self.cells)}
        self._join()
        self.goals = {cell: self._point(cell, 0.9) for cell in self.cells}
        self.ends = self._ends()
        self.disturbances = self._disturbances()
        self.start = (
            self._point(self.cells[int(random.integers(len(self.cells)))], 0.2)
            if random.integers(2)
            else self.goals[self.cells[0]]
        )

    def _point(self, cell, wall):
        x = self.random.uniform(wall, self.width - wall) + cell[1] * self.width
        y = self.random.uniform(wall, self.height - wall) + cell[0] * self.height
        return float(x), float(y)

    def _join(self):
        """Join rooms by doors: a tree, and some more."""
        self.doors = {}
        pairs = [
            (one, other)
            for one in self.cells
            for step in ((1, 0), (0, 1))
            if (other := (one[0] + step[0], one[1] + step[1])) in self.names
        ]
        group = {cell: cell for cell in self.cells}

        def root(cell):
            while group[cell] != cell:
                cell = group[cell]
            return cell

        for place in self.random.permutation(len(pairs)):
            one, other = pairs[place]
            if root(one) != root(other) or self.random.random() < 0.3:
                group[root(one)] = root(other)
                x, y = other[1] * self.width, other[0] * self.height
                if one[0] == other[0]:
                    y += self.height / 2
                else:
                    x += self.width / 2
                self.doors[one, other] = self.doors[other, one] = (x, y)

    def next_room(self, room, target):
        """Return the next room on the way with the fewest doors."""
        before, edge = {target: target}, [target]
        while room not in before:
            edge = [
                b for a in edge for (one, b) in self.doors if one == a and b not in before and not before.update({b: a})
            ]
        return before[room]

    def _ends(self):
        """Return the rooms at the two ends of the round: such as miss a label, whose way is taken for staying."""
        rooms = [cell for cell in self.cells if sum(one == cell for one, _ in self.doors) < len(self.labels)]
        if len(rooms) < 2:
            rooms = self.cells
        picked = self.random.choice(len(rooms), size=2, replace=False)
        return [rooms[place] for place in picked]

    def _disturbances(self):
        """Return what happens when: in the first minutes, and nothing later."""
        known = ["push", "stop", "block", "lose", "restart"]
        kinds = self.random.choice(known, size=int(self.random.integers(0, 6)))
        return sorted((float(self.random.uniform(0, 60)), str(kind)) for kind in kinds)

    @property
    def labels(self):
        return list(dict.fromkeys(LABELS[b[0] - a[0], b[1] - a[1]] for a, b in self.doors))

    def floor(self):
        """Return the map, without a grid."""
        side = 0.1
        frame = Frame(round(self.rows * self.height / side), round(self.columns * self.width / side), side)
        xs, ys = frame.centres()
        column = np.minimum((xs / self.width).astype(int), self.columns - 1)
        row = np.minimum((ys / self.height).astype(int), self.rows - 1)
        raster = (1 + row * self.columns + column).astype(np.uint16)
        nodes = [Node(self.names[cell], Pose(*self.goals[cell], 0.5)) for cell in self.cells]
        edges = [Edge(self.names[a], self.names[b], LABELS[b[0] - a[0], b[1] - a[1]]) for a, b in self.doors]
        return Map(Labels(frame, raster, tuple(self.names.values())), Graph(tuple(nodes), tuple(edges)))

    def policy(self):
        """Return the best action by room and half of the round; at the end of a half, one that stays."""
        labels, chosen = self.labels, []
        for cell in self.cells:
            for half in (0, 1):
                target = self.ends[half]
                if cell == target:
                    own = {LABELS[b[0] - a[0], b[1] - a[1]] for a, b in self.doors if a == cell}
                    label = next((label for label in labels if label not in own), labels[0])
                else:
                    step = self.next_room(cell, target)
                    label = LABELS[step[0] - cell[0], step[1] - cell[1]]
                chosen.append(labels.index(label))
        return mdm.policies.DeterministicPolicy(chosen, len(labels))

    @property
    def bound(self):
        """Seconds in which half a round is done for certain, a failed drive and a wait among them."""
        longest = sum(self.width + self.height for _ in self.cells)
        return 2.0 * longest / self.speed + len(self.cells) * (self.turning + 4.0) + 20.0


class Robot:
    """Drives on straight lines, from door to door."""

    def __init__(self, case, places):
        self.case, self.places = case, places
        self.x, self.y = case.start
        self.goal = None
        self.hears = True
        self.blocked = None
        self.replaces = case.replaces

    @property
    def room(self):
        case = self.case
        row = min(max(int(self.y / case.height), 0), case.rows - 1)
        return row, min(max(int(self.x / case.width), 0), case.columns - 1)

    async def localise(self):
        """Tell poses, with noise."""
        noise, random = self.case.noise, self.case.random
        while True:
            if self.hears:
                x, y = random.normal(scale=noise, size=2) if noise else (0.0, 0.0)
                self.places.see(Pose(self.x + x, self.y + y))
            await asyncio.sleep(STEP)

    async def go(self, pose):
        """Drive; fail where the goal is blocked for long."""
        self.goal = pose
        waited = turned = 0.0
        while True:
            await asyncio.sleep(STEP)
            if self.goal is not pose:
                return  # another drive has replaced it
            left = math.hypot(pose.x - self.x, pose.y - self.y)
            if self.blocked == (pose.x, pose.y) and left < 1.0:
                waited += STEP
                if waited > PATIENCE:
                    raise OSError("something stands on the goal")
            elif left > 0.15:
                self._drive(pose)
            elif (turned := turned + STEP) > self.case.turning:
                return

    def _drive(self, pose):
        case, room = self.case, self.room
        target = next(cell for cell, goal in case.goals.items() if goal == (pose.x, pose.y))
        x, y = pose.x, pose.y
        if room != target:
            x, y = case.doors[room, (step := case.next_room(room, target))]
            if math.hypot(x - self.x, y - self.y) < 0.1:  # through the door
                x, y = case.goals[step]
        left = math.hypot(x - self.x, y - self.y)
        share = min(1.0, case.speed * STEP / left) if left else 0.0
        self.x += share * (x - self.x)
        self.y += share * (y - self.y)


@dataclass
class Outcome:
    """How a patrol went: how drives ended, how long a half of the round took at most, and which drives led astray."""

    ended: dict[str, int]
    longest: float
    bound: float
    astray: list[str]

    @property
    def goes_on(self):
        return self.longest <= self.bound and not self.astray


def run(seed, *, then=None):
    """Run one patrol until it has been undisturbed for two bounds; return how it went."""
    case = Case(seed)

    async def main(runtime):
        floor = case.floor()
        predicates = mdm.PredicateManager()
        places = Places(floor, predicates, margin=case.margin)
        robot = Robot(case, places)
        on, off = (case.names[cell] for cell in case.ends)
        at = ".at_goal" if case.by == "reached" else ""
        predicates.latch("Half", set=f"{on}{at}", reset=f"{off}{at}")
        end = ".reached" if case.by == "reached" else ""
        ensemble = mdm.Ensemble(
            "robot",
            policy=case.policy(),
            predicates=predicates,
            states=[
                mdm.StateFactor("position", [f"{name}{end}" for name in case.names.values()]),
                mdm.StateFactor("half", ["Half"]),
            ],
            actions=Navigation(floor, robot, places).actions(then=then),
            **({"drive": mdm.FixedRate(float(case.rate))} if case.rate else {}),
        )
        turns, decided, astray = [], [], []

        def check(heading):
            """Check where a drive leads by the state that was decided on, and the graph."""
            place = list(case.names.values())[decided[-1].state // 2]
            if heading.target != (floor.graph.target(place, decided[-1].action_name) or place):
                astray.append(f"{decided[-1].time / 1e9:.1f} s: {heading} in {place}")

        def note(update):
            if "Half" in (*update.rising, *update.falling):
                turns.append(update.time / 1e9)

        await runtime.start(predicates)
        predicates.updates.subscribe(note)
        runtime.decisions.subscribe(decided.append)
        runtime.channel("navigation/headings", mdm.messages.Heading).subscribe(check)
        await runtime.start(places)
        await runtime.start(ensemble)
        living = asyncio.create_task(robot.localise())
        try:
            for time, kind in case.disturbances:
                await asyncio.sleep(max(0.0, time - runtime.clock.time()))
                await disturb(kind, case, robot, runtime, ensemble)
            began = runtime.clock.time()
            await asyncio.sleep(1.4 * case.bound)
            finished = runtime.clock.time()
        finally:
            living.cancel()
        times = [began, *(time for time in turns if time > began), finished]
        longest = max(b - a for a, b in pairwise(times))
        return Outcome(ensemble.action.ended, longest, case.bound, astray)

    return run_virtual(main)


async def disturb(kind, case, robot, runtime, ensemble):
    """Let something happen, and pass."""
    seconds = float(case.random.uniform(0.2, 8.0))
    if kind == "push":
        cell = case.cells[int(case.random.integers(len(case.cells)))]
        robot.x, robot.y = case._point(cell, 0.2)
    elif kind == "stop":
        ensemble.stop()
        await asyncio.sleep(seconds)
        ensemble.start()
    elif kind == "block":
        robot.blocked = list(case.goals.values())[int(case.random.integers(len(case.goals)))]
        await asyncio.sleep(3 * seconds)
        robot.blocked = None
    elif kind == "lose":
        robot.hears = False
        await asyncio.sleep(seconds)
        robot.hears = True
    else:  # all that Places knew is forgotten
        await runtime.stop(robot.places)
        await asyncio.sleep(seconds)
        await runtime.start(robot.places)


def main():
    """Run as many as asked for, and say which did not go on."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    failed = []
    for seed in range(count):
        outcome = run(seed)
        if not outcome.goes_on:
            failed.append(seed)
            print(f"patrol {seed} did not go on: {outcome}; {Case(seed)}", flush=True)
    print(f"{count} patrols of random floors: {len(failed)} did not go on")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
