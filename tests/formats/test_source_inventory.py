"""What readers did not carry over."""

from __future__ import annotations

from pathlib import Path

import pytest

from mdm.errors import MapWarning, ModelWarning
from mdm.formats.source import Inventory


def test_each_thing_is_told_once_with_its_first_places_and_why():
    inventory, other = Inventory(), Inventory()
    for line in (3, 5, 7, 9, 11):
        inventory.leave("cost", f"line {line}")
    inventory.leave("cost", "line 13", "it is not known")
    other.leave("cost", "line 20")
    other.leave("speed", "line 21")
    inventory.add(other)
    assert inventory.lines() == [
        "cost, of line 3, line 5, line 7 and 3 more",
        "cost, of line 13: it is not known",
        "speed, of line 21",
    ]


@pytest.mark.parametrize("kind", [MapWarning, ModelWarning])
def test_one_warning_names_all_and_nothing_is_silent(kind):
    inventory = Inventory()
    inventory.warn(Path("a.yaml"), kind)  # nothing: warnings are errors here
    inventory.leave("cost", "id 1")
    inventory.leave("speed", "id 2")
    with pytest.warns(kind, match="^a.yaml: not carried over: cost, of id 1; speed, of id 2$"):
        inventory.warn(Path("a.yaml"), kind)
