"""Storm's part of `verification.py`, in an interpreter that has stormpy: answers each line of standard input."""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import stormpy
from measurement import memory_now, memory_peak
from stormpy import environments
from stormpy.datastructures import SparseMatrixBuilder
from stormpy.models import SparseMdp, SparseModelComponents, SparseRewardModel, StateLabeling


def process(path: str) -> SparseMdp:
    """Return the process that a file of arrays holds."""
    arrays = np.load(path)
    firsts, starts, columns, chances = (arrays[key].tolist() for key in ("firsts", "starts", "columns", "chances"))
    size = len(firsts) - 1
    builder = SparseMatrixBuilder[float](
        rows=firsts[-1], columns=size, entries=len(columns), has_custom_row_grouping=True, row_groups=size
    )
    for state in range(size):
        builder.new_row_group(firsts[state])
        for row in range(firsts[state], firsts[state + 1]):
            for at in range(starts[row], starts[row + 1]):
                builder.add_next_value(row, columns[at], chances[at])
    labels = StateLabeling(size)
    for name in ("x", "y"):
        labels.add_label(name)
        for state in arrays[name].tolist():
            labels.add_label_to_state(name, state)
    rewards = {"steps": SparseRewardModel[float](optional_state_reward_vector=[1.0] * size)}
    parts = SparseModelComponents[float](
        transition_matrix=builder.build(), state_labeling=labels, reward_models=rewards
    )
    return SparseMdp[float](parts)


def main() -> None:
    """Build, and answer formulas with the processor's time and the memory that each took."""
    model = process(sys.argv[1])
    environment = environments.sound()
    if method := sys.argv[2:]:
        environment.solver().min_max().method = environments.MinMaxMethod.__members__[method[0]]
    environment.solver().min_max().precision = stormpy.Rational(1) / stormpy.Rational(10**8)
    environment.solver().native().precision = stormpy.Rational(1) / stormpy.Rational(10**8)
    print(environment.solver().min_max().method, flush=True)
    for line in sys.stdin:
        formula, start = json.loads(line)
        environment.solver().min_max().relative_termination_criterion = formula.startswith("R")
        before, began = memory_now(), time.process_time()
        value = stormpy.model_checking(model, stormpy.parse_property(formula), environment=environment).get_value(start)
        took = time.process_time() - began
        print(json.dumps({"value": value, "seconds": took, "bytes": memory_peak() - before}), flush=True)


if __name__ == "__main__":
    main()
