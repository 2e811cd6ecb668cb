"""Inputs of a network: by name and value, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm.errors import Error
from mdm.logic.network import Declarations, Inputs


@pytest.fixture
def inputs():
    declared = Declarations()
    declared.add_input("a")
    declared.add_input("b")
    declared.add_event("e")
    declared.add_event("f")
    declared.define("not_a", "not a")
    return Inputs(declared._nodes, {name: place for place, name in enumerate(declared._nodes)})


def test_values_are_read_by_place_and_the_last_of_several_counts(inputs):
    assert inputs.read((("b", True), ("a", None), ("b", False))).places == ((1, 0), (0, 1))


@pytest.mark.parametrize("given", [(("a", True),), [("a", np.True_)], [("a", 1)]])
def test_lists_and_other_truth_values_read_alike(inputs, given):
    assert inputs.read(given).places == ((0, 2),)


def test_an_event_is_raised_once(inputs):
    assert inputs.raised(("f", "e", "f")).places == ((3, 2), (2, 2))
    assert inputs.raised(["e"]).places == ((2, 2),)


def test_what_recurs_is_remembered_and_what_is_long_or_wrong_is_not(inputs):
    inputs.read((("a", True),))
    inputs.read([("a", False)])
    inputs.read((("a", True),) * 9)
    inputs.raised(("e",))
    with pytest.raises(Error):
        inputs.read((("a", "yes"),))
    assert list(inputs.readings) == [(("a", True),)]
    assert list(inputs.raisings) == [("e",)]


@pytest.mark.parametrize("value", ["yes", 2, [], np.array([True, False])])
def test_what_is_no_truth_value_is_refused(inputs, value):
    with refused(Error):
        inputs.read((("a", value),))


@pytest.mark.parametrize(
    ("name", "text"),
    [("c", "no predicate or event 'c'"), ("e", "'e' cannot be set from outside"), ("not_a", "it is derived")],
)
def test_what_is_no_input_is_refused(inputs, name, text):
    with pytest.raises(Error, match=text):
        inputs.read((("b", True), (name, True)))


@pytest.mark.parametrize("name", ["a", "not_a", "g"])
def test_what_is_no_event_is_not_raised(inputs, name):
    with refused(Error):
        inputs.raised(("e", name))
