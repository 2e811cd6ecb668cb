"""Where layers are."""

from __future__ import annotations

import pytest

import mdm
from mdm.team.ownership import Placement, placement_of


def test_nothing_is_placed_by_default():
    assert Placement() == Placement(control=None, actions=None, inputs=None)


@pytest.mark.parametrize("given", [{"control": 3}, {"actions": {"agent": 1}}, {"inputs": ["a"]}])
def test_only_agents_are_places(given):
    with pytest.raises(mdm.ConfigError, match=r"^(control|actions|inputs).*a text.* was expected, not"):
        Placement(**given)


def test_a_mapping_stands_for_a_placement():
    placement = Placement(control="base", inputs="robot")
    assert placement_of(placement) is placement
    assert placement_of({"control": "base", "inputs": "robot"}) == placement


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"contol": "base"}, "placement.contol: there is no option 'contol'; did you mean 'control'"),
        ({"x": "base"}, "placement.x: there is no option 'x'; there are control, actions, inputs"),
        ("base", "a mapping, not 'base'"),
        ({"control": 3}, "placement.control: a text was expected, not 3"),
    ],
)
def test_what_is_no_placement_is_refused(given, words):
    with pytest.raises(mdm.ConfigError, match=words):
        placement_of(given)
