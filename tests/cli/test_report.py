"""JSON of what numpy computes."""

from __future__ import annotations

import json

import numpy as np
from sentences import refused

from mdm.cli.report import as_json


def test_arrays_are_lists_and_numpy_s_numbers_are_numbers():
    facts = {
        "array": np.array([[0.5, 1.0], [0.1, -2.0]]),
        "whole": np.int64(3),
        "real": np.float64(0.1),
        "truth": np.True_,
        "plain": (1, None, "é"),
    }
    text = as_json(facts)
    assert "\n" not in text
    assert json.loads(text) == {
        "array": [[0.5, 1.0], [0.1, -2.0]],
        "whole": 3,
        "real": 0.1,
        "truth": True,
        "plain": [1, None, "é"],
    }


def test_what_has_no_place_in_it_is_an_error():
    with refused(TypeError):
        as_json({"z": 1j})
