"""What least and greatest numbers of decision processes take of a processor and of memory, in turn with Storm.

Grids whose steps slip, with pits, and random processes, with end components and without. Both are asked for the same
numbers with an error of at most 1e-8 (relative, of numbers of steps), in turn: Storm for the least and for the greatest
number, `mdm.verify` for both at once, with policies that attain them. Models are built and kernels compiled before.
Memory is the most that a question needs beyond what its process holds.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from measurement import memory_now, memory_peak, parser, report, table

import mdm

if TYPE_CHECKING:
    from collections.abc import Callable

QUESTIONS = {
    "P(reach x* before y*)": '!"y" U "x"',
    "P(reach x* within 50)": 'F<=50 "x"',
    "E(steps until x* or y*)": 'F "x"|"y"',
}


def pits(size: int) -> tuple[list[Any], Any, Any]:
    """Return the transitions of a walk on a grid whose steps slip any way, an eighth of it pits and goals."""
    side = math.isqrt(size)
    rows, columns = np.divmod(np.arange(side * side), side)
    ways = [
        np.clip(rows + down, 0, side - 1) * side + np.clip(columns + right, 0, side - 1)
        for down, right in ((-1, 0), (0, 1), (1, 0), (0, -1))
    ]
    chosen = np.random.default_rng(1).permutation(side * side)[: side * side // 8]
    moved = [sp.csr_array((np.ones(len(way)), (np.arange(len(way)), way)), shape=(len(way),) * 2) for way in ways]
    matrices = [sp.csr_array(0.4 * each + 0.15 * sum(moved)) for each in moved]
    return matrices, chosen[len(chosen) // 4 :], chosen[: len(chosen) // 4]


def tangle(size: int, leaves: float = 0.0) -> tuple[list[Any], Any, Any]:
    """Return the transitions of a random process of three actions with three successors each, goals and traps."""
    random = np.random.default_rng(2)
    chosen = random.permutation(size)[: size // 50]
    matrices = []
    for _ in range(3):
        rows = np.repeat(np.arange(size), 3)
        chances = random.dirichlet(np.ones(3), size=size).ravel()
        matrices.append(sp.csr_array((chances, (rows, random.integers(0, size, 3 * size))), shape=(size, size)))
    out = sp.csr_array((np.ones(size), (np.arange(size), random.choice(chosen, size))), shape=(size, size))
    return [sp.csr_array((1 - leaves) * each + leaves * out) for each in matrices], chosen[::2], chosen[1::2]


def leaving(size: int) -> tuple[list[Any], Any, Any]:
    """Return the same where each step may end in a goal or a trap."""
    return tangle(size, 0.002)


SLOW = 10_000
"""The states of a grid up to which the most steps are asked for: beyond, they take minutes with either."""
MODELS = (("grid", pits), ("random", leaving), ("random, which may go on for ever", tangle))


def built(size: int, made: Callable[[int], tuple[list[Any], Any, Any]], path: Path) -> tuple[mdm.MDP, int]:
    """Return a model and its first state, and write the same as arrays."""
    matrices, reached, avoided = made(size)
    size = matrices[0].shape[0]
    stays = np.zeros(size)
    stays[reached] = stays[avoided] = 1
    matrices = [sp.csr_array(sp.diags_array(1 - stays) @ each + sp.diags_array(stays)) for each in matrices]
    for each in matrices:
        each.eliminate_zeros()
    start = int(np.flatnonzero(stays == 0)[0])
    names = np.char.add("o", np.arange(size).astype(str))
    names[reached] = np.char.replace(names[reached], "o", "x")
    names[avoided] = np.char.replace(names[avoided], "o", "y")
    count = len(matrices)
    rows = sp.vstack(matrices, format="csr")[np.arange(size * count).reshape(count, size).T.ravel()]
    rows.sort_indices()
    np.savez(
        path,
        firsts=np.arange(size + 1) * count,
        starts=rows.indptr,
        columns=rows.indices,
        chances=rows.data,
        x=reached,
        y=avoided,
    )
    options: Any = {"states": names.tolist(), "initial_belief": np.eye(1, size, start)[0]}
    return mdm.MDP(matrices, np.zeros((size, count)), discount=0.9, sparse=True, **options), start


def ours(model: mdm.MDP, text: str) -> dict[str, Any]:
    """Return our numbers of a question, and what they took."""
    before, began = memory_now(), time.process_time()
    answer = mdm.verify(model, text)
    took = time.process_time() - began
    least, greatest = answer.least, answer.greatest
    assert least is not None
    assert greatest is not None
    numbers = {"values": [least.value, greatest.value], "error": max(least.error, greatest.error)}
    return numbers | {"seconds": took, "bytes": memory_peak() - before}


def theirs(storm: Any, text: str, start: int) -> dict[str, Any]:
    """Return Storm's."""
    answers = []
    for end in ("min", "max"):
        kind = f'R{{"steps"}}{end}' if text.startswith("E") else f"P{end}"
        storm.stdin.write(json.dumps([f"{kind}=? [{QUESTIONS[text]}]", start]) + "\n")
        storm.stdin.flush()
        answers.append(json.loads(storm.stdout.readline()))
    least, greatest = answers
    return {
        "values": [least["value"], greatest["value"]],
        "seconds": least["seconds"] + greatest["seconds"],
        "bytes": max(least["bytes"], greatest["bytes"]),
    }


def measured(
    name: str, size: int, made: Callable[[int], tuple[list[Any], Any, Any]], python: str | None, rounds: int
) -> list[dict[str, Any]]:
    """Return a row for each question about a model."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.npz"
        model, start = built(size, made, path)
        storm = None
        if python is not None:
            command = [python, str(Path(__file__).with_name("verification_storm.py")), str(path)]
            storm = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            assert storm.stdout is not None
            storm.stdout.readline()
        for text in QUESTIONS:
            if made is pits and text.startswith("E") and size > SLOW:
                continue
            mine, its = [], []
            for _ in range(rounds):
                mine.append(ours(model, text))
                if storm is not None:
                    its.append(theirs(storm, text, start))
            row: dict[str, Any] = {"model": name, "states": len(model.state_space), "question": text}
            row |= {"least": mine[0]["values"][0], "greatest": mine[0]["values"][1], "error": f"{mine[0]['error']:.0e}"}
            row["seconds"] = seconds = statistics.median(each["seconds"] for each in mine)
            row["MB"] = mine[0]["bytes"] / 1e6
            if its:
                theirs_ = statistics.median(each["seconds"] for each in its)
                pairs = zip(mine[0]["values"], its[0]["values"], strict=True)
                apart = max((abs(one - two) for one, two in pairs if one != two), default=0.0)
                row |= {"Storm's": theirs_, "its MB": its[0]["bytes"] / 1e6, "ratio": seconds / theirs_}
                row |= {"apart": f"{apart:.0e}"}
            rows.append(row)
        if storm is not None:
            storm.communicate()
    return rows


def main() -> None:
    """Run the benchmark."""
    its = parser(__doc__ or "")
    its.add_argument("--storm", metavar="PYTHON", help="an interpreter that has stormpy (MDM_STORM_PYTHON)")
    its.add_argument("--sizes", type=int, nargs="+", default=[10_000, 100_000, 1_000_000], help="numbers of states")
    given = its.parse_args()
    python = given.storm or os.environ.get("MDM_STORM_PYTHON")
    if python is None:
        print("Storm is not measured: no interpreter has it (--storm)")
    sizes, rounds = ([900], 1) if given.quick else (given.sizes, 3)
    with tempfile.TemporaryDirectory() as folder:
        for _, made in MODELS:
            model, _ = built(sizes[0] if given.quick else 10_000, made, Path(folder) / "warm.npz")
            for text in QUESTIONS:
                mdm.verify(model, text)
    rows = []
    for size in sizes:
        for name, made in MODELS:
            rows += measured(name, size, made, python, rounds if size < 100_000 else 1)
    table("Least and greatest numbers, in seconds of a processor", rows)
    report("verification", {"rows": rows}, given.output)


if __name__ == "__main__":
    main()
