"""How long a belief update takes, for 2 to 1,000,000 states: dense, sparse, of small support, with false negatives.

Times are of one call of `BeliefTracker.update`, against the same update, normalised, with numpy and scipy as a user
would write it, with pomdp_py's histogram (where it is installed), and a loop in C over the same CSR data, compiled here
(where there is gcc), whose updates are all one call from Python. Every way takes its turn in each of some rounds; the
fastest round counts, for what else the machine does comes on top. All must come to the same belief.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import belief_rivals as rivals
import numpy as np
from measurement import arguments, report, table
from scipy import sparse

import mdm
from mdm.compilation import can_compile

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Vector = npt.NDArray[np.float64]

CORPUS = Path(__file__).resolve().parents[2] / "shared" / "corpus" / "models"
SECONDS = 0.2
ENTRIES = 7.8
NUMPY = "mdm, without numba"
FAST = "mdm, with numba"
C = "C loop"

THREADS = """
import numpy, timeit
for size in (100, 300, 1000):
    belief, matrix, out = numpy.ones(size), numpy.ones((size, size)), numpy.empty(size)
    print(min(timeit.repeat(lambda: belief.dot(matrix, out), number={calls}, repeat=10)) / {calls})
"""


def random_model(size: int, seed: int = 0) -> mdm.models.POMDP:
    """Return a model of one action, each state leading to some 7.8 random ones, and four observations."""
    random = np.random.default_rng(seed)
    lengths = np.minimum(size, random.poisson(ENTRIES - 1, size) + 1)
    rows = np.repeat(np.arange(size), lengths)
    return _model(rows, random.integers(size, size=len(rows)), size, random)


def rooms_model(size: int, room: int = 20, seed: int = 0) -> mdm.models.POMDP:
    """Return the like, but nobody leaves a room of 20 states, and it is known at first which room it is."""
    random = np.random.default_rng(seed)
    rows = np.repeat(np.arange(size), 8)
    start = np.zeros(size)
    first = size // 2 // room * room
    start[first : first + room] = 1 / room
    return _model(rows, rows // room * room + random.integers(room, size=len(rows)), size, random, start)


def _model(
    rows: Any, columns: Any, size: int, random: np.random.Generator, start: Vector | None = None
) -> mdm.models.POMDP:
    weights = random.random(len(rows)) + 0.1
    moves = sparse.csr_array((weights, (rows, columns)), shape=(size, size))
    moves.sum_duplicates()
    moves.data /= np.repeat(moves.sum(axis=1), np.diff(moves.indptr))
    told = random.random((size, 4)) + 0.1
    told /= told.sum(axis=1, keepdims=True)
    start = np.full(size, 1 / size) if start is None else start
    observations: list[Any] = [sparse.csr_array(told) if size > 2 else told]
    return mdm.models.POMDP(
        [moves], observations, np.zeros((size, 1)), discount=0.9, initial_belief=start, sparse=size > 2
    )


def trackers(model: mdm.models.POMDP) -> dict[str, mdm.BeliefTracker]:
    """Return trackers of the model, with numba where it is there, and without."""
    found = {FAST: mdm.BeliefTracker(model)} if can_compile() else {}
    with patch("mdm.beliefs.choice.can_compile", return_value=False):
        return found | {NUMPY: mdm.BeliefTracker(model)}


def tracked(tracker: mdm.BeliefTracker, action: int = 0, observation: int = 1) -> Callable[[int], Vector]:
    """Return what makes so many updates from the initial belief on."""

    def run(updates: int) -> Vector:
        tracker.reset()
        update = tracker.update
        for _ in range(updates):
            update(action, observation)
        return tracker.belief

    return run


def measure(ways: dict[str, Callable[[int], Vector]], rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Return how long an update takes in each way: the best of some rounds, in which each way has its turn."""
    beliefs = {name: way(3).copy() for name, way in ways.items()}
    first = next(iter(beliefs.values()))
    for name, belief in beliefs.items():
        assert np.abs(belief - first).max() < 1e-9, f"{name} comes to another belief"
    counts = {name: _count(way, seconds) for name, way in ways.items()}
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            # What it takes to begin and to end is paid in both, and so in neither.
            found[name].append((_timed(way, 1 + counts[name]) - _timed(way, 1)) / counts[name])
    return [{"way": name, "us": min(each) * 1e6} for name, each in found.items()]


def _timed(way: Callable[[int], Vector], updates: int) -> float:
    began = time.perf_counter()
    way(updates)
    return time.perf_counter() - began


def _count(way: Callable[[int], Vector], seconds: float) -> int:
    """Return how many updates take some time."""
    count = 1
    while _timed(way, 1 + count) - _timed(way, 1) < seconds / 3:
        count *= 3
    return count * 2


def compare(case: str, model: mdm.models.POMDP, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Measure one model in every way that is fit for its size."""
    size = len(model.state_space)
    rows = sparse.csr_array(model.transition_matrix(0))
    observations = model.observation_matrix(0)
    told = observations[:, 1] if isinstance(observations, np.ndarray) else observations[:, [1]].toarray().ravel()
    likelihood, start = np.ascontiguousarray(told), model.initial_belief
    columns = rows.T.tocsr()
    ways = {name: tracked(tracker) for name, tracker in trackers(model).items()}
    if size <= 1000:
        dense = rows.toarray()
        ways["numpy, dense"] = lambda updates: rivals.with_numpy(dense, likelihood, start, updates)
        if rivals.has_pomdp_py() and size <= 100:
            ways["pomdp_py"] = lambda updates: rivals.with_pomdp_py(dense, likelihood, start, updates)
    ways["scipy, CSR"] = lambda updates: rivals.with_scipy(columns, likelihood, start, updates)
    if rivals.has_compiler():
        loop = rivals.in_c_from_support(rows, likelihood) if "support" in case else rivals.in_c(columns, likelihood)
        ways[C] = lambda updates: loop(start, updates)
    return _rated(case, size, measure(ways, rounds, seconds))


def compare_false_negatives(path: Path, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Measure updates with false negatives of a real model of events, against solving for them each time."""
    model = mdm.load_model(path)
    size = len(model.state_space)
    missed, detected = (np.asarray(model.joint_matrix(0, observation)) for observation in (0, 1))

    def solved(updates: int) -> Vector:
        belief = model.initial_belief
        for _ in range(updates):
            belief = np.linalg.solve((np.eye(size) - missed).T, belief) @ detected
            belief /= belief.sum()
        return belief

    ways = {name: tracked(tracker) for name, tracker in trackers(model.with_false_negatives(0)).items()}
    return _rated(
        f"{path.stem}, false negatives",
        size,
        measure({**ways, "numpy, solving each time": solved}, rounds, seconds),
    )


def _rated(case: str, size: int, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    loops = [row["us"] for row in rows if row["way"] == C]
    rated = [{"case": case, "states": size, **row} for row in rows]
    return [{**row, "times the C loop": row["us"] / loops[0]} for row in rated] if loops else rated


def build(size: int) -> dict[str, Any]:
    """Return how long it takes to build a tracker, and how much memory it keeps."""
    model = rooms_model(size)
    before = _resident()
    began = time.perf_counter()
    tracker = mdm.BeliefTracker(model)
    seconds = time.perf_counter() - began
    tracker.update(0, 1)
    return {"states": size, "build_s": seconds, "memory_mb": _resident() - before}


def _resident() -> float:
    status = Path("/proc/self/status")
    if not status.is_file():
        return float("nan")
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def threads(calls: int) -> list[dict[str, Any]]:
    """Measure a dense product with all of BLAS's threads and with one."""
    rows = []
    for count in (os.cpu_count() or 1, 1):
        names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
        done = subprocess.run(
            [sys.executable, "-c", THREADS.format(calls=calls)],
            env=os.environ | dict.fromkeys(names, str(count)),
            capture_output=True,
            text=True,
            check=True,
        )
        for size, seconds in zip((100, 300, 1000), done.stdout.split(), strict=True):
            rows.append({"BLAS threads": count, "states": size, "product_us": float(seconds) * 1e6})
    return rows


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    rounds, seconds = (1, 0.005) if given.quick else (9, SECONDS)
    rows = []
    for size in (2, 100, 1000) if given.quick else (2, 100, 1000, 10_000, 100_000, 1_000_000):
        rows += compare("random", random_model(size), rounds, seconds)
    for size in (1000,) if given.quick else (1000, 100_000, 1_000_000):
        rows += compare("support of 20", rooms_model(size), rounds, seconds)
    patrol = CORPUS / "madp" / "MAISS_Patrol_Single.pgmx"
    if patrol.is_file():
        rows += compare_false_negatives(patrol, rounds, seconds)
    else:
        print("MAISS_Patrol_Single is skipped: the corpus of models is not beside this checkout")
    if not rivals.has_pomdp_py():
        print("pomdp_py is skipped: it is not installed")
    if not rivals.has_compiler():
        print("the C loop is skipped: there is no gcc")
    built, pinned = [build(1000 if given.quick else 1_000_000)], threads(5 if given.quick else 200)
    table("One belief update", rows)
    table("Building a tracker", built)
    table("A dense product, by numpy", pinned)
    report("belief", {"updates": rows, "build": built, "threads": pinned}, given.output)


if __name__ == "__main__":
    main()
