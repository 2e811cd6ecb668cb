"""A passage between two rooms that is too narrow for two robots, and one who stands or drives there as a test says."""

from __future__ import annotations

from maps.floors import Floor

from mdm.simulation.building import Whereabouts

PASSAGE = Floor(
    20.0,
    8.0,
    {"west": (0.0, 0.0, 7.0, 8.0), "passage": (7.0, 3.45, 13.0, 4.55), "east": (13.0, 0.0, 20.0, 8.0)},
    {("passage", "west"): (6.8, 3.525, 7.2, 4.475), ("east", "passage"): (12.8, 3.525, 13.2, 4.475)},
)
MIDDLE = 3.0
"""Metres along the y axis."""
WEST = (-0.5, MIDDLE)
"""Where those who drive to the west are going."""


class Scripted:
    """A guest of a building who is where a test says, and is told so ten times a second.

    Args:
        building: The building.
        name: Its name.
        x: Where in the passage it is, in metres.
        remaining: The metres that it has to go, to the west; 0 for one that stands.
    """

    def __init__(self, building, name, x, remaining=0.0):
        self.guest = building.guest(name)
        self.x, self.y = x, MIDDLE
        self.remaining = remaining

    def tell(self):
        way = (WEST,) if self.remaining else ()
        self.guest.take(Whereabouts(0, self.x, self.y, 0.0, (0.0, 0.0), self.remaining, way))

    async def keep_telling(self, clock):
        while True:
            self.tell()
            await clock.sleep(0.1)
