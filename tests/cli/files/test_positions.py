"""Positions of keys, against `tomllib`: what it reads is found, at a place whose text is that key."""

from __future__ import annotations

import json
import tomllib

import pytest
from hypothesis import given, strategies as st
from places import EXAMPLES

from mdm.cli.files.positions import Positions

NAMES = st.one_of(st.sampled_from(["a", "b-1", "x_2", "7"]), st.text("aé\"'\\.=[]{}#\n\t ", max_size=4))
SCALARS = st.sampled_from(
    [
        *("1", "-2.5e3", "true", "inf", "1979-05-27", "1979-05-27 07:32:00", "1979-05-27T07:32:00Z", "07:32:00"),
        *('"x = 1"', '"\\" # ]"', "'\\'", '""', "''", '"""a = 1\n[b]\n\\""" " "" """""', "'''c = 2\n[d] '' # '''''"),
        *('""""x""""', "'''\n'''", '"""\\\\"""'),
    ]
)


def key(name: str, quote: int) -> str:
    """Return a key as it may be written."""
    if quote == 0 and name.isascii() and name and all(each.isalnum() or each in "-_" for each in name):
        return name
    if quote == 1 and not set(name) & {"'", "\n"}:
        return f"'{name}'"
    return json.dumps(name)


@st.composite
def values(draw, depth=2):
    """Draw the text of a value."""
    kind = draw(st.integers(0, 4)) if depth else 0
    if kind == 1:
        gap = draw(st.sampled_from(["", " ", "\n", " # ], }\n"]))
        inner = draw(st.lists(values(depth - 1), max_size=3))
        comma = draw(st.sampled_from(["", ","])) if inner else ""
        return f"[{gap}{f'{gap},{gap}'.join(inner)}{gap}{comma}{gap}]"
    if kind == 2:
        return f"{{ {', '.join(draw(st.lists(pairs(depth - 1), max_size=3)))} }}"
    return draw(SCALARS)


@st.composite
def dotted(draw):
    """Draw a key of one or more parts."""
    gap = draw(st.sampled_from(["", " ", "\t"]))
    parts = draw(st.lists(NAMES, min_size=1, max_size=3))
    return f"{gap}.{gap}".join(key(part, draw(st.integers(0, 2))) for part in parts)


@st.composite
def pairs(draw, depth=2):
    """Draw a key with a value."""
    return f"{draw(dotted())}{draw(st.sampled_from(['=', ' = ']))}{draw(values(depth))}"


@st.composite
def documents(draw):
    """Draw a document: lines that fit behind those before."""
    lines: list[str] = []
    kinds = [pairs(), dotted().map("[{}]".format), dotted().map("[[ {} ]]".format), st.sampled_from(["", "# [a]"])]
    for line in draw(st.lists(st.one_of(*kinds), max_size=12)):
        ending = draw(st.sampled_from(["", " ", " # b = 1"]))
        try:
            tomllib.loads("\n".join([*lines, line + ending]))
        except tomllib.TOMLDecodeError:
            continue
        lines.append(draw(st.sampled_from(["", "  "])) + line + ending)
    return "\n".join(lines)


def paths(value, above=()):
    """Yield the paths of all keys; those in an array have the path of the array above them."""
    if isinstance(value, list):
        for inner in value:
            yield from paths(inner, above)
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield (*above, name)
            yield from paths(inner, (*above, name))


def check(text):
    """Compare all keys of a text with what tomllib reads."""
    offsets = Positions(text).offsets
    assert offsets.keys() == set(paths(tomllib.loads(text)))
    for (*_, name), offset in offsets.items():
        assert any(_at(text, offset, each) for each in (name, json.dumps(name), f"'{name}'"))


def _at(text, offset, written):
    """Whether a key is written there so, and ends there."""
    behind = text[offset + len(written) :].lstrip(" \t")
    return written != "" and text.startswith(written, offset) and behind[:1] in {".", "=", "]"}


@given(documents())
def test_every_key_is_found_where_it_is_written(text):
    check(text)


@pytest.mark.parametrize(
    "path", sorted({*EXAMPLES.rglob("*.toml")} - {*EXAMPLES.glob("projects/**/*")}), ids=lambda path: path.name
)
def test_the_keys_of_the_examples_are_found(path):
    check(path.read_text(encoding="utf-8"))


def test_lines_and_columns_count_from_one_and_fall_back_on_what_is_above():
    found = Positions('a = 1\n\n[[b]]\n"c.d" = { e = [\n 1,\n 2] }\n[[b]]\nf.g = 0')
    assert found.of(("a",)) == (1, 1)
    assert found.of(("b",)) == (3, 3)
    assert found.of(("b", "c.d")) == (4, 1)
    assert found.of(("b", "c.d", "e")) == (4, 11)
    assert found.of(("b", "f", "g")) == (8, 3)
    assert found.of(("b", "f", "no", "such")) == (8, 1)
    assert found.of(("none",)) == (1, 1)
