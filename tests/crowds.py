"""Robots that share a floor: what they touch, how many of their drives fail, and how long they wait.

Each drives from room to room, at random, and people stand about. ``python -m crowds 3600`` runs 1, 2, 4 and 8 robots
for an hour of virtual time on three floors, eight of them twice, and says which were not as they should be.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import random
import sys
from dataclasses import dataclass, field
from importlib import import_module

from maps.floors import FURNITURE, offices
from passage import PASSAGE
from places import EXAMPLES

import mdm
from mdm.maps import Pose
from mdm.simulation.building import Building, DriveError, Visits

LONGEST = 60.0
"""Seconds for which a robot that drives stays within 0.2 m."""


@dataclass
class Crowd:
    """How a run went."""

    drives: int = 0
    failed: list[str] = field(default_factory=list)
    waited: float = 0.0
    contacts: int = 0
    poses: str = ""

    def faults(self):
        """Return in words what was not as it should be."""
        checks = {
            f"{self.contacts} contacts": self.contacts == 0,
            f"one waited for {self.waited:.0f} s": self.waited <= LONGEST,
        }
        return [words for words, is_right in checks.items() if not is_right]


def floors():
    """Return the floors by name: rooms with furniture, the demo's, and rooms at the ends of a narrow passage."""
    sys.path.insert(0, str(EXAMPLES / "patrol"))
    try:
        demo = import_module("building").floor
    finally:
        del sys.path[0]
        sys.modules.pop("building", None)
    return {"offices": offices(furniture=FURNITURE[offices]).map(), "the demo's": demo, "a passage": PASSAGE.map()}


def crowd(floor, count, seconds, *, seed=1):
    """Have so many robots drive about."""
    building = Building(floor, visits=[Visits("person", every=60.0, stay=60.0)], seed=seed)
    names, begun, run = list(floor.graph.names), {}, Crowd()
    for number in range(count):
        name = names[number % len(names)]
        goal, beside = floor.graph.node(name).goal, 0.7 * (number // len(names))  # metres
        robot = building.robot(f"robot{number}", at=Pose(goal.x + beside, goal.y, goal.yaw), speed=0.7, noise=0.05)
        begun[robot] = name

    async def drive(robot, name, choices):
        while True:
            name = choices.choice([other for other in names if other != name])
            try:
                await robot.go(floor.graph.node(name).goal)
                run.drives += 1
            except DriveError as error:
                run.failed.append(str(error))
                await asyncio.sleep(1.0)

    async def main():
        poses = hashlib.sha256()
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(building)
            drives = [
                asyncio.create_task(drive(robot, name, random.Random(100 * seed + number)))
                for number, (robot, name) in enumerate(begun.items())
            ]
            since = dict.fromkeys(begun, (0.0, (math.inf, math.inf)))
            while (now := runtime.clock.time()) < seconds:
                for robot, (before, at) in since.items():
                    here = robot.pose
                    poses.update(repr(here).encode())
                    if math.dist((here.x, here.y), at) > 0.2 or robot.goal is None:
                        since[robot] = now, (here.x, here.y)
                    else:
                        run.waited = max(run.waited, now - before)
                await asyncio.sleep(1.0)
            for task in drives:
                task.cancel()
            await asyncio.gather(*drives, return_exceptions=True)
        run.contacts, run.poses = sum(robot.collisions for robot in begun), poses.hexdigest()

    mdm.run(main, virtual=True)
    return run


def main():
    """Run them, and say how they went."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0
    wrong = 0
    print("floor       robots  drives  failed  longest wait, s  contacts")
    for name, floor in floors().items():
        for count in (1, 2, 4, 8):
            run = crowd(floor, count, seconds)
            found = run.faults()
            if count == 8 and crowd(floor, count, seconds) != run:
                found.append("not the same twice")
            wrong += bool(found)
            line = f"{name:12}{count:6}{run.drives:8}{len(run.failed):8}{run.waited:17.0f}{run.contacts:10}"
            print(f"{line}  {'; '.join(found)}".rstrip(), flush=True)
            for reason in sorted(set(run.failed)):
                print(f"    {run.failed.count(reason)}: {reason}")
    print(f"{wrong} not as they should be")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
