"""YAML trees: against PyYAML's own reader, and what is dangerous is refused."""

from __future__ import annotations

import sys

import pytest
import yaml
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import FormatError, MapError
from mdm.formats.source import Source
from mdm.maps.files.yaml_tree import Entry, read_yaml

WORDS = st.text("abcxyz", min_size=1, max_size=4)
VALUES = st.recursive(WORDS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(WORDS, inner, max_size=4))


def read(tmp_path, text):
    (tmp_path / "file.yaml").write_text(text)
    return read_yaml(Source(tmp_path / "file.yaml"))


def plain(entry: Entry):
    if isinstance(entry.content, dict):
        return {key: plain(value) for key, value in entry.content.items()}
    return [plain(value) for value in entry.content] if isinstance(entry.content, list) else entry.content


def values(entry: Entry):
    if isinstance(entry.content, str):
        return 1
    if isinstance(entry.content, dict):
        return 1 + sum(1 + values(value) for value in entry.content.values())
    return 1 + sum(map(values, entry.content))


@given(VALUES, st.booleans())
def test_texts_lists_and_mappings_are_read(tmp_path_factory, value, flow):
    text = yaml.safe_dump(value, default_flow_style=flow)
    assert plain(read(tmp_path_factory.mktemp("yaml"), text)) == value


def test_entries_know_their_lines(tmp_path):
    root = read(tmp_path, "a: 1\nb:\n- x\n- y: 2\n")
    assert (root.line, root.need("a", "it").line) == (1, 1)
    assert [item.line for item in root.need("b", "it").list("b")] == [3, 4]
    with refused(FormatError):
        root.need("b", "it").list("b")[1].number("b")
    with refused(FormatError):
        root.need("a", "it").list("a")
    with refused(FormatError):
        root.need("a", "it").get("c", "a")
    with refused(FormatError):
        root.need("c", "it")


@pytest.mark.parametrize("word", [".nan", "nan", ".inf", "inf", "-inf", "1e999", "", "1_0", "0x10"])
def test_only_finite_numbers_are_numbers(tmp_path, word):
    with refused(FormatError):
        read(tmp_path, f"a: {word}\n").need("a", "it").number("a")


def test_an_alias_stands_for_its_anchor(tmp_path):
    assert plain(read(tmp_path, "a: &x [1, 2]\nb: *x\nc: &x 3\nd: *x\n")) == {
        "a": ["1", "2"],
        "b": ["1", "2"],
        "c": "3",
        "d": "3",
    }


def test_a_bomb_is_refused_at_the_line_where_it_goes_off(tmp_path):
    lines = ["a0: &a0 [" + ", ".join("x" * 10) + "]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * 10) + "]" for n in range(1, 12)]
    with refused(FormatError):
        read(tmp_path, "\n".join(lines))


def test_many_values_are_refused_and_fewer_are_not(tmp_path):
    assert values(read(tmp_path, "[" + "x," * 100_000 + "]")) == 100_001
    list_of_100_000 = "a: &a [" + "x," * 99_999 + "]\n"
    with refused(FormatError):
        read(tmp_path, list_of_100_000 + "b: [" + "*a," * 10 + "]")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &a [*a]", ":1: the alias .a stands for something that it is part of"),
        ("a: *b", "alias"),
        ("a: [1\nb: 2", "not well-formed YAML: did not find expected|not well-formed YAML: expected"),
        ("a: 1\na: 2", ":2: the key 'a' is given twice, first in line 1"),
        ("a: 1\n---\nb: 2", ":3: the text has a second document"),
        ("a: !!python/object:os.system {}", ":1: tags such as"),
        ("a: &a {b: 1}\nc:\n  <<: *a", ":3: merge keys"),
        ("? [1]\n: 2", ":1: a key is a list"),
        ("[" * 60 + "]" * 60, "nested more than 50 deep"),
        ("[" * 100_000, "nested more than 50 deep|not well-formed"),
        ("# nothing\n", "no content"),
        ("a: \x01", "not well-formed YAML: (control|special) characters are not allowed"),
        ("a:\t\n\t- b", "not well-formed YAML"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read(tmp_path, text)


def test_without_pyyaml_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "yaml", None)
    with refused(MapError):
        read(tmp_path, "a: 1\n")
