"""What each robot hears and does; what it hears is simulated."""

import asyncio
import random

BEHIND = "Left"  # the door that is better left shut, the same for both robots
RIGHT = 0.85  # the share of what is heard that is true, as in team.dpomdp


class Robot:
    """One of the robots; each process uses one of them, and a test has both in its own."""

    async def live(self, system):
        """Keep what raises events, and wait for actions."""
        self.predicates = system.predicates
        await asyncio.Event().wait()

    def listen(self):
        """Listen."""
        other = "Right" if BEHIND == "Left" else "Left"
        heard = BEHIND if random.random() < RIGHT else other
        print("hears it at the", heard, flush=True)
        self.predicates.occur(f"Heard{heard}")

    def open_left(self):
        """Open the left door, and listen for the next time."""
        print("opens the left door", flush=True)
        self.listen()

    def open_right(self):
        """Open the right door, and listen for the next time."""
        print("opens the right door", flush=True)
        self.listen()


ada, bob = Robot(), Robot()
