"""How long models take to read, and how much memory: real files and generated ones, against plain readers.

Each file is read in processes of its own. Memory is the most that such a process held beyond what it did after
importing mdm and scipy. The plain reader takes a Cassandra file line by line and puts explicit entries into nested
dictionaries; of XML files it makes the tree of Python's ElementTree, and no model.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measurement import arguments, report, table
from scipy import sparse

import mdm

CORPUS = Path(__file__).resolve().parents[2] / "shared" / "corpus" / "models"
LARGE = 60_000  # bytes
TIMEOUT = 900

MEASURE = """
import json, sys, time, warnings
def peak():  # what getrusage says counts the process that started this one
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
warnings.simplefilter("ignore")
import mdm, scipy.sparse
before = peak()
began = time.perf_counter()
model = mdm.load_model(sys.argv[1])
read = time.perf_counter() - began
model = model.flatten()
whole = time.perf_counter() - began
after = peak()
actions = range(len(model.action_space))
def entries(matrix):
    return int(matrix.nnz) if hasattr(matrix, "nnz") else int((matrix != 0).sum())
count = sum(entries(model.transition_matrix(a)) for a in actions)
print(json.dumps({"read": read, "whole": whole, "memory": (after - before) / 1024, "entries": count}))
"""

PLAIN = """
import gzip, sys, time
began = time.perf_counter()
path = sys.argv[1]
opened = gzip.open if path.endswith(".gz") else open
if "pgmx" in path or "pomdpx" in path:
    import xml.etree.ElementTree as tree
    with opened(path, "rb") as file:
        tree.parse(file)
else:
    tables = {"T": {}, "O": {}, "R": {}}
    with opened(path, "rt", encoding="latin-1") as file:
        for line in file:
            line = line.split("#")[0].strip()
            if line[:2] not in {"T:", "O:", "R:"}:
                line.split()
                continue
            *fields, last = line[2:].split(":")
            words = last.split()
            if len(words) == 2:
                fields.append(words[0])
            table = tables[line[0]]
            for field in fields[:-1]:
                table = table.setdefault(field.strip(), {})
            if fields:
                table[fields[-1].strip()] = float(words[-1]) if words and words[-1][0] in "0123456789.-" else words
print(time.perf_counter() - began)
"""


def measured(path: Path, rounds: int) -> dict[str, Any]:
    """Return the medians of reading a file, and of the plain reader."""
    runs = [json.loads(_run(MEASURE, path)) for _ in range(rounds)]
    plain = None
    if path.suffix not in {".npz", ".base"}:
        plain = float(np.median([float(_run(PLAIN, path)) for _ in range(rounds)]))
    whole = float(np.median([run["whole"] for run in runs]))
    return {
        "file": path.name,
        "kB": path.stat().st_size / 1e3,
        "entries of T": runs[0]["entries"],
        "read_s": float(np.median([run["read"] for run in runs])),
        "with matrices_s": whole,
        "peak_MB": float(np.median([run["memory"] for run in runs])),
        "plain_s": plain,
        "times plain": None if plain is None else whole / plain,
    }


def _run(program: str, path: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], check=True, capture_output=True, text=True, timeout=TIMEOUT
    )
    return done.stdout


def generated(folder: Path, states: int, successors: int) -> list[Path]:
    """Write a random POMDP with 2 x states x successors entries of T in several formats; return the files."""
    random = np.random.default_rng(0)
    matrices = []
    for _ in range(2):
        columns = np.sort(np.argsort(random.random((states, min(states, 4 * successors))))[:, :successors])
        columns = (columns + np.arange(states)[:, None]) % states
        values = random.dirichlet(np.ones(successors), size=states)
        rows = np.repeat(np.arange(states), successors)
        matrices.append(sparse.csr_array((values.ravel(), (rows, columns.ravel())), shape=(states, states)))
    observations = random.dirichlet(np.ones(3), size=states)
    rewards = random.random((states, 2))
    model = mdm.models.POMDP(matrices, [observations] * 2, rewards, discount=0.95, sparse=True)
    paths = [folder / f"generated-{states}.{suffix}" for suffix in ("pomdp", "pomdp.gz", "npz")]
    if states <= 2_000:
        paths += [folder / f"generated-{states}.{suffix}" for suffix in ("pomdpx", "pgmx")]
    for path in paths:
        mdm.save_model(model, path)
    return paths


def main() -> None:
    """Measure; print and write."""
    given = arguments(__doc__ or "")
    rounds = 1 if given.quick else 3
    with tempfile.TemporaryDirectory() as name:
        sizes = [(50, 4)] if given.quick else [(2_000, 50), (100_000, 5)]
        files = [path for states, successors in sizes for path in generated(Path(name), states, successors)]
        if not given.quick and CORPUS.is_dir():
            files += sorted(path for path in CORPUS.rglob("*") if _is_large(path))
        elif not CORPUS.is_dir():
            print("the corpus of real models is not beside this checkout: only generated files are read")
        rows = [measured(path, rounds) for path in files]
    table("Reading models", rows)
    report("parse", {"parse": rows}, given.output)


def _is_large(path: Path) -> bool:
    if path.suffix == ".base":
        return True
    suffixes = {".pomdp", ".mdp", ".dpomdp", ".pgmx", ".pomdpx"}
    known = path.suffix.lower() in suffixes or (path.suffix == ".gz" and Path(path.stem).suffix.lower() in suffixes)
    return known and path.is_file() and path.stat().st_size > (LARGE / 8 if path.suffix == ".gz" else LARGE)


if __name__ == "__main__":
    main()
