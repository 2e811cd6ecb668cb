"""A simulated building with robots that patrol it, in virtual time, against the bare simulator with as many robots."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, report, table
from navground import core, sim

import mdm
from mdm.maps import Map, Navigation, Places, load_map
from mdm.maps.model import latch, model
from mdm.simulation.building import Building
from mdm.simulation.building.body import walls

if TYPE_CHECKING:
    from collections.abc import Callable

FOLDER = Path(__file__).parent.parent / "examples" / "patrol"
STARTS = ("ElevatorHallway", "SoccerField", "CoffeeRoom", "LRM")
PERIOD = 0.1


def patrolled(floor: Map, policy: Any, robots: int) -> Callable[[float], None]:
    """Return what lets robots patrol for so many seconds: poses, places, decisions and drives."""

    def run(seconds: float) -> None:
        building = Building(floor, seed=1)
        parts: list[Any] = []
        for number, start in enumerate(STARTS[:robots]):
            predicates = mdm.PredicateManager(f"predicates{number}")
            places = Places(floor, predicates, margin=0.2, name=f"places{number}")
            robot = building.robot(f"robot{number}", at=start, places=places, noise=0.05)
            predicates.latch("Halfway", set="ElevatorHallway.at_goal", reset="SoccerField.at_goal")
            rooms = mdm.StateFactor("position", [f"{room}.reached" for room in floor.graph.names])
            halfway = mdm.StateFactor("halfway", {"yes": "Halfway"})
            actions = Navigation(floor, robot, places, name=f"navigation{number}").actions()
            ensemble = mdm.Ensemble(
                f"patrol{number}", policy=policy, predicates=predicates, states=[rooms, halfway], actions=actions
            )
            parts += [predicates, places, ensemble]

        async def main() -> None:
            async with mdm.Runtime(log=None) as runtime:
                for part in parts:
                    await runtime.start(part)
                await runtime.start(building)
                await runtime.clock.sleep(seconds)

        mdm.run(main, virtual=True)

    return run


def bare(floor: Map, robots: int) -> Callable[[float], None]:
    """Return what lets the simulator alone step robots that drive to and fro."""
    assert floor.grid is not None
    ends = walls(floor.grid)

    def run(seconds: float) -> None:
        world = sim.World()
        for one, other in ends:
            world.add_wall(sim.Wall(core.LineSegment(one, other)))
        for start in STARTS[:robots]:
            kinematics = core.kinematics.TwoWheelsDifferentialDriveKinematics(max_speed=0.5, wheel_axis=0.4)
            behavior = core.behaviors.HLBehavior(kinematics=kinematics, radius=0.25)
            sight = sim.state_estimations.BoundedStateEstimation(range=5.0)
            agent = sim.Agent(
                radius=0.25, behavior=behavior, kinematics=kinematics, state_estimations=[sight], control_period=PERIOD
            )
            goal = floor.graph.node(start).goal
            agent.pose = core.Pose2((goal.x, goal.y), goal.yaw)
            world.add_agent(agent)
            agent.controller.go_to_position(np.array((goal.x, goal.y + 1.0)), 0.1)
        for _ in range(round(seconds / PERIOD)):
            world.update(PERIOD)

    return run


def speeds(quick: bool) -> list[dict[str, Any]]:
    """Return how many times faster than real time each is, in processor time."""
    floor = load_map(FOLDER / "floor.xml", grid=FOLDER / "floor.yaml", labels=FOLDER / "labels.png")
    halfway = latch(floor.graph, "halfway", on="ElevatorHallway", off="SoccerField")
    policy = mdm.solve(model(floor.graph, factors=[halfway])).policy
    seconds, runs = (20.0, 1) if quick else (600.0, 3)
    cases = {}
    for robots in (1, 2):
        cases[f"mdm, robots: {robots}"] = patrolled(floor, policy, robots)
        cases[f"bare simulator, robots: {robots}"] = bare(floor, robots)
    measured: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(runs):
        for name, run in cases.items():
            began = time.process_time()
            run(seconds)
            measured[name].append(seconds / (time.process_time() - began))
    return [{"case": name, "times real time": round(float(np.median(each)))} for name, each in measured.items()]


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    results = {"speeds": speeds(given.quick)}
    table("A building, by processor time", results["speeds"])
    report("building", results, given.output)


if __name__ == "__main__":
    main()
