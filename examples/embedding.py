"""Embedding: an ensemble beside other tasks of a program that has its own event loop, with a sensor in a thread.

The program is a small server loop that counts requests. A thread reads a (simulated) thermometer; when it is hot, the
ensemble has the fan run, an async action that is cancelled as soon as it is cool again.
"""

import asyncio
import threading

import mdm

READINGS = [21.0, 24.5, 31.0, 33.5, 29.0, 22.0]


async def serve(stop: asyncio.Event) -> int:
    """The program's own work, which goes on whatever the ensemble does."""
    served = 0
    while not stop.is_set():
        served += 1
        await asyncio.sleep(0.001)
    return served


async def run_fan() -> None:
    """Run until cancelled; what is in ``finally`` may await."""
    print("fan on")
    try:
        await asyncio.sleep(3600)
    finally:
        await asyncio.sleep(0.001)  # let it spin down
        print("fan off")


def read_thermometer(hot: mdm.Sensor, loop: asyncio.AbstractEventLoop, done: asyncio.Event) -> None:
    """A driver in a thread of its own: a sensor can be set from anywhere."""
    for reading in READINGS:
        threading.Event().wait(0.02)
        hot.set(reading > 30)
    loop.call_soon_threadsafe(done.set)


async def main() -> None:
    predicates = mdm.PredicateManager()
    hot = predicates.sensor("IsHot", initial=False, max_age=1.0)
    cooler = mdm.Ensemble(
        "cooler",
        policy=mdm.policies.DeterministicPolicy([0, 1]),
        predicates=predicates,
        states=[mdm.StateFactor("temperature", ["IsHot"])],
        actions={"Wait": lambda: print("waiting"), "Cool": run_fan},
        safe_action="Wait",
    )
    done = asyncio.Event()
    server = asyncio.create_task(serve(done))
    async with mdm.Runtime() as runtime:
        await runtime.start(cooler)
        thread = threading.Thread(target=read_thermometer, args=(hot, asyncio.get_running_loop(), done))
        thread.start()
        await done.wait()
        thread.join()
    print(f"the program went on meanwhile: {await server > 1}")


asyncio.run(main())
