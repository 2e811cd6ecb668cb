"""What tells where the robot is, and what drives: straight on, at half a metre a second."""

import asyncio
import math

from mdm.maps import Pose

SPEED = 0.5  # metres a second
STEP = 0.1  # seconds from one pose to the next

x, y = 2.0, 3.0


class Wheels:
    """Drives straight to a goal; cancelled, it stops where it is."""

    async def go(self, goal):
        """Drive to a goal."""
        global x, y
        while (left := math.hypot(goal.x - x, goal.y - y)) > 0.01:
            step = min(SPEED * STEP / left, 1.0)
            x += step * (goal.x - x)
            y += step * (goal.y - y)
            await asyncio.sleep(STEP)
        print(f"is at {x:.1f}, {y:.1f}", flush=True)


async def localise(system):
    """Tell the pose ten times a second."""
    while True:
        system.places.see(Pose(x, y))
        await asyncio.sleep(STEP)


def halt():
    """Stand still: the safe action."""
    print("halts", flush=True)
