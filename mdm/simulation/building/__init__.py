"""A simulated building: robots that drive on a floor, and people, intruders and fires that come and go.

It needs navground, the extra ``mdm[simulation]``, and is meant for examples and tests.
"""

from mdm.simulation.building.body import Guest, Whereabouts
from mdm.simulation.building.building import Building
from mdm.simulation.building.robot import DriveError, Robot
from mdm.simulation.building.tower import Rider, Tower
from mdm.simulation.building.visits import Visit, VisitChange, Visits

__all__ = [
    "Building",
    "DriveError",
    "Guest",
    "Rider",
    "Robot",
    "Tower",
    "Visit",
    "VisitChange",
    "Visits",
    "Whereabouts",
]
