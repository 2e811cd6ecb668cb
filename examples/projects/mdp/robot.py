"""What the robot senses and does; the battery is simulated."""

import asyncio

battery = 0.5  # from 0, empty, to 1, full


async def live(system):
    """Tell twice a second whether the battery is low."""
    while True:
        system.predicates.sense("BatteryLow", battery < 0.3)
        await asyncio.sleep(0.5)


async def work():
    """Work for two seconds."""
    global battery
    await asyncio.sleep(2)
    battery = max(battery - 0.1, 0.0)
    print(f"has worked; the battery is at {battery:.0%}", flush=True)


async def charge():
    """Charge for two seconds."""
    global battery
    await asyncio.sleep(2)
    battery = min(battery + 0.3, 1.0)
    print(f"has charged; the battery is at {battery:.0%}", flush=True)


def rest():
    """Do nothing: the safe action."""
    print("rests", flush=True)
