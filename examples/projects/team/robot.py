"""What a robot hears and does; what it hears is simulated."""

import asyncio
import random

BEHIND = "Left"  # the door that is better left shut, the same for both robots
RIGHT = 0.75  # the share of what is heard that is true, as in the model


async def live(system):
    """Keep what raises events, and wait for actions."""
    global predicates
    predicates = system.predicates
    await asyncio.Event().wait()


def listen():
    """Listen."""
    other = "Right" if BEHIND == "Left" else "Left"
    heard = BEHIND if random.random() < RIGHT else other
    print("hears it at the", heard, flush=True)
    predicates.occur(f"Heard{heard}")


def open_left():
    """Open the left door, and listen for the next time."""
    print("opens the left door", flush=True)
    listen()


def open_right():
    """Open the right door, and listen for the next time."""
    print("opens the right door", flush=True)
    listen()
