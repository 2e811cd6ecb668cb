"""Arguments that are numbers, and what is said of those that are not."""

from __future__ import annotations

import argparse
import math

import pytest
from sentences import refused

from mdm.cli import usage


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [("count", "1", 1), ("count", "70", 70), ("seed", "0", 0), ("limit", "0", 0.0), ("limit", "1e3", 1000.0)],
)
def test_numbers(read, text, value):
    found = getattr(usage, read)(text)
    assert found == value
    assert type(found) is type(value)


def test_a_limit_may_be_infinite():
    assert math.isinf(usage.limit("inf"))


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        *(("count", text, "a whole number of 1 or more was expected") for text in ("0", "-3", "1.5", "many", "")),
        *(("seed", text, "a whole number of 0 or more was expected") for text in ("-1", "0.0", "x")),
        *(("limit", text, "a number of 0 or more was expected") for text in ("-0.1", "nan", "soon")),
    ],
)
def test_others_are_refused(read, text, words):
    with refused(argparse.ArgumentTypeError):
        getattr(usage, read)(text)
