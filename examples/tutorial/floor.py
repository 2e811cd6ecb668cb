"""What the steps share: the floor of the demo, with six rooms, and a robot that drives on it."""

from pathlib import Path

import mdm
from mdm.maps import Navigation, Places, Pose, load_map
from mdm.messages import PoseUpdate
from mdm.simulation.building import Building

PATROL = Path(__file__).parent.parent / "patrol"
FLOOR = load_map(PATROL / "floor.xml", grid=PATROL / "floor.yaml", labels=PATROL / "labels.png")
ROOMS = FLOOR.graph.names


class Robot:
    """A robot in a simulated building: where it is becomes predicates, and the ways of the map are its actions."""

    def __init__(self, predicates: mdm.PredicateManager) -> None:
        self.predicates = predicates
        self.building = Building(FLOOR, seed=1)
        self.places = Places(FLOOR, predicates, margin=0.2, tour=ROOMS)
        self.wheels = self.building.robot("robot", at="LRM", speed=1.0, noise=0.05)
        self.navigation = Navigation(FLOOR, self.wheels, self.places)
        self.lost = False  # whether its localisation is out of order

    async def start(self, runtime: mdm.Runtime) -> None:
        """Start the building, and tell poses from then on."""

        def see(pose: PoseUpdate) -> None:
            if not self.lost:
                self.places.see(Pose(pose.x, pose.y, pose.yaw))

        runtime.channel("building/robot/pose", PoseUpdate).subscribe(see)
        await runtime.start(self.predicates)
        await runtime.start(self.places)
        await runtime.start(self.building)


def position() -> mdm.StateFactor:
    """Return the factor of the state that is the room where the robot has arrived last."""
    return mdm.StateFactor("position", [f"{room}.reached" for room in ROOMS])
