"""The grammar of formulas, and where a text leaves it."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import FormatError
from mdm.logic import Formula, P, parse

a, b, c = P("a"), P("b"), P("c")


@pytest.mark.parametrize(
    ("text", "formula"),
    [
        ("a", a),
        ("not a and b", ~a & b),
        ("a or b and c", a | (b & c)),
        ("a xor b and c", a ^ (b & c)),
        ("a or b xor c", a | (b ^ c)),
        ("a or b implies c", (a | b) >> c),
        ("a implies b implies c", a >> (b >> c)),
        ("a -> b", a >> b),
        ("a => b", a >> b),
        ("a >> b", a >> b),
        ("!a && ~b || c ^ a", (~a & ~b) | (c ^ a)),
        ("(a or b) and c", (a | b) & c),
        ("robot2/IsMoving", P("robot2/IsMoving")),
        ("Patrol.succeeded and not a", P("Patrol.succeeded") & ~a),
        ("'person is waiting' or \"x\"", P("person is waiting") | P("x")),
        ("  a\n and\tb ", a & b),
        ("not not a", ~~a),
        ("notable", P("notable")),
    ],
)
def test_grammar(text: str, formula: Formula):
    assert parse(text) == formula


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "the end"),
        ("a and", 6, "the end"),
        ("(a or b", 8, "')' was expected"),
        ("a b", 3, "'b'"),
        ("a $ b", 3, "'$'"),
        ("and a", 1, "'and'"),
        ("a or 'x", 6, '"\'"'),
        ("()", 2, "')'"),
    ],
)
def test_errors_tell_the_column_and_what_stands_there(text: str, column: int, words: str):
    with pytest.raises(FormatError) as caught:
        parse(text)
    assert caught.value.column == column
    assert words in str(caught.value)


@given(st.text(alphabet="ab ()!&|^~->=\"'.and or not", max_size=40))
def test_any_text_gives_a_formula_or_a_format_error(text: str):
    try:
        assert isinstance(parse(text), Formula)
    except FormatError as error:
        assert error.column is not None


@pytest.mark.parametrize("text", ["(" * 5000 + "a", "not " * 5000 + "a", " and ".join("a" * 5000), "a->" * 5000 + "a"])
def test_deep_formulas_are_refused_with_a_way_out(text: str):
    with refused(FormatError):
        parse(text)
