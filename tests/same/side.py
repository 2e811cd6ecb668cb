"""One commit's side: prints a line of JSON for each seed, its number and what was seen, as texts."""

from __future__ import annotations

import importlib
import json
import logging
import sys
from pathlib import Path


def main(part, first, count, tree):
    """Print what the tree's ``mdm`` makes of seeds."""
    logging.disable()
    seen = importlib.import_module(f"same.{part}").seen
    output = sys.stdout
    for seed in range(first, first + count):
        print(json.dumps([seed, seen(seed, Path(tree))]), file=output, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
