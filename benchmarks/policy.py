"""How long it takes to choose an action by alpha vectors, for few and many vectors and states.

Beliefs give weight to 30 states at most. Against numpy as a user would write it, and pomdp_py's policy by alpha vectors
(where it is installed). Every way takes its turn in each of some rounds; the fastest round counts. All must choose the
same action.
"""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
from belief_rivals import has_pomdp_py
from measurement import arguments, report, table

import mdm
from mdm.beliefs import Support
from mdm.compilation import can_compile

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Vector = npt.NDArray[np.float64]

SIZES = ((5, 2), (100, 870), (1000, 870), (1000, 20_000))
NUMPY = "numpy, all states"


def choosers(vectors: Vector, support: Support) -> dict[str, Callable[[], int]]:
    """Return ways to choose at a belief; the action of each vector is its index."""
    count, size = vectors.shape
    belief = support.dense(size)
    actions = range(count)
    ways: dict[str, Callable[[], int]] = {}
    for name, fast in (("mdm, with numba", True), ("mdm, without numba", False)):
        if fast and not can_compile():
            continue
        with patch("mdm.policies.alpha_vectors.can_compile", return_value=fast):
            policy = mdm.policies.AlphaVectors(vectors, actions)
        ways[f"{name}, by array"] = lambda policy=policy: policy.action(belief)  # type: ignore[misc]
        ways[f"{name}, by support"] = lambda policy=policy: policy.action(support)  # type: ignore[misc]
    ways[NUMPY] = lambda: int((vectors @ belief).argmax())
    if has_pomdp_py() and count * size < 1_000_000:
        ways["pomdp_py"] = _pomdp_py(vectors, belief)
    return ways


def _pomdp_py(vectors: Vector, belief: Vector) -> Callable[[], int]:
    import pomdp_py  # noqa: PLC0415 - it may not be there
    from pomdp_py.utils.interfaces.conversion import AlphaVectorPolicy  # noqa: PLC0415

    policy = AlphaVectorPolicy([(row, action) for action, row in enumerate(vectors.tolist())], list(range(len(belief))))
    agent = SimpleNamespace(belief=pomdp_py.Histogram(dict(enumerate(belief.tolist()))))
    return lambda: int(policy.plan(agent))


def measure(ways: dict[str, Callable[[], int]], rounds: int, seconds: float) -> dict[str, float]:
    """Return how many seconds a choice takes in each way: the best of some rounds, in which each way has its turn."""
    first = next(iter(ways.values()))()
    counts = {}
    for name, way in ways.items():
        assert way() == first, f"{name} chooses another action"
        began = time.perf_counter()
        way()
        counts[name] = max(1, int(seconds / (time.perf_counter() - began)))
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            began = time.perf_counter()
            for _ in range(counts[name]):
                way()
            found[name].append((time.perf_counter() - began) / counts[name])
    return {name: min(each) for name, each in found.items()}


def compare(count: int, size: int, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Measure all ways for one number of vectors and states."""
    random = np.random.default_rng(count)
    states = random.permutation(size)[:30]
    support = Support(states, random.dirichlet(np.ones(len(states))))
    found = measure(choosers(random.normal(size=(count, size)), support), rounds, seconds)
    return [
        {"vectors": count, "states": size, "way": name, "us": took * 1e6, "times numpy": took / found[NUMPY]}
        for name, took in found.items()
    ]


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    rounds, seconds = (1, 0.001) if given.quick else (15, 0.05)
    rows = [row for sizes in SIZES[: 2 if given.quick else None] for row in compare(*sizes, rounds, seconds)]
    if not has_pomdp_py():
        print("pomdp_py is skipped: it is not installed")
    table("A choice by alpha vectors", rows)
    report("policy", {"choices": rows}, given.output)


if __name__ == "__main__":
    main()
