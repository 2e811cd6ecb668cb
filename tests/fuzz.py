"""Readers on mutated files: every outcome is a model, a policy or a `FormatError`, in time and within memory.

``python tests/fuzz.py --inputs 100000`` takes some minutes; the tests of the formats do the same on a small scale.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

from mutation import mutated
from places import ROOT

import mdm

FOLDERS = (ROOT / "tests" / "data", ROOT / "examples", ROOT.parent / "shared" / "corpus")
MODELS = {".pomdp", ".mdp", ".dpomdp", ".pgmx", ".pomdpx"}
POLICIES = {".vf", ".alpha", ".pg", ".policy", ".policyx", ".txt"}
LARGEST = 30_000
SECONDS = 20
SLOW = 3
MEMORY = 4 << 30
NUMBERS = ["1e999", "nan", "-1", "0", "7"]
PIECES = [*NUMBERS, "-", "*", ":", "#", "\n", " ", "<", ">", "é", "&x;", "T:", "R:", "uniform", "identity"]


def seeds() -> list[Path]:
    """Return the files that are mutated."""
    found = (path for folder in FOLDERS if folder.is_dir() for path in sorted(folder.rglob("*")))
    return [
        path
        for path in found
        if path.is_file() and path.suffix.lower() in MODELS | POLICIES and 0 < path.stat().st_size <= LARGEST
    ]


def spoilt(path: Path, chance: random.Random) -> bytes:
    """Return a file's bytes with some of them changed."""
    data = path.read_bytes()
    if chance.random() < 0.3:
        spoilt_bytes = bytearray(data)
        for _ in range(chance.randint(1, 6)):
            spoilt_bytes[chance.randrange(len(spoilt_bytes))] = chance.randrange(256)
        return bytes(spoilt_bytes)
    lines = data.decode("latin-1").splitlines(keepends=True)
    if chance.random() < 0.4 and len(lines) > 1:
        for _ in range(chance.randint(1, 3)):
            first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
            how = chance.randrange(3)
            if how == 0:
                lines[first], lines[second] = lines[second], lines[first]
            elif how == 1 or len(lines) == 1:
                lines.insert(first, lines[second])
            else:
                del lines[first]
        return "".join(lines).encode("latin-1")
    return mutated("".join(lines), chance, PIECES).encode("latin-1", "replace")


def run(task: tuple[int, int, list[Path]]) -> tuple[Counter[str], list[str], tuple[float, str]]:
    """Try some inputs; return what came of them, what went wrong, and the longest time."""
    seed, count, paths = task
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("ignore")
    chance = random.Random(seed)
    outcomes: Counter[str] = Counter()
    wrong: list[str] = []
    longest = (0.0, "")
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(count):
            source = chance.choice(paths)
            target = Path(folder) / source.name
            data = spoilt(source, chance)
            target.write_bytes(data)
            is_model = source.suffix.lower() in MODELS
            began = time.perf_counter()
            signal.alarm(SECONDS)
            try:
                if is_model:
                    mdm.load_model(target).flatten()
                else:
                    mdm.load_policy(target)
                outcomes["model" if is_model else "policy"] += 1
            except mdm.FormatError:
                outcomes["refused model" if is_model else "refused policy"] += 1
            except BaseException:
                wrong.append(f"{_keep(source, data)}\n{traceback.format_exc()}")
            finally:
                signal.alarm(0)
            took = time.perf_counter() - began
            if took > longest[0]:
                longest = (took, _keep(source, data) if took > SLOW else source.name)
    return outcomes, wrong, longest


def _keep(source: Path, data: bytes) -> str:
    """Write an input to a folder of its own, to be looked at."""
    kept = Path(tempfile.mkdtemp(prefix="fuzz")) / source.name
    kept.write_bytes(data)
    return str(kept)


def main() -> int:
    """Try as many inputs as are asked for, on all processors; return whether something went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    paths = seeds()
    parts = max(1, arguments.inputs // 500)
    tasks = [(arguments.seed * 1_000_003 + part, arguments.inputs // parts, paths) for part in range(parts)]
    outcomes: Counter[str] = Counter()
    failures: list[str] = []
    longest = (0.0, "")
    with multiprocessing.Pool(initializer=signal.signal, initargs=(signal.SIGALRM, late)) as pool:
        for counted, wrong, slowest in pool.imap_unordered(run, tasks):
            outcomes += counted
            failures += wrong
            longest = max(longest, slowest)
    for failure in failures[:10]:
        print(failure)  # noqa: T201 - a script
    print(f"{sum(outcomes.values()) + len(failures)} inputs from {len(paths)} files: {dict(outcomes)}")  # noqa: T201
    print(f"{len(failures)} went wrong; the longest took {longest[0]:.1f} s: {longest[1]}")  # noqa: T201
    return 1 if failures else 0


def late(*_: object) -> None:
    """Stop what takes too long."""
    raise TimeoutError(f"not done after {SECONDS} s")


if __name__ == "__main__":
    raise SystemExit(main())
