"""Lengths that are none."""

from __future__ import annotations

import math

import pytest
from sentences import refused

from mdm.checks import check_metres
from mdm.errors import MapError


@pytest.mark.parametrize("metres", [-1, -0.1, math.nan, math.inf, "1", None, True])
def test_a_length_that_is_none_is_refused(metres):
    with refused(MapError):
        check_metres(metres, "the radius")


@pytest.mark.parametrize("metres", [0, 0.25, 1e6])
def test_a_length_is_taken(metres):
    check_metres(metres, "the radius")
