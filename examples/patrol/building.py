"""The demo's building: a floor with one simulated robot; people, intruders and fires come and go.

A real robot's code would stand in its place: what tells poses, what drives, sensors that set predicates, and async
functions that can be cancelled at any ``await``.
"""

from __future__ import annotations

import asyncio
import functools
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from mdm.maps import Pose, load_map
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building, Visits

if TYPE_CHECKING:
    from collections.abc import Callable

    import mdm
    from mdm.simulation.building import Robot, Visit

HERE = Path(__file__).parent
floor = load_map(HERE / "floor.xml", grid=HERE / "floor.yaml", labels=HERE / "labels.png")


class World:
    """What the robot knows of: people who have called, and what it has seen. ``tell`` takes all that happens.

    ``since`` says when it came to know of each, ``attended`` after how many seconds it had seen to one of a kind,
    ``left`` after how many one was gone by itself, and ``news`` is set when it has seen to one. All that is random is
    drawn from ``seed``.
    """

    seed: ClassVar[int] = 3
    known: ClassVar[dict[int, Visit]] = {}
    since: ClassVar[dict[int, float]] = {}
    attended: ClassVar[list[tuple[float, str]]] = []
    left: ClassVar[list[tuple[float, str]]] = []
    news: ClassVar[asyncio.Event] = asyncio.Event()
    tell: Callable[[str], None] = staticmethod(lambda _: None)


@functools.cache
def building() -> Building:
    """Return the building, in which visits come and go."""
    visits = [
        Visits("person", every=20.0, stay=90.0),  # seconds
        Visits("intruder", every=30.0, stay=60.0),
        Visits("fire", every=40.0),  # burns until it is put out
    ]
    return Building(floor, visits=visits, seed=World.seed)


@functools.cache
def robot() -> Robot:
    """Return the robot in the building."""
    return building().robot("robot", at=floor.graph.names[0], speed=1.0, noise=0.05)


async def live(system: mdm.System) -> None:
    """Let the building live, and tell the system's sensors of it."""
    runtime = system.runtime
    assert system.places is not None
    see = system.places.see
    runtime.channel("building/robot/pose", PoseUpdate).subscribe(lambda pose: see(Pose(pose.x, pose.y, pose.yaw)))
    eyes = robot()
    await runtime.start(building())
    while True:
        World.news.clear()
        there = {visit.number: visit for kind in ("person", "intruder", "fire") for visit in building().present(kind)}
        for number, visit in list(World.known.items()):
            if number not in there:
                del World.known[number]
                if number in World.since:
                    World.left.append((runtime.clock.time() - World.since.pop(number), visit.kind))
                World.tell(f"the {visit.kind} in {visit.place} is gone")
        for number, visit in there.items():
            if number not in World.known and (visit.kind == "person" or eyes.sees(visit.x, visit.y, reach=6.0)):
                World.known[number] = visit
                World.since[number] = runtime.clock.time()
                call = f"a person calls from {visit.place}"
                World.tell(call if visit.kind == "person" else f"sees the {visit.kind} in {visit.place}")
        for predicate, kind in (("PersonIsWaiting", "person"), ("IntruderIsSeen", "intruder"), ("FireIsSeen", "fire")):
            system.predicates.sense(predicate, bool(known(kind)))
        with suppress(TimeoutError):
            async with asyncio.timeout(0.2):
                await World.news.wait()


def known(kind: str) -> list[Visit]:
    """Return what the robot knows of that has to be seen to, of one kind."""
    there = building().present(kind)  # what has been seen to, or gone by itself, is not there any more
    return [visit for visit in World.known.values() if visit in there]


def drive() -> object:
    """Return what drives the robot: the building's robot is a navigator itself."""
    return robot()


# -- Actions of the top level ------------------------------------------------------------------------------------


async def assist() -> None:
    """Drive to people who have called, and help, until nobody waits; who calls meanwhile is helped, too."""
    while people := known("person"):
        await _attend(people[0], 1.5, "the person has been helped, and leaves")


async def warn_intruder() -> None:
    """Drive to intruders that were seen, who leave then."""
    while intruders := known("intruder"):
        await _attend(intruders[0], 1.0, "the intruder runs away")


async def fight_fire() -> None:
    """Drive to fires that were seen, and put them out."""
    while fires := known("fire"):
        await _attend(fires[0], 2.0, "the fire is out")


async def _attend(visit: Visit, seconds: float, told: str) -> None:
    await robot().go(floor.graph.node(visit.place).goal)
    await asyncio.sleep(seconds)
    if visit in building().present(visit.kind):  # and has not gone by itself
        World.tell(told)
        World.attended.append((building().runtime.clock.time() - World.since.pop(visit.number), visit.kind))
        building().go(visit)
        World.news.set()


def stop_motors() -> None:
    """Stand still, whatever else happens."""
    World.tell("the robot's motors are off")
