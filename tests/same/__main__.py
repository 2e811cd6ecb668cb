"""Two commits side by side: ``python -m same BEFORE AFTER`` in ``tests/`` says what they do otherwise.

Random systems and teams run in virtual time, the command is called with right and wrong words, runs are recorded:
facts, words and bytes of each are compared. A difference is printed with its seed, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
from contextlib import ExitStack
from itertools import zip_longest
from pathlib import Path

from places import ROOT

PARTS = {"systems": 2000, "teams": 320, "commands": 2400, "records": 100}


def unpacked(commit, folder):
    """Unpack what a commit has of the package and the examples; ``.`` is the tree as it stands."""
    if commit == ".":
        return ROOT
    packing = subprocess.run(["git", "archive", commit, "mdm", "examples"], cwd=ROOT, capture_output=True)
    if packing.returncode:
        raise SystemExit(f"same: this clone has no commit {commit!r}")
    with tarfile.open(fileobj=io.BytesIO(packing.stdout)) as packed:
        packed.extractall(folder, filter="data")
    return folder


def side(tree, part, first, count):
    """Start a process that prints, line by line, what a tree makes of so many seeds."""
    paths = os.pathsep.join([str(tree), str(ROOT / "tests")])
    return subprocess.Popen(
        [sys.executable, "-m", "same.side", part, str(first), str(count), str(tree)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONHASHSEED": "0", "COLUMNS": "100", "NO_COLOR": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )


def difference(before, after):
    """Return where two lists of texts begin to differ, in words; empty where they do not."""
    for place, (ours, theirs) in enumerate(zip_longest(before, after)):
        if ours != theirs:
            return f"at {place} of {len(before)}:\n    before {ours}\n    after  {theirs}"
    return ""


def compared(part, trees, first, count):
    """Print what differs in a part; return how many seeds were compared, and how many differ."""
    differ = seen = 0
    with ExitStack() as stack:
        sides = [stack.enter_context(side(tree, part, first, count)) for tree in trees]
        for before, after in zip_longest(*(each.stdout for each in sides)):
            if before is None or after is None:
                raise SystemExit(f"same: a side of {part} has ended after {seen} seeds")
            (seed, ours), (_, theirs) = json.loads(before), json.loads(after)
            seen += 1
            if said := difference(ours, theirs):
                differ += 1
                print(f"{part}, seed {seed}, {said}", flush=True)
        if any(each.wait() for each in sides) or seen != count:
            raise SystemExit(f"same: a side of {part} has failed after {seen} seeds")
    return seen, differ


def main(words):
    """Compare, and return the exit status."""
    parser = argparse.ArgumentParser("same", description=__doc__)
    parser.add_argument("before", help="a commit, or . for the tree as it stands")
    parser.add_argument("after", help="another one")
    parser.add_argument("--part", choices=PARTS, action="append", help="only these parts")
    parser.add_argument("--count", type=int, help="so many seeds of each part")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    given = parser.parse_args(words)
    total = 0
    with tempfile.TemporaryDirectory() as folder:
        trees = [unpacked(commit, Path(folder) / name) for name, commit in (("b", given.before), ("a", given.after))]
        for part in given.part or PARTS:
            seen, differ = compared(part, trees, given.first, given.count or PARTS[part])
            print(f"{part}: {seen:,} compared, {differ:,} differ", flush=True)
            total += differ
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
