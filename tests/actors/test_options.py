"""Drives, as they are given: themselves, a word, or a rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from sentences import refused

from mdm import ConfigError, Error, FixedRate, OnEvent
from mdm.actors.control.control_layer import unobserved
from mdm.actors.options import drive_of
from mdm.problems import tiger


@pytest.mark.parametrize(
    ("given", "drive"),
    [
        (None, OnEvent()),
        ("event", OnEvent()),
        (OnEvent(), OnEvent()),
        (FixedRate(2.0), FixedRate(2.0)),
        (10, FixedRate(10.0)),
        (0.5, FixedRate(0.5)),
    ],
)
def test_a_drive_is_given_in_several_ways(given, drive):
    assert drive_of(given) == drive


@pytest.mark.parametrize("given", ["tick", True, [10.0], OnEvent])
def test_other_drives_are_refused(given):
    with pytest.raises(ConfigError, match="'event', a number of decisions per second") as caught:
        drive_of(given)
    assert caught.value.key == "drive"


@pytest.mark.parametrize("rate", [0, -1.0, float("nan"), float("inf"), 1e9])
def test_a_rate_that_no_clock_can_keep_is_refused(rate):
    with refused(Error):
        FixedRate(rate)


@pytest.mark.parametrize("given", [np.int64(3), np.float32(3), np.float64(3), Fraction(3), FixedRate(3)])
def test_numbers_of_any_kind_are_rates(given):
    drive = drive_of(given)
    assert drive == FixedRate(3.0)
    assert type(drive.rate) is float


@pytest.mark.parametrize("rate", [True, np.True_, "3", None])
def test_what_is_no_number_is_no_rate(rate):
    with refused(ConfigError):
        FixedRate(rate)


@pytest.mark.parametrize(
    ("given", "means"), [("predict", "predict"), ("repeat", "repeat"), ("hear-left", 0), ("hear-right", 1)]
)
def test_a_tick_without_an_observation_means_something_by_its_name(given, means):
    assert unobserved(given, tiger().observation_space) == means


def test_what_means_nothing_is_refused():
    with pytest.raises(
        ConfigError, match="on_no_observation is 'predict', 'repeat' or an observation's name"
    ) as caught:
        unobserved("hear", tiger().observation_space)
    assert caught.value.key == "on_no_observation"
    with pytest.raises(ConfigError, match="no model with observations"):
        unobserved("hear-left", None)
