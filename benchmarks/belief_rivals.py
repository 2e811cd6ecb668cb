"""Belief updates as others write them: with numpy, with scipy, with pomdp_py, and as a loop in C.

Each is a function of an action's T and P(o | s') of the observation that is made: it makes so many updates, each
normalised, on from a belief, and returns the last. Those in C get their arrays ready beforehand.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Vector = npt.NDArray[np.float64]

__all__ = ["has_compiler", "has_pomdp_py", "in_c", "in_c_from_support", "with_numpy", "with_pomdp_py", "with_scipy"]

SOURCE = """
#include <string.h>

/* Rows of T transposed: pull the weights that reach each state. */
void pull(long updates, int size, const int *starts, const int *sources, const double *weights,
          const double *likelihood, double *before, double *after) {
    while (updates--) {
        double total = 0;
        for (int t = 0; t < size; t++) {
            double value = 0;
            for (int entry = starts[t]; entry < starts[t + 1]; entry++)
                value += weights[entry] * before[sources[entry]];
            after[t] = value * likelihood[t];
            total += after[t];
        }
        double scale = 1 / total;
        for (int t = 0; t < size; t++) after[t] *= scale;
        double *swap = before; before = after; after = swap;
    }
}

/* Rows of T: push the weight of each state of the support along. */
int push(long updates, int count, const int *starts, const int *targets, const double *weights,
         const double *likelihood, double *sums, int *before, double *values, int *after, double *next) {
    while (updates--) {
        int reached = 0;
        for (int i = 0; i < count; i++)
            for (int entry = starts[before[i]]; entry < starts[before[i] + 1]; entry++) {
                int target = targets[entry];
                if (sums[target] == 0) after[reached++] = target;
                sums[target] += values[i] * weights[entry];
            }
        double total = 0;
        for (int i = 0; i < reached; i++) {
            next[i] = sums[after[i]] * likelihood[after[i]];
            sums[after[i]] = 0;
            total += next[i];
        }
        double scale = 1 / total;
        for (int i = 0; i < reached; i++) next[i] *= scale;
        count = reached;
        int *swap = before; before = after; after = swap;
        double *other = values; values = next; next = other;
    }
    return count;
}
"""


def with_numpy(transition: Vector, likelihood: Vector, belief: Vector, updates: int) -> Vector:
    """Update with dense arrays."""
    for _ in range(updates):
        belief = belief @ transition * likelihood
        belief /= belief.sum()
    return belief


def with_scipy(transposed: Any, likelihood: Vector, belief: Vector, updates: int) -> Vector:
    """Update with T transposed, in CSR."""
    for _ in range(updates):
        belief = transposed @ belief * likelihood
        belief /= belief.sum()
    return belief


def has_compiler() -> bool:
    """Whether there is gcc."""
    return shutil.which("gcc") is not None


@cache
def _library() -> ctypes.CDLL:
    folder = Path(tempfile.mkdtemp())
    (folder / "belief.c").write_text(SOURCE)
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", "belief.so", "belief.c"]
    subprocess.run(command, check=True, cwd=folder)
    library = ctypes.CDLL(str(folder / "belief.so"))
    shutil.rmtree(folder)
    return library


def _pointer(array: npt.NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def in_c(transposed: Any, likelihood: Vector) -> Callable[[Vector, int], Vector]:
    """Return what updates in C, with T transposed in CSR; all updates are one call."""
    starts, sources = transposed.indptr.astype(np.int32), transposed.indices.astype(np.int32)
    both = [np.zeros(len(likelihood)) for _ in range(2)]

    def update(belief: Vector, updates: int) -> Vector:
        both[0][:] = belief
        arrays = [starts, sources, transposed.data, likelihood, *both]
        _library().pull(ctypes.c_long(updates), len(belief), *map(_pointer, arrays))
        return both[updates % 2]

    return update


def in_c_from_support(transition: Any, likelihood: Vector) -> Callable[[Vector, int], Vector]:
    """Return what updates in C from the belief's support, with T in CSR; all updates are one call."""
    size = len(likelihood)
    starts, targets = transition.indptr.astype(np.int32), transition.indices.astype(np.int32)
    states, values = [np.zeros(size, np.int32) for _ in range(2)], [np.zeros(size) for _ in range(2)]
    sums, result = np.zeros(size), np.zeros(size)

    def update(belief: Vector, updates: int) -> Vector:
        (support,) = belief.nonzero()
        states[0][: len(support)], values[0][: len(support)] = support, belief[support]
        arrays = [starts, targets, transition.data, likelihood, sums, states[0], values[0], states[1], values[1]]
        count = _library().push(ctypes.c_long(updates), len(support), *map(_pointer, arrays))
        last = updates % 2
        result[:] = 0
        result[states[last][:count]] = values[last][:count]
        return result

    return update


def has_pomdp_py() -> bool:
    """Whether pomdp_py is installed."""
    return find_spec("pomdp_py") is not None


def with_pomdp_py(transition: Vector, likelihood: Vector, belief: Vector, updates: int) -> Vector:
    """Update a histogram of pomdp_py's; its models look numbers up in lists."""
    import pomdp_py  # noqa: PLC0415 - it may not be there

    class Transitions(pomdp_py.TransitionModel):  # type: ignore[misc]
        def probability(self, next_state: int, state: int, _: Any) -> float:
            return rows[state][next_state]

    class Observations(pomdp_py.ObservationModel):  # type: ignore[misc]
        def probability(self, _: Any, next_state: int, __: Any) -> float:
            return chances[next_state]

    rows, chances = transition.tolist(), likelihood.tolist()
    histogram = pomdp_py.Histogram(dict(enumerate(belief.tolist())))
    transitions, observations = Transitions(), Observations()
    for _ in range(updates):
        histogram = pomdp_py.update_histogram_belief(histogram, 0, 0, observations, transitions)
    return np.array([histogram[state] for state in range(len(belief))])
