"""The report about a model as text and as data."""

from __future__ import annotations

import json
import re

import numpy as np
from estimated import heard, visits, wandering

import mdm
from mdm.estimation import as_data, as_text, statistics
from mdm.models import MDP

USED = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]])
MODEL = MDP([USED], [[0], [0], [1]], discount=0.9, states=["hall", "lab", "dock"], actions=["go"])


def report():
    true = np.array([[0.5, 0.5, 0.0], [0.0, 0.9, 0.1], [1.0, 0.0, 0.0]])
    return statistics([*visits(wandering(true, 2_000, seed=1)), *visits([2, 1, 2, 1])], MODEL, kind="steps")


def test_text_says_what_differs_and_what_is_impossible():
    lines = as_text(report()).splitlines()
    assert lines[0] == "robot: 2004 decisions in 2 chains, steps, known states"
    returns = (
        r"returns of 2 episodes, expected by the model in use: \S+ ± \S+ \(standard error\); the model promises \S+"
    )
    assert re.fullmatch(returns, lines[1])
    assert lines[2] == "rows: 2 differs, 1 agrees, 0 certain, 0 too few; 0 not visited"
    assert lines[3] == "impossible by the model: dock -go-> lab, 2 times"
    (odd,) = [line for line in lines if line.startswith("T go dock: ")]
    assert odd.startswith("T go dock: lab followed, impossible by the model, loss ")
    (head,) = [line for line in lines if line.startswith("T go lab: p ")]
    assert ", odds 10^234 to 1" in head
    assert ", loss " in head
    (entry,) = [line for line in lines if line.split()[:1] == ["lab"]]
    _, visits_, model, estimate, low, _, high = entry.split()
    assert float(model) == 0.5
    assert float(low) < float(estimate) < float(high)
    assert int(visits_) > 500


def test_a_row_that_differs_within_all_its_intervals_says_by_what():
    """Each of four entries is 1.8 standard errors off: G is 10.3 of three degrees of freedom, so that p is 0.016."""
    rows = np.array([[0, 0.25, 0.25, 0.25, 0.25], *[[1.0, 0, 0, 0, 0]] * 4])
    model = MDP([rows], [[0]] * 5, discount=0.9, states=["hub", *"abcd"], actions=["go"])
    ways = [leaf for leaf, count in zip((1, 2, 3, 4), (116, 116, 84, 84), strict=True) for _ in range(count)]
    found = statistics(visits([0, *(state for leaf in ways for state in (leaf, 0))]), model, kind="steps")
    (row,) = [each for each in found.rows if each.says == "differs"]
    assert round(row.p_value, 3) == 0.016
    assert all(entry.low < entry.model < entry.high for entry in row.entries)
    (head,) = [line for line in as_text(found).splitlines() if line.startswith("T go hub: ")]
    assert head.endswith(", by all entries together, of which each alone has the model's value in its interval")
    assert "all entries together" not in as_text(report())


def test_text_of_jumps_has_how_long_states_last_and_of_hidden_states_what_was_observed():
    told = visits([0, 1, 2] * 30, times=np.cumsum([2.0, 4.0, 1.0] * 30))
    text = as_text(statistics(told, MODEL))
    (line,) = [line for line in text.splitlines() if line.startswith("hall, go")]
    assert line.split()[2:4] == ["30", "4"]
    assert "Erlang" in line
    text = as_text(statistics(heard([0, 0, 0], [1, 1]), mdm.problems.tiger()))
    assert "returns of 1 episode, expected by beliefs in the model in use: " in text
    assert re.search(r"^listen, hear-right +2 +\S+$", text, re.MULTILINE)
    assert text.splitlines()[-1].startswith("note: where states are hidden the loss")


def test_data_is_json_without_numbers_that_it_has_not():
    data = as_data(report())
    again = json.loads(json.dumps(data, allow_nan=False))
    assert again == data
    assert {"model", "durations"}.isdisjoint(data)
    first = data["rows"][0]
    assert (first["log_odds"], first["impossible"]) == (None, [["lab", 2]])
    assert data["rows"][1]["entries"][0]["symbol"] == "lab"
