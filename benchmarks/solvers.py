"""How long solvers take: MDPs against quantecon and scipy, to the same accuracy of the values.

Ours are measured with all that they build; quantecon's problem is built beforehand.
"""

from __future__ import annotations

import resource
import statistics
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from measurement import arguments, report, table

import mdm
from mdm.compilation import can_compile
from mdm.solvers import solve

if TYPE_CHECKING:
    from collections.abc import Callable

GAP = 1e-3
"""How far all values may be from the optimal ones: quantecon's epsilon, and the gap of our bounds."""
DISCOUNT = 0.95
SOLVERS = ("value-iteration", "prioritised-sweeping", "policy-iteration", "modified-policy-iteration")


def forest(size: int) -> mdm.models.MDP:
    """Return pymdptoolbox's forest: wait, at a risk of fire, for old trees; or cut."""
    ages = np.arange(size)
    fire, older = np.zeros(size, dtype=int), np.minimum(ages + 1, size - 1)
    wait = _matrix(size, [(0.1, fire), (0.9, older)])
    rewards = np.zeros((size, 2))
    rewards[1:, 1] = 1
    rewards[-1] = 4, 2
    return mdm.models.MDP([wait, _matrix(size, [(1.0, fire)])], rewards, discount=DISCOUNT, sparse=True)


def grid(side: int) -> mdm.models.MDP:
    """Return a walk on a grid: steps slip sideways, each costs, some places more; the last corner pays."""
    size = side * side
    rows, columns = np.divmod(np.arange(size), side)
    north, south = np.maximum(rows - 1, 0), np.minimum(rows + 1, side - 1)
    west, east = np.maximum(columns - 1, 0), np.minimum(columns + 1, side - 1)
    ways = [north * side + columns, rows * side + east, south * side + columns, rows * side + west]
    matrices = [_matrix(size, [(0.8, ways[way]), (0.1, ways[way - 1]), (0.1, ways[(way + 1) % 4])]) for way in range(4)]
    rewards = np.full((size, 4), -1.0)
    rewards[np.random.default_rng(0).random(size) < 0.1] -= 5
    rewards[-1] = 10
    return mdm.models.MDP(matrices, rewards, discount=DISCOUNT, sparse=True)


def _matrix(size: int, parts: list[tuple[float, Any]]) -> Any:
    """Return transitions, of pairs of a probability and where it leads to."""
    data = np.concatenate([np.full(size, chance) for chance, _ in parts])
    rows = np.tile(np.arange(size), len(parts))
    return sp.coo_array((data, (rows, np.concatenate([to for _, to in parts]))), shape=(size, size)).tocsr()


def stacked(model: mdm.models.MDP) -> Any:
    """Return P(s' | s, a) as one CSR matrix, row s A + a."""
    count = len(model.action_space)
    size = len(model.state_space)
    matrix = sp.vstack([model.transition_matrix(action) for action in range(count)]).tocsr()
    return sp.csr_matrix(matrix[(np.arange(size)[:, None] + size * np.arange(count)).ravel()])


def scipys(model: mdm.models.MDP) -> Callable[[], Any]:
    """Return value iteration as a user would write it: a product and a maximum, until nothing changes."""
    matrix, rewards = stacked(model), model.rewards
    limit = GAP * (1 - model.discount) / (2 * model.discount)

    def run() -> Any:
        values = np.zeros(len(rewards))
        while True:
            backed = (rewards + model.discount * (matrix @ values).reshape(rewards.shape)).max(axis=1)
            if np.abs(backed - values).max() < limit:
                return backed
            values = backed

    return run


def quantecons(model: mdm.models.MDP) -> dict[str, Callable[[], Any]]:
    """Return the ways of quantecon, if it is installed; its problem is built beforehand."""
    try:
        from quantecon.markov import DiscreteDP  # noqa: PLC0415 - not everybody has it
    except ImportError:
        print("quantecon is not installed: skipped (pip install quantecon)")
        return {}
    size, count = model.rewards.shape
    states, actions = np.repeat(np.arange(size), count), np.tile(np.arange(count), size)
    problem = DiscreteDP(model.rewards.ravel().copy(), stacked(model), model.discount, states, actions)
    return {
        f"quantecon: {method.replace('_', ' ')}": lambda method=method: (
            problem.solve(method=method, epsilon=GAP, max_iter=100_000).v
        )
        for method in ("value_iteration", "modified_policy_iteration")
    }


def ours(model: mdm.models.MDP, solver: str) -> Any:
    """Return the values that one of our solvers finds, everything that it builds included."""
    return solve(model, solver, gap=GAP).policy.values.max(axis=1)


def mdp_rows(
    name: str, model: mdm.models.MDP, solvers: tuple[str, ...], rounds: int, *, rivals: bool = True
) -> list[dict[str, Any]]:
    """Measure ways to solve an MDP, in rounds, after one to warm up: what is compiled is compiled then."""
    ways: dict[str, Callable[[], Any]] = (
        {"scipy: value iteration": scipys(model), **quantecons(model)} if rivals else {}
    )
    for solver in solvers:
        ways[f"mdm: {solver}"] = lambda solver=solver: ours(model, solver)
    best = solve(model, gap=1e-8).policy.values.max(axis=1)
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    errors = {}
    for turn in range(rounds + 1):
        for way, run in ways.items():
            began = time.perf_counter()
            values = run()
            if turn:
                seconds[way].append(time.perf_counter() - began)
            errors[way] = float(np.abs(values - best).max())
    rival = min((statistics.median(found) for way, found in seconds.items() if "quantecon" in way), default=None)
    rows = []
    for way, found in seconds.items():
        row = {
            "problem": name,
            "states": len(best),
            "way": way,
            "median_ms": statistics.median(found) * 1e3,
            "least_ms": min(found) * 1e3,
            "error": f"{errors[way]:.1e}",
        }
        if rival is not None:
            row["times quantecon's best"] = statistics.median(found) / rival
        rows.append(row)
    return rows


def mdps(*, quick: bool) -> list[dict[str, Any]]:
    """Measure the forest, the grid, and a million states."""
    swept = tuple(solver for solver in SOLVERS if solver != "policy-iteration")
    return [
        *mdp_rows("forest", forest(50 if quick else 1000), SOLVERS, 2 if quick else 31),
        # A far reward takes policy iteration as many sparse solutions as the way is long, quantecon's too.
        *mdp_rows("grid", grid(8 if quick else 316), swept, 1 if quick else 7),
        *mdp_rows("large grid", grid(10 if quick else 1000), SOLVERS[-1:], 1, rivals=False),
    ]


def main() -> None:
    """Measure, print and write."""
    given = arguments(__doc__ or "")
    results = {"mdps": mdps(quick=given.quick), "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}
    compiled = "compiled in a round that does not count" if can_compile() else "not compiled"
    table(f"MDPs, all values within {GAP}; kernels are {compiled}", results["mdps"])
    report("solvers", results, given.output)


if __name__ == "__main__":
    main()
