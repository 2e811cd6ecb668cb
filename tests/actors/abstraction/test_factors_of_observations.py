"""Declarations of observation factors."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm import ConfigError, ObservationFactor


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ObservationFactor("f", ["A"]), "at least two events"),
        (lambda: ObservationFactor("f", ["A", "A"]), "twice"),
        (lambda: ObservationFactor("f", ["A", "B"], idle="C"), "'C' of observation factor 'f' is not one of A, B"),
        (lambda: ObservationFactor("f", ["A", "B"], idle="A", hold=True), "not both"),
    ],
)
def test_wrong_factors(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_indices_are_indices_without_a_model():
    assert ObservationFactor("d", {1: "Up", 0: "Down"}).events == ("Down", "Up")
    factor = ObservationFactor("d", {2: "Up", 1: "Down"}, idle=0)
    assert factor.events == (None, "Down", "Up")
    assert factor.idle == 0


def test_the_idle_symbol_is_an_index_where_the_others_are():
    for idle in ("nothing", True):
        with refused(ConfigError):
            ObservationFactor("d", {0: "Up", 1: "Down"}, idle=idle)
    with refused(ConfigError):
        ObservationFactor("d", {0: "Up", 1: "Down"}, idle=7)


@pytest.mark.parametrize("owner", ["", 3])
def test_an_owner_is_an_agent_s_name(owner):
    with refused(ConfigError):
        ObservationFactor("way", ["Up", "Down"], owner=owner)
