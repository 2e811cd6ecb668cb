"""From a pose to a place: the look-up in bytes against rays cast at polygons; what a pose and a change cost in all."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import arguments, quantiles, report, table

import mdm
from mdm.maps import Frame, Labels, PlaceBelief, Places
from mdm.maps.raster import lookup
from mdm.messages import ParticleUpdate
from mdm.models import POMDP, Factor, Space

if TYPE_CHECKING:
    from collections.abc import Callable

SIDE = 0.05
ROOMS = [
    (column * 7.0 + 0.1, row * 9.0 + 0.1, column * 7.0 + 6.9, row * 9.0 + 8.9) for row in (0, 1) for column in range(3)
]
NAMES = tuple(f"room{number}" for number in range(6))


def floor(yaw: float = 0.0) -> Labels:
    """Six rooms of 440 x 360 cells."""
    raster = np.zeros((360, 440), dtype=np.uint16)
    frame = Frame(360, 440, SIDE, yaw=yaw)
    x, y = Frame(360, 440, SIDE).centres()
    for label, (left, low, right, high) in enumerate(ROOMS, 1):
        raster[(x >= left) & (x < right) & (y >= low) & (y < high)] = label
    return Labels(frame, raster, NAMES)


def ray_casting() -> Callable[[float, float], int]:
    """Which of the rooms, as polygons, a point lies in: the number of sides right of it is odd."""
    polygons = []
    for left, low, right, high in ROOMS:
        corners = [(left, low), (right, low), (right, high), (left, high)]
        polygons.append(list(zip(corners, [*corners[1:], corners[0]], strict=True)))

    def look_up(x: float, y: float) -> int:
        for label, sides in enumerate(polygons, 1):
            inside = False
            for (ax, ay), (bx, by) in sides:
                if (ay > y) != (by > y) and x < (bx - ax) * (y - ay) / (by - ay) + ax:
                    inside = not inside
            if inside:
                return label
        return 0

    return look_up


def array_index(labels: Labels) -> Callable[[float, float], int]:
    """Look into numpy's array, as one would write it."""
    frame, raster = labels.frame, labels.raster

    def look_up(x: float, y: float) -> int:
        cell = frame.cell(x, y)
        return 0 if cell is None else int(raster[cell])

    return look_up


def each(look_up: Callable[[float, float], int], points: list[tuple[float, float]], rounds: int) -> dict[str, float]:
    """Return the time of a call, by rounds over all points."""
    seconds = []
    for _ in range(rounds):
        began = time.perf_counter()
        for x, y in points:
            look_up(x, y)
        seconds.append((time.perf_counter() - began) / len(points))
    return {key: value for key, value in quantiles(seconds).items() if key != "p99_us"}


def lookups(quick: bool) -> list[dict[str, Any]]:
    """Measure the ways to look a point up, in rounds of a few milliseconds."""
    random = np.random.default_rng(1)
    points = [(float(x), float(y)) for x, y in random.uniform((0, 0), (21.0, 18.0), size=(1000, 2))]
    ways = {
        "bytes": lookup(floor(), 0.3),
        "bytes, turned": lookup(floor(0.3), 0.3),
        "numpy's array": array_index(floor()),
        "ray casting, 6 rectangles": ray_casting(),
    }
    rows = [{"way": name, **each(way, points, 3 if quick else 200)} for name, way in ways.items()]
    base = rows[0]["median_us"]
    return [{**row, "times bytes": row["median_us"] / base} for row in rows]


def poses(quick: bool) -> list[dict[str, Any]]:
    """Measure a pose from `see` to its end: in the same room, and from one room to the other."""
    rows: list[dict[str, Any]] = []

    async def main() -> None:
        predicates = mdm.PredicateManager()
        places = Places(floor(), predicates)
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(places)
            same, other = mdm.maps.Pose(3.0, 3.0), mdm.maps.Pose(10.0, 3.0)
            for name, pair in {"in the same room": (same, same), "to another room": (same, other)}.items():
                seconds = []
                for number in range(100 if quick else 10_000):
                    began = time.perf_counter()
                    places.see(pair[number % 2])
                    seconds.append(time.perf_counter() - began)
                rows.append({"a pose": name, **quantiles(seconds)})

    mdm.run(main)
    return rows


def particles(quick: bool) -> list[dict[str, Any]]:
    """Measure 2,000 particles to a belief over rooms."""
    space = Space([Factor("position", NAMES)])
    model = POMDP([np.eye(6)], [np.ones((6, 1))], np.zeros((6, 1)), discount=0.9, states=space, actions=["Look"])
    policy = mdm.policies.AlphaVectors(np.zeros((1, 6)), [0])
    ensemble = mdm.Ensemble("robot", policy=policy, model=model, actions={"Look": lambda: None})
    place_belief = PlaceBelief(floor(), ensemble)
    random = np.random.default_rng(1)
    x, y = random.normal((7.0, 9.0), 0.5, size=(2000, 2)).T.copy()
    rows = []
    for name, weights in {"equal": None, "weighted": random.random(2000)}.items():
        update = ParticleUpdate(0, x, y, weights)
        seconds = []
        for _ in range(20 if quick else 5000):
            began = time.perf_counter()
            place_belief._places(update)  # noqa: SLF001 - what a set costs besides its message
            seconds.append(time.perf_counter() - began)
        rows.append({"2,000 particles": name, **quantiles(seconds)})
    return rows


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    results = {"lookups": lookups(given.quick), "poses": poses(given.quick), "particles": particles(given.quick)}
    table("From a point to its place", results["lookups"])
    table("A pose, to the end of what it brings about", results["poses"])
    table("Particles to a belief over places", results["particles"])
    report("places", results, given.output)


if __name__ == "__main__":
    main()
