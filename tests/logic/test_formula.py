"""Formulas: three-valued connectives, their text, and Python's operators."""

from __future__ import annotations

import operator
from itertools import product

import pytest
from hypothesis import given
from random_formulas import VALUES, formulas
from sentences import refused

from mdm import Error
from mdm.logic import Formula, Network, P, parse


def possible(value: bool | None) -> tuple[bool, ...]:
    return (True, False) if value is None else (value,)


@pytest.mark.parametrize(
    ("formula", "classical"),
    [
        (P("a") & P("b"), lambda a, b: a and b),
        (P("a") | P("b"), lambda a, b: a or b),
        (P("a") ^ P("b"), lambda a, b: a != b),
        (P("a") >> P("b"), lambda a, b: not a or b),
    ],
)
def test_connectives_are_unknown_exactly_where_the_unknowns_decide(formula, classical):
    for a, b in product(VALUES, VALUES):
        outcomes = {classical(x, y) for x in possible(a) for y in possible(b)}
        expected = outcomes.pop() if len(outcomes) == 1 else None
        assert formula.evaluate({"a": a, "b": b}) is expected


def test_negation():
    assert [(~P("a")).evaluate({"a": value}) for value in VALUES] == [False, True, None]


@given(formulas)
def test_text_reads_back(formula: Formula):
    assert parse(str(formula)) == formula
    assert hash(parse(str(formula))) == hash(formula)


@given(formulas)
def test_names(formula: Formula):
    used = formula.names
    formula.evaluate(dict.fromkeys(used))
    for name in used:
        with pytest.raises(KeyError):
            formula.evaluate(dict.fromkeys(used - {name}))


def test_python_operators_take_plain_booleans():
    assert (P("a") & True) == parse("a and true")
    assert (False | P("a")) == parse("false or a")
    assert (True >> P("a")) == parse("true implies a")


def test_truth_value_is_refused():
    with refused(TypeError):
        bool(P("a") and P("b"))


def test_other_operands_are_refused():
    with refused(TypeError):
        P("a") & "b"


@pytest.mark.parametrize("connect", [operator.and_, operator.or_, operator.xor, operator.rshift])
def test_deep_formulas_work_or_are_refused_where_they_are_made(connect):
    formula, depth = P("a"), 1
    with refused(Error):
        while True:
            formula = connect(formula, P("b"))
            depth += 1
    assert depth == 270
    network = Network()
    network.add_input("a", True)
    network.add_input("b", True)
    network.define("c", formula)
    network.compile()
    assert network.value("c") is formula.evaluate({"a": True, "b": True})
