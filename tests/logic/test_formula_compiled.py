"""Compiled formulas, latches and holds, against the formulas' own evaluation and their truth tables."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, strategies as st
from random_formulas import VALUES, formulas
from sentences import refused

from mdm.logic import P
from mdm.logic.formula import CODES, FALSE, TRUE, UNKNOWN, compile_formula, compile_hold, compile_latch


@given(formulas, st.data())
def test_a_compiled_formula_is_the_formula(formula, data):
    names = sorted(formula.names)
    compiled = compile_formula(formula, {name: place for place, name in enumerate(names)})
    for _ in range(5):
        values = data.draw(st.lists(st.sampled_from(VALUES), min_size=len(names), max_size=len(names)))
        assert (
            compiled([CODES[value] for value in values])
            == CODES[formula.evaluate(dict(zip(names, values, strict=True)))]
        )


def test_it_looks_at_its_own_places_alone():
    compiled = compile_formula(P("a") & ~P("b"), {"b": 1, "a": 4, "other": 0})
    assert compiled([FALSE, FALSE, FALSE, FALSE, TRUE]) == TRUE
    with refused(KeyError):
        compile_formula(P("c"), {"a": 0})


def test_equal_formulas_over_equal_places_are_one_function():
    first = compile_formula(P("a") & ~P("b"), {"a": 0, "b": 1})
    assert compile_formula(P("x") & ~P("y"), {"x": 0, "y": 1}) is first
    assert compile_formula(P("a") & ~P("b"), {"a": 1, "b": 0}) is not first
    assert compile_formula(P("a") | ~P("b"), {"a": 0, "b": 1}) is not first


@pytest.mark.parametrize("own", [FALSE, TRUE])
def test_a_latch_turns_on_and_off_and_off_wins(own):
    latch = compile_latch(P("on"), P("off"), {"on": 0, "off": 1}, 2)
    for on, off in product((FALSE, UNKNOWN, TRUE), repeat=2):
        expected = FALSE if off == TRUE else TRUE if on == TRUE else own
        assert latch([on, off, own]) == expected


def test_a_hold_is_as_its_formula_until_that_is_true():
    hold = compile_hold(0, 1)
    for flag in (FALSE, TRUE):
        assert [hold([value, flag]) for value in (FALSE, UNKNOWN, TRUE)] == [FALSE, UNKNOWN, flag]
