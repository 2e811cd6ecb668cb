"""Declarations of state factors."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm import ConfigError, StateFactor


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StateFactor("f", []), "list of predicates"),
        (lambda: StateFactor("f", "A"), "list of predicates"),
        (lambda: StateFactor("f", ["A", "A"]), "twice"),
        (lambda: StateFactor("f", ["A"], on_violation="last"), "'last'"),
    ],
)
def test_wrong_factors(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_indices_are_indices_without_a_model():
    assert StateFactor("a", {1: "A", 0: "B"}).predicates == ("B", "A")
    assert StateFactor("a", {2: "C", 0: "A", 1: "B"}).predicates == ("A", "B", "C")


def test_one_predicate_has_the_index_0_or_1():
    with refused(ConfigError):
        StateFactor("a", {7: "X"})
    with refused(ConfigError):
        StateFactor("a", {True: "X"})
