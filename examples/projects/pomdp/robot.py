"""What the robot observes and does; the door is simulated."""

import asyncio
import random

RIGHT = 0.85  # the share of looks that tell the truth, as in the model

chance = random.Random(1)
door = "open"
passed = 0


async def live(system):
    """Keep what raises events, and wait for actions."""
    global predicates
    predicates = system.predicates
    await asyncio.Event().wait()


async def look():
    """Look at the door for a second; what is seen is decided on."""
    await asyncio.sleep(1)
    other = "shut" if door == "open" else "open"
    seen = door if chance.random() < RIGHT else other
    print(f"sees the door {seen}", flush=True)
    predicates.occur("SawOpen" if seen == "open" else "SawShut")


async def pass_door():
    """Pass the door, if it is open; then there is another one."""
    global passed
    print("passes the door" if door == "open" else "runs into the door", flush=True)
    passed += door == "open"
    await another()


async def ring():
    """Ring, whereupon somebody leads the robot to another door."""
    print("rings", flush=True)
    await another()


async def another():
    """Stand before another door, and look at it."""
    global door
    door = chance.choice(("open", "shut"))
    await look()


def stand():
    """Stand still: the safe action."""
    print("stands still", flush=True)
