"""Which values are numbers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from mdm.checks import is_number, is_whole


@pytest.mark.parametrize(
    ("given", "number", "whole"),
    [
        (3, True, True),
        (np.int32(3), True, True),
        (np.uint8(3), True, True),
        (0.5, True, False),
        (2.0, True, False),
        (np.float32(0.5), True, False),
        (float("nan"), True, False),
        (Fraction(1, 3), True, False),
        (True, False, False),
        (np.True_, False, False),
        ("3", False, False),
        (None, False, False),
        (1j, False, False),
        (np.array([3]), False, False),
    ],
)
def test_numbers_and_whole_numbers(given, number, whole):
    assert (is_number(given), is_whole(given)) == (number, whole)
