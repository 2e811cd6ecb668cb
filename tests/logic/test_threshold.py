"""Thresholds: their grammar, the place of each error, and what they hold for, against a reader of their own."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import FormatError
from mdm.logic import parse_threshold

FINITE = st.floats(allow_nan=False, allow_infinity=False)
LESS, MORE = st.sampled_from(["<", "<="]), st.sampled_from([">", ">="])
SPACE = st.sampled_from(["", " ", "\t "])


@st.composite
def thresholds(draw):
    """Return a threshold's text, its two comparisons as functions, and its bounds."""
    low, high = sorted((draw(FINITE), draw(FINITE)))
    less, more = draw(LESS), draw(MORE)
    if low == high and less + more == "<=>=":
        more = ">"
    below = (lambda x: x < low) if less == "<" else (lambda x: x <= low)
    above = (lambda x: x > high) if more == ">" else (lambda x: x >= high)
    parts = [(f"{less}{draw(SPACE)}{low!r}", below), (f"{more}{draw(SPACE)}{high!r}", above)]
    (first, on), (second, off) = parts if draw(st.booleans()) else parts[::-1]
    return f"{draw(SPACE)}{first} until {second}{draw(SPACE)}", on, off, (low, high)


@given(thresholds(), st.data())
def test_a_number_holds_from_the_one_comparison_to_the_other(threshold, data):
    text, on, off, bounds = threshold
    found = parse_threshold(text)
    assert parse_threshold(str(found)) == found
    beside = [math.nextafter(bound, way) for bound in bounds for way in (-math.inf, math.inf)]
    near = st.sampled_from([*bounds, *beside])
    before = None
    for number in data.draw(st.lists(near | st.floats(allow_nan=False), max_size=20)):
        expected = True if on(number) else False if off(number) else before
        assert found.of(number, before) is expected
        assert found.of(np.float64(number), before) is expected
        before = expected
    assert found.of(math.nan, True) is None


@given(FINITE, st.sampled_from(["<", "<=", ">", ">="]), st.floats(allow_nan=False))
def test_one_comparison_is_true_or_false(bound, sign, number):
    expected = {"<": number < bound, "<=": number <= bound, ">": number > bound, ">=": number >= bound}[sign]
    found = parse_threshold(f"{sign} {bound!r}")
    assert [found.of(number, before) for before in (None, True, False)] == [expected] * 3
    assert str(found) == f"{sign} {repr(bound).removesuffix('.0')}"


@pytest.mark.parametrize("number", [10**400, Fraction(1, 3), np.float32(0.5), np.int64(3), math.inf])
def test_numbers_of_any_type_are_compared_as_they_are(number):
    assert parse_threshold("< 0.2 until > 0.3").of(number, True) is False
    assert parse_threshold("> 0.3 until < 0.2").of(number, False) is True


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("", 1),
        ("  ", 3),
        ("0.2", 1),
        ("= 0.2", 1),
        ("== 0.2", 1),
        ("percentage < 0.2", 1),
        ("<", 2),
        ("< x", 3),
        ("< nan", 3),
        ("< 1e999", 3),
        ("< 0.2.1", 3),
        ("< 0,2", 4),
        ("< ٣", 3),
        ("< 0.2until > 0.3", 3),
        ("< 0.2 or > 0.3", 7),
        ("< 0.2 until", 12),
        ("< 0.2 until 0.3", 13),
        ("< 0.2 until > 0.3 until < 0.1", 19),
        ("< 0.2 until < 0.3", 13),
        ("> 0.2 until >= 0.1", 13),
        ("< 0.3 until > 0.2", 13),
        ("<= 0.3 until >= 0.3", 14),
        ("> 0.2 until < 0.3", 13),
    ],
)
def test_what_is_no_threshold_is_refused_at_its_place(text, column):
    with refused(FormatError) as caught:
        parse_threshold(text)
    assert caught.value.column == column


@given(st.text(alphabet="<>=until 0123456789.e+-x\n", max_size=24))
def test_whatever_is_written_is_a_threshold_or_refused_with_a_column(text):
    try:
        found = parse_threshold(text)
    except FormatError as error:
        assert error.column is not None
        assert 1 <= error.column <= len(text) + 1
    else:
        assert parse_threshold(str(found)) == found
        assert not any(found.of(number, True) is not found.of(number, False) for number in (-math.inf, math.inf))
