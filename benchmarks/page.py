"""What a page costs a robot: from a sensor's call to the action's callback, with and without one, and with a client.

The client is a process of its own that asks for each next frame at once, as a browser does that draws without delay.
Cases are measured in rounds, one after the other in each; ratios are of medians in this one run.
"""

from __future__ import annotations

import asyncio
import gc
import subprocess
import sys
import time
from typing import Any

from decision_latency import Callback, robot
from measurement import arguments, quantiles, report, table

import mdm
from mdm.policies import DeterministicPolicy
from mdm.snapshots import LiveRun
from mdm.views.web import Page

CLIENT = """
import json, sys
from websockets.sync.client import connect
port, token = sys.argv[1:]
headers = {"Cookie": f"mdm-{port}={token}"}
with connect(f"ws://127.0.0.1:{port}/socket", origin=f"http://127.0.0.1:{port}", additional_headers=headers) as socket:
    socket.recv()
    frames, size = 0, 0
    try:
        while True:
            socket.send(json.dumps({"say": "drawn", "cursor": 0, "close": ["robot"]}))
            size += len(socket.recv())
            frames += 1
            if frames == 1:
                print("ready", flush=True)
            if frames % 20 == 0:
                print(frames, size, flush=True)
    except Exception:
        pass
"""
TOKEN = "token-of-this-benchmark"
PAUSE = 0.001
now = time.perf_counter


async def measure(case: str, count: int) -> tuple[list[float], float]:
    """Return latencies in seconds, and the share of the loop's processor that the process has used."""
    callback = Callback()
    ensemble, sensor = robot("robot", callback)
    page = None if case == "no page" else Page(0, token=TOKEN, announce=lambda _: None)
    latencies = []
    client: subprocess.Popen[str] | None = None
    async with mdm.Runtime(log=False, page=page, watchdog=None) as runtime:
        await runtime.start(ensemble)
        if case == "one client, 20 Hz" and page is not None:
            port = page.address.split(":")[2].split("/")[0]
            command = [sys.executable, "-c", CLIENT, port, TOKEN]
            client = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # noqa: ASYNC220 - not measured
            assert client.stdout is not None
            await asyncio.to_thread(client.stdout.readline)
        gc.collect()
        began, used = now(), time.process_time()
        for index in range(count):
            before = now()
            sensor.set(index % 2 == 0)
            latencies.append(callback.at - before)
            await asyncio.sleep(PAUSE)
        share = (time.process_time() - used) / (now() - began)
    if client is not None:
        client.kill()
        client.communicate()
    return latencies, share


async def frames(ensembles: int, states: int, repeats: int) -> list[float]:
    """Return how long frames take of so many ensembles, in seconds, while one of them decides anew before each."""
    async with mdm.Runtime(log=False, watchdog=None) as runtime:
        live = LiveRun(runtime)
        live.open()
        robots = [
            mdm.Ensemble(f"robot{number}", policy=DeterministicPolicy([0] * states), actions={0: lambda: None})
            for number in range(ensembles)
        ]
        for each in robots:
            await runtime.start(each)
        live.frame()
        taken = []
        for number in range(repeats):
            robots[0].publish_state(number % states)
            before = now()
            live.encoded({"robot0"})
            taken.append(now() - before)
        live.close()
    return taken


def main() -> None:
    """Measure, print and write."""
    options = arguments(__doc__ or "")
    rounds, count = (1, 50) if options.quick else (5, 2_000)
    cases: dict[str, list[float]] = {"no page": [], "a page, nobody looks": [], "one client, 20 Hz": []}
    shares: dict[str, list[float]] = {case: [] for case in cases}
    for _ in range(rounds):
        for case, latencies in cases.items():
            found, share = asyncio.run(measure(case, count))
            latencies.extend(found[count // 10 :])
            shares[case].append(share)
    alone = quantiles(cases["no page"])["median_us"]
    rows: list[dict[str, Any]] = [
        {
            "case": case,
            **quantiles(latencies),
            "ratio": quantiles(latencies)["median_us"] / alone,
            "processor_percent": 100 * sum(shares[case]) / len(shares[case]),
        }
        for case, latencies in cases.items()
    ]
    table("from a sensor's call to the callback", rows)
    made = [
        {"ensembles": number, **quantiles(asyncio.run(frames(number, 8, 20 if options.quick else 500)))}
        for number in ((1, 10) if options.quick else (1, 10, 100, 1_000))
    ]
    table("a frame", made)
    report("page", {"latency": rows, "frames": made}, options.output)


if __name__ == "__main__":
    main()
