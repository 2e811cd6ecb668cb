"""Places and navigation: a robot that patrols three rooms, in virtual time.

The map says which cells belong to which room, where the goal of each is, and which ways lead from one to the next.
`Places` makes predicates of the robot's poses, and `Navigation` actions of the ways, `Left` and `Right`. What would
drive a real robot is a navigator, here one that goes straight on. The robot decides where it has arrived, not where it
enters a room: it would turn in the door.
"""

import asyncio
import math
import random

import numpy as np

import mdm
from mdm.maps import Edge, Frame, Graph, Labels, Map, Navigation, Node, Places, Pose
from mdm.messages import ActionLife, PredicateUpdate

SPEED = 0.5  # metres a second
STEP = 0.1  # seconds from one pose to the next

rooms = ("Lobby", "Office", "Lab")
raster = np.repeat(np.arange(1, 4, dtype=np.uint16), 40)[None].repeat(60, axis=0)  # 4 m x 6 m each, of cells of 0.1 m
goals = [Node(name, Pose(4.0 * index + 2.0, 3.0)) for index, name in enumerate(rooms)]
ways = [
    ("Lobby", "Office", "Right"),
    ("Office", "Lab", "Right"),
    ("Lab", "Office", "Left"),
    ("Office", "Lobby", "Left"),
]
floor = Map(Labels(Frame(60, 120, 0.1), raster, rooms), Graph(tuple(goals), tuple(Edge(*way) for way in ways)))


class Robot:
    """A robot that drives straight to its goal, and knows its pose with an error of 5 cm."""

    def __init__(self, places: Places) -> None:
        self.places = places
        self.x, self.y = 2.0, 3.0
        self.random = random.Random(1)

    async def go(self, goal: Pose) -> None:
        """Drive to a goal; cancelled, the robot stops where it is."""
        while (left := math.hypot(goal.x - self.x, goal.y - self.y)) > 0.01:
            step = min(SPEED * STEP / left, 1.0)
            self.x += step * (goal.x - self.x)
            self.y += step * (goal.y - self.y)
            await asyncio.sleep(STEP)

    async def localise(self) -> None:
        """Tell a pose ten times a second."""
        while True:
            self.places.see(Pose(self.x + self.random.gauss(0, 0.05), self.y + self.random.gauss(0, 0.05)))
            await asyncio.sleep(STEP)


predicates = mdm.PredicateManager()
places = Places(floor, predicates, margin=0.15)
predicates.latch("IsOnTheWayBack", set="Lab.at_goal", reset="Lobby.at_goal")
robot = Robot(places)
patrol = mdm.Ensemble(
    "patrol",
    policy=mdm.policies.QTable([[1, 0], [1, 0], [1, 0], [0, 1], [0, 1], [0, 1]]),  # Right on the way out, Left back
    predicates=predicates,
    states=[
        mdm.StateFactor("way", ["IsOnTheWayBack"]),
        mdm.StateFactor("place", [f"{room}.reached" for room in rooms]),
    ],
    actions=Navigation(floor, robot, places).actions(),
)


async def main() -> None:
    async with mdm.Runtime() as runtime:

        def show(text: str) -> None:
            print(f"{runtime.clock.time():5.1f} s  {text}")

        def show_predicates(update: PredicateUpdate) -> None:
            if update.rising:
                show(f"{' and '.join(update.rising)}: true")

        def show_life(life: ActionLife) -> None:
            show(f"    {life.action} {life.status}")

        await runtime.start(predicates)
        await runtime.start(places)
        predicates.updates.subscribe(show_predicates)
        runtime.channel("patrol/lives", ActionLife).subscribe(show_life)
        await runtime.start(patrol)
        localisation = asyncio.create_task(robot.localise())
        await asyncio.sleep(45)
        localisation.cancel()


mdm.run(main, virtual=True)
