"""Where layers are."""

from __future__ import annotations

import pytest

import mdm
from mdm.team.placement import Placement


def test_nothing_is_placed_by_default():
    assert Placement() == Placement(control=None, actions=None, inputs=None)


@pytest.mark.parametrize("given", [{"control": 3}, {"actions": {"agent": 1}}, {"inputs": ["a"]}])
def test_only_agents_are_places(given):
    with pytest.raises(mdm.ConfigError, match="names agents of the team"):
        Placement(**given)
