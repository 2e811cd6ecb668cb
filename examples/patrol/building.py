"""The demo's building: a floor with one simulated robot; people, intruders and fires come and go.

A real robot's code would stand in its place: what tells poses, what drives, sensors that set predicates, and async
functions that can be cancelled at any ``await``.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from mdm.maps import Pose, load_map
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building, Visits

if TYPE_CHECKING:
    from collections.abc import Callable

    import mdm
    from mdm.simulation.building import Visit

HERE = Path(__file__).parent
floor = load_map(HERE / "floor.xml", grid=HERE / "floor.yaml", labels=HERE / "labels.png")
building = Building(
    floor,
    visits=[
        Visits("person", every=20.0, stay=90.0),  # seconds
        Visits("intruder", every=30.0, stay=60.0),
        Visits("fire", every=40.0),  # burns until it is put out
    ],
    seed=21,
)
robot = building.robot("robot", at="ElevatorHallway", speed=1.0, noise=0.05)


class World:
    """What else is known of the robot. ``tell`` is called with a sentence for everything that happens."""

    tell: Callable[[str], None] = staticmethod(lambda _: None)


async def live(system: mdm.System) -> None:
    """Let the building live, and tell the system's sensors of it."""
    runtime = system.runtime
    assert system.places is not None
    see = system.places.see
    runtime.channel("building/robot/pose", PoseUpdate).subscribe(lambda pose: see(Pose(pose.x, pose.y, pose.yaw)))
    await runtime.start(building)
    known: dict[int, str] = {}
    while True:
        there = {visit.number: visit for kind in ("person", "intruder", "fire") for visit in building.present(kind)}
        for number in known.keys() - there.keys():
            World.tell(f"{known.pop(number)} is gone")
        for number, visit in there.items():
            if number not in known and (visit.kind == "person" or robot.sees(visit.x, visit.y, reach=6.0)):
                known[number] = f"the {visit.kind} in {visit.place}"
                World.tell(f"a person calls from {visit.place}" if visit.kind == "person" else f"sees {known[number]}")
        for predicate, kind in (("PersonIsWaiting", "person"), ("IntruderIsSeen", "intruder"), ("FireIsSeen", "fire")):
            seen = any(visit.kind == kind and number in known for number, visit in there.items())
            system.predicates.sense(predicate, seen)
        await asyncio.sleep(0.2)


def drive() -> object:
    """Return what drives the robot: the building's robot is a navigator itself."""
    return robot


# -- Actions of the top level ------------------------------------------------------------------------------------


async def assist() -> None:
    """Drive to a person and help."""
    for person in building.present("person"):
        await _attend(person, 1.5, "the person has been helped, and leaves")


async def warn_intruder() -> None:
    """Drive to an intruder, who leaves then."""
    for intruder in building.present("intruder"):
        await _attend(intruder, 1.0, "the intruder runs away")


async def fight_fire() -> None:
    """Drive to a fire and put it out."""
    for fire in building.present("fire"):
        await _attend(fire, 2.0, "the fire is out")


async def _attend(visit: Visit, seconds: float, told: str) -> None:
    await robot.go(floor.graph.node(visit.place).goal)
    await asyncio.sleep(seconds)
    World.tell(told)
    building.go(visit)


def stop_motors() -> None:
    """Stand still, whatever else happens."""
    World.tell("the robot's motors are off")
