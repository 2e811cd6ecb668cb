from __future__ import annotations

import re

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import ConfigError, Error
from mdm.team.transport.keys import check_expression, check_key, check_name, includes, join, matches, owner_of

NAMES = st.text(st.characters(exclude_characters="/*$#?@", exclude_categories=["C", "Z"]), min_size=1, max_size=12)
CHUNKS = st.sampled_from(["a", "b", "@live"])
KEYS = st.lists(CHUNKS, min_size=1, max_size=5).map("/".join)
EXPRESSIONS = (
    st.lists(st.sampled_from(["a", "b", "@live", "*", "**"]), min_size=1, max_size=5)
    .map("/".join)
    .filter(lambda text: "**/*" not in text)
)


@given(NAMES, NAMES, st.lists(NAMES, min_size=1, max_size=3))
def test_a_key_of_names_is_a_key_of_its_agent(team, agent, rest):
    for name in (team, agent, *rest):
        assert check_name(name, "an agent") == name
    key = join(team, agent, *rest)
    assert check_key(key) == check_expression(key) == key
    assert owner_of(key, team) == agent
    assert owner_of(key, team + "2") is None
    assert matches(key, key)
    assert matches(join(team, "**"), key)
    assert matches(join(team, "*", *rest), key)


@pytest.mark.parametrize("name", ["", "a/b", "a*", "$a", "a#", "a?", "@live", "a\n", "\ud800", "x" * 65, None, 3, b"a"])
def test_a_name_that_means_something_in_keys_is_refused(name):
    with refused(ConfigError):
        check_name(name, "a team", key="team.name")


@pytest.mark.parametrize("key", ["", "/", "a//b", "/a", "a/", "a/*", "a/**", "a?b", "a#", "$*"])
def test_what_is_no_key_is_refused(key):
    with refused(Error):
        check_key(key)


@pytest.mark.parametrize("expression", ["", "a//b", "a*/b", "a/***", "$*/a", "a/**/**", "a/**/*"])
def test_what_is_no_expression_is_refused(expression):
    with refused(Error):
        check_expression(expression)


@pytest.mark.parametrize("key", ["", "mdm", "mdm/t", "mdm/t/a", "mdm/t//x", "other/t/a/x", "mdm/u/a/x"])
def test_what_is_under_no_agent_has_no_owner(key):
    assert owner_of(key, "t") is None


def as_pattern(expression):
    """Return an expression as a regular expression over a key with a '/' after each chunk."""
    parts = {"*": r"[^@/][^/]*/", "**": r"(?:[^@/][^/]*/)*"}
    return "".join(parts.get(chunk, re.escape(chunk) + "/") for chunk in expression.split("/"))


@given(EXPRESSIONS, KEYS)
def test_expressions_match_as_regular_expressions_do(expression, key):
    assert matches(expression, key) == bool(re.fullmatch(as_pattern(expression), key + "/"))


@given(EXPRESSIONS, EXPRESSIONS, KEYS)
def test_what_an_expression_includes_it_matches(wide, narrow, key):
    if includes(wide, narrow) and matches(narrow, key):
        assert matches(wide, key)
    assert includes(wide, wide)
    assert includes(wide, key) == matches(wide, key)


@given(EXPRESSIONS, EXPRESSIONS)
def test_expressions_mean_what_they_mean_to_zenoh(wide, narrow):
    zenoh = pytest.importorskip("zenoh")
    try:
        check_expression(wide)
        check_expression(narrow)
    except Error:
        return
    assert includes(wide, narrow) == zenoh.KeyExpr(wide).includes(zenoh.KeyExpr(narrow))
