"""From a stimulus to the first line of the action's callback: ours, and the same layers as others would write them.

Cases are measured in rounds, one after the other in each, so that the machine's moods hit all alike; ratios are of
medians in this one run.
"""

from __future__ import annotations

import asyncio
import gc
import statistics
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from measurement import arguments, quantiles, report, table
from rivals import Direct, Pykka, Queues, Tight

import mdm
from mdm.messages import SensorUpdate, State

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

HERE = Path(__file__).parent
CORPUS = HERE.parents[1] / "shared" / "corpus"
POLICY = [index % 3 for index in range(12)]
now = time.perf_counter


class Callback:
    """Tells when it was called."""

    at = 0.0

    def __call__(self) -> None:
        """Be the callback."""
        self.at = now()


def robot(
    name: str, callback: Callback, manager: mdm.PredicateManager | None = None
) -> tuple[mdm.Ensemble, mdm.Sensor]:
    """Return an MDP ensemble of 12 states (3 x 2 x 2) and a sensor that changes its state."""
    ensemble, a, _ = robot_with_two(name, callback, manager)
    return ensemble, a


def robot_with_two(
    name: str, callback: Callback, manager: mdm.PredicateManager | None = None
) -> tuple[mdm.Ensemble, mdm.Sensor, mdm.Sensor]:
    """Return the same with both of the sensors that change its state."""
    own = manager is None
    manager = mdm.PredicateManager(f"predicates-{name}") if manager is None else manager
    prefix = "" if own else name
    rooms = [f"{prefix}Room{index}" for index in range(3)]
    for index, room in enumerate(rooms):
        manager.sensor(room, initial=index == 0)
    a = manager.sensor(f"{prefix}A", initial=False)
    b = manager.sensor(f"{prefix}B", initial=False)
    manager.define(f"{prefix}Neither", f"not {prefix}A and not {prefix}B")
    ensemble = mdm.Ensemble(
        name,
        policy=mdm.policies.DeterministicPolicy(POLICY, 3),
        predicates=manager,
        states=[
            mdm.StateFactor("room", rooms),
            mdm.StateFactor("a", [f"{prefix}A"]),
            mdm.StateFactor("b", [f"{prefix}B"]),
        ],
        actions=dict.fromkeys(range(3), callback),
    )
    return ensemble, a, b


def team(
    path: Path, vectors: mdm.policies.AlphaVectors | Path, callback: Callback
) -> tuple[mdm.Ensemble, list[Callable[[], None]]]:
    """Return an event-driven POMDP ensemble, and functions that raise the events of one joint observation each."""
    model = mdm.load_model(path)
    assert isinstance(model, mdm.models.POMDP)
    policy = mdm.load_policy(vectors, model) if isinstance(vectors, Path) else vectors
    manager = mdm.PredicateManager(f"predicates-{path.stem}")
    factors = []
    for factor in model.observation_space.factors:
        events = [f"{factor.name}.{symbol}" for symbol in factor.names]
        for event in events:
            manager.event(event)
        factors.append(mdm.ObservationFactor(factor.name, events))

    def observe(index: int) -> Callable[[], None]:
        values = model.observation_space.unravel(index)
        events = tuple(factor.events[value] for factor, value in zip(factors, values, strict=True))
        return lambda: manager.occur(*events)

    ensemble = mdm.Ensemble(
        path.stem,
        policy=policy,
        model=model,
        predicates=manager,
        observations=factors,
        actions=dict.fromkeys(range(len(model.action_space.factors[0])), callback),
    )
    return ensemble, [observe(index) for index in range(len(model.observation_space))]


async def measure(
    cases: dict[str, Callable[[int], Awaitable[float] | float]], rounds: int, repeats: int
) -> dict[str, list[float]]:
    """Measure all cases in turn, round by round; each case returns one latency in seconds."""
    latencies: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds + 1):  # the first warms up
        for name, case in cases.items():
            gc.collect()
            found = []
            for index in range(repeats if name != "pykka actors" else max(10, repeats // 20)):
                latency = case(index)
                found.append(latency if isinstance(latency, float) else await latency)
            latencies[name].append(found)  # type: ignore[arg-type]
    return {name: [latency for each in found[1:] for latency in each] for name, found in latencies.items()}  # type: ignore[attr-defined]


def ours(sensor: mdm.Sensor, second: mdm.Sensor, batch: Callable[[], Any], callback: Callback) -> dict[str, Any]:
    """Return how our decisions on states are measured: by one sensor, and by two in a batch."""

    def by_one(index: int) -> float:
        began = now()
        sensor.set(index % 2 == 0)
        return callback.at - began

    def by_two(index: int) -> float:
        value = index % 2 == 0
        began = now()
        with batch():
            sensor.set(value)
            second.set(value)
        return callback.at - began

    return {"mdm: MDP, 12 states": by_one, "mdm: the same, a batch of two sensors": by_two}


def observing(events: list[Callable[[], None]], callback: Callback) -> Callable[[int], float]:
    """Return how a decision on an observation is measured."""

    def observe(index: int) -> float:
        event = events[0 if index % 3 else -1]
        began = now()
        event()
        return callback.at - began

    return observe


def others(callback: Callback) -> tuple[dict[str, Any], Callable[[], None]]:
    """Return how the rivals are measured, and what ends them."""
    tight, queues = Tight(POLICY, callback), Queues(POLICY, callback)
    direct, pykka = Direct(POLICY, callback), Pykka(POLICY, callback)
    tasks = [*tight.start(), *queues.start()]

    def awaiting(rival: Tight | Queues) -> Callable[[int], Awaitable[float]]:
        async def measured(index: int) -> float:
            began = now()
            await rival.decide(index % 2 == 0)
            return callback.at - began

        return measured

    def calling(rival: Direct | Pykka) -> Callable[[int], float]:
        def measured(index: int) -> float:
            began = now()
            rival.decide(index % 2 == 0)
            return callback.at - began

        return measured

    def end() -> None:
        pykka.stop()
        for task in tasks:
            task.cancel()

    cases: dict[str, Any] = {
        "asyncio tasks, as tight as can be": awaiting(tight),
        "asyncio.Queue tasks": awaiting(queues),
        "pykka actors": calling(pykka),
        "direct call": calling(direct),
    }
    return cases, end


async def compare(runtime: mdm.Runtime, rounds: int, repeats: int) -> list[dict[str, Any]]:
    """Measure one ensemble of each kind and the rivals."""
    callback = Callback()
    ensemble, sensor, second = robot_with_two("mdp", callback)
    await runtime.start(ensemble)
    assert ensemble.predicates is not None
    rivals, end = others(callback)
    # sure enough of the tiger's place to open a door, or listen: the vectors of a short plan
    short = mdm.policies.AlphaVectors([[-2.0, -2.0], [-50.0, 20.0], [20.0, -50.0]], [0, 4, 8], 9)
    dectiger, heard = team(HERE / "data" / "dectiger.dpomdp", short, callback)
    await runtime.start(dectiger)
    cases = {**ours(sensor, second, ensemble.predicates.batch, callback), **rivals}
    cases["mdm: dectiger"] = observing(heard, callback)
    grid = CORPUS / "models" / "madp" / "GridSmall.dpomdp"
    if grid.is_file():
        small, seen = team(grid, CORPUS / "values" / "GridSmall.dpomdp_0.9.vf", callback)
        await runtime.start(small)
        cases["mdm: GridSmall"] = observing(seen[:1], callback)
    else:
        print("GridSmall is skipped: the corpus of models is not beside this checkout")
    latencies = await measure(cases, rounds, repeats)
    end()
    base = quantiles(latencies["mdm: MDP, 12 states"])["median_us"]
    rows = [{"case": name, **quantiles(found)} for name, found in latencies.items()]
    return [{**row, "times mdm MDP": row["median_us"] / base} for row in rows]


async def crowd(runtime: mdm.Runtime, count: int, *, shared: bool) -> list[Callable[[bool], None]]:
    """Start so many ensembles, with predicate managers of their own or one for all; return their sensors."""
    manager = mdm.PredicateManager(f"shared-{count}") if shared else None
    callback = Callback()
    pairs = [robot(f"r{count}x{index}{'s' if shared else ''}", callback, manager) for index in range(count)]
    if manager is not None:
        await runtime.start(manager)
    for ensemble, _ in pairs:
        await runtime.start(ensemble)
    return [sensor.set for _, sensor in pairs]


async def scale(counts: list[int], rounds: int, repeats: int) -> list[dict[str, Any]]:
    """Measure a decision among 1, 10, … ensembles: mean processor time in a pass over all of them."""
    rows = []
    for shared in (False, True):
        async with mdm.Runtime(log=None) as runtime:
            sensors = {count: await crowd(runtime, count, shared=shared) for count in counts}
            costs: dict[int, list[float]] = {count: [] for count in sensors}
            for turn in range(rounds + 1):
                for count, setters in sensors.items():
                    passes = max(2, repeats // count // 2 * 2)
                    gc.collect()
                    began = time.process_time()
                    for index in range(passes):
                        value = index % 2 == 0
                        for setter in setters:
                            setter(value)
                    if turn:
                        costs[count].append((time.process_time() - began) / (passes * count))
        one = statistics.median(costs[1])
        rows += [
            {
                "ensembles": count,
                "predicates": "one manager for all" if shared else "a manager each",
                "processor us per decision": statistics.median(found) * 1e6,
                "times one": statistics.median(found) / one,
            }
            for count, found in costs.items()
        ]
    return rows


async def saturate(runtime: mdm.Runtime, count: int) -> list[dict[str, Any]]:
    """Publish from another thread as fast as it goes: what is received, replaced or dropped is counted, all of it."""
    callback = Callback()
    ensemble, sensor = robot("saturated", callback)
    await runtime.start(ensemble)
    states = runtime.channel("saturated/state", State, retain=True)
    stream, stated = states.stream(capacity=64), states.published
    done = asyncio.Event()
    loop = asyncio.get_running_loop()
    assert ensemble.predicates is not None
    sensed = runtime.channel(f"{ensemble.predicates.path}/sensed", SensorUpdate)
    counts = runtime.dispatcher.statistics
    replaced = counts().replaced
    before, first = sensed.published, ensemble.controller.epoch

    def flood() -> None:
        for index in range(count):
            sensor.set(index % 2 == 0)
        loop.call_soon_threadsafe(done.set)

    began = now()
    thread = threading.Thread(target=flood)
    thread.start()
    await done.wait()
    thread.join()
    seconds = now() - began
    taken = 0
    stream.end()
    async for _ in stream:
        taken += 1
    published, decided = sensed.published - before, ensemble.controller.epoch - first
    return [
        {
            "stimuli": count,
            "per second": count / seconds,
            "received": published,
            "decisions": decided,
            "replaced (counted)": counts().replaced - replaced,
            "lost": count - published - (counts().replaced - replaced),
            "states": states.published - stated,
            "stream took": taken,
            "stream dropped (counted)": stream.dropped,
        }
    ]


class Signalling(Callback):
    """Tells when it was called, also to a thread that waits for it."""

    def __init__(self) -> None:
        self.called = threading.Semaphore(0)

    def __call__(self) -> None:
        """Be the callback."""
        self.at = now()
        self.called.release()


async def from_threads(runtime: mdm.Runtime, rounds: int, repeats: int) -> list[dict[str, Any]]:
    """Measure what a thread's stimulus takes while the event loop waits, beside bare calls in the loop."""
    callback, bare = Signalling(), Signalling()
    ensemble, sensor = robot("threaded", callback)
    await runtime.start(ensemble)
    callback.called = threading.Semaphore(0)  # the start decides, too
    loop = asyncio.get_running_loop()
    cases: dict[str, tuple[Signalling, Callable[[int], object]]] = {
        "sensor set in a thread": (callback, lambda index: sensor.set(index % 2 == 0)),
        "set in the loop, by call_soon_threadsafe": (
            callback,
            lambda index: loop.call_soon_threadsafe(sensor.set, index % 2 == 0),
        ),
        "call_soon_threadsafe of a function alone": (bare, lambda _: loop.call_soon_threadsafe(bare)),
    }
    latencies: dict[str, list[float]] = {name: [] for name in cases}

    def measured(called: Signalling, stimulus: Callable[[int], object]) -> list[float]:
        found = []
        for index in range(repeats):
            began = now()
            stimulus(index)
            called.called.acquire()
            found.append(called.at - began)
            time.sleep(0.0005)  # as sensors do: a loop that is awake already would be no fair start
        return found

    for turn in range(rounds + 1):  # the first warms up
        for name, case in cases.items():
            found = await asyncio.to_thread(measured, *case)
            if turn:
                latencies[name] += found
    rows = [{"case": name, **quantiles(found)} for name, found in latencies.items()]
    return [{**row, "times the function alone": row["median_us"] / rows[-1]["median_us"]} for row in rows]


async def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    rounds, repeats = (1, 50) if given.quick else (10, 3000)
    async with mdm.Runtime(log=None) as runtime:
        compared = await compare(runtime, rounds, repeats)
        threaded = await from_threads(runtime, rounds, repeats // 5)
        saturated = await saturate(runtime, 1000 if given.quick else 100_000)
    scaled = await scale([1, 10] if given.quick else [1, 10, 100, 300, 1000], 1 if given.quick else 7, repeats * 2)
    table("Stimulus to first line of the callback", compared)
    table("The same from a thread, while the event loop waits", threaded)
    table("Many ensembles in one process", scaled)
    table("Saturation from another thread", saturated)
    results = {"latency": compared, "threads": threaded, "ensembles": scaled, "saturation": saturated}
    report("decision_latency", results, given.output)


if __name__ == "__main__":
    asyncio.run(main())
