"""Answers questions about decision processes by Storm: reads them as JSON from standard input, and writes the numbers.

It runs in an interpreter that has stormpy, and shares nothing with what it is compared with.
"""

import json
import sys

import stormpy
from stormpy.datastructures import SparseMatrixBuilder
from stormpy.environments import exact as exact_environment
from stormpy.models import SparseMdp, SparseModelComponents, SparseRewardModel, StateLabeling


def process(question):
    """Return a Markov decision process of Storm: rows of choices, each a list of pairs of state and probability."""
    exact = stormpy.Rational
    builder = SparseMatrixBuilder[exact](
        rows=sum(map(len, question["rows"])),
        columns=len(question["rows"]),
        has_custom_row_grouping=True,
        row_groups=len(question["rows"]),
    )
    row = 0
    for choices in question["rows"]:
        builder.new_row_group(row)
        for choice in choices:
            for state, chance in sorted(choice):
                builder.add_next_value(row, state, exact(chance))
            row += 1
    size = len(question["rows"])
    labels = StateLabeling(size)
    for name, states in {**question["labels"], "init": [question["start"]]}.items():
        labels.add_label(name)
        for state in states:
            labels.add_label_to_state(name, state)
    rewards = {"steps": SparseRewardModel[exact](optional_state_reward_vector=[exact(1)] * size)}
    parts = SparseModelComponents[exact](
        transition_matrix=builder.build(), state_labeling=labels, reward_models=rewards
    )
    return SparseMdp[exact](parts)


def main():
    """Answer all questions."""
    found = []
    for question in json.load(sys.stdin):
        model = process(question)
        answers = []
        for formula in question["formulas"]:
            result = stormpy.model_checking(model, stormpy.parse_property(formula), environment=exact_environment())
            values = [str(result.get_value(state)) for state in range(len(question["rows"]))]
            answers.append(values if question.get("everywhere") else values[question["start"]])
        found.append(answers)
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
