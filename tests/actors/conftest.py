"""What tests of actors share."""

from __future__ import annotations

import pytest

from mdm import PredicateManager


@pytest.fixture
def declared():
    """A predicate manager of a room, a person, movements and a temperature."""
    manager = PredicateManager()
    for name in ("InA", "InB", "InC", "Person"):
        manager.sensor(name)
    for name in ("Up", "Down", "Hot", "Cold"):
        manager.event(name)
    return manager
