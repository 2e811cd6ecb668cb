"""Restrictions of places and ways, against a table of all truth values."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, strategies as st

from mdm.maps.files.restrictions import allows

SHORT = {"robot": "short"}


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("True", True),
        ("False", False),
        ("", True),
        ("robot_short", True),
        ("robot_SHORT", True),
        ("robot_tall", False),
        ("~robot_tall & (robot_short | task_mow)", True),
        ("task_mow", None),
        ("task_mow & robot_tall", False),
        ("task_mow | robot_short", True),
        ("not task_mow", None),
        ("robot_very_short", False),
        ("obstacleFree_1", None),
    ],
)
def test_what_is_known_of_the_robot_decides_where_it_can(text, holds):
    assert allows(text, SHORT) is holds


@pytest.mark.parametrize("text", ["robot_short &", "['short', 'tall']", "f(robot)", "1", "robot_short + 1", "(" * 5000])
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError):
        allows(text, SHORT)


TERMS = st.recursive(
    st.sampled_from(["a_x", "b_x", "c_x", "True", "False"]),
    lambda part: st.one_of(
        part.map(lambda one: f"~({one})"),
        st.tuples(part, st.sampled_from(["&", "|", "and", "or"]), part).map(lambda each: "({}) {} ({})".format(*each)),
    ),
    max_leaves=6,
)


@given(TERMS, st.lists(st.sampled_from([True, False, None]), min_size=3, max_size=3))
def test_what_is_decided_holds_whatever_is_unknown(text, values):
    """Decided is what is the same in each world; where Python says so by itself for the conditions as numbers."""
    robot = {kind: "x" if value else "y" for kind, value in zip("abc", values, strict=True) if value is not None}
    decided = allows(text, robot)
    worlds = []
    for world in itertools.product([True, False], repeat=3):
        if all(value in (None, here) for value, here in zip(values, world, strict=True)):
            names = dict(zip(("a_x", "b_x", "c_x"), world, strict=True))
            plain = text.replace("~", " not ").replace("&", "and").replace("|", "or")
            worlds.append(eval(plain, {"__builtins__": {}}, names))
    if decided is not None:
        assert set(worlds) == {decided}
    if None not in values:
        assert decided is worlds[0]
