"""XML as a stream: what is collected, where it stands, and what is refused."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from mdm import FormatError
from mdm.formats.markup import escape, quoted, stream
from mdm.formats.source import Source


def elements(folder, text, collect=()):
    (folder / "m.xml").write_text(text, encoding="utf-8")
    return list(stream(Source(folder / "m.xml"), collect))


DOCUMENT = """<?xml version="1.0"?>
<top version="2">
  <one a=" x "><two>in <b>bold</b> text</two><two/></one>
  <x:three/>
</top>
"""


def test_elements_come_in_order_and_those_asked_for_whole(tmp_path):
    top, one, three = elements(tmp_path, DOCUMENT, {"one"})
    assert [(e.tag, e.line, e.column) for e in (top, one, three)] == [("top", 2, 1), ("one", 3, 3), ("three", 4, 3)]
    assert top.attribute("version") == "2"
    assert one.attribute("a") == "x"
    first, second = one.all("two")
    assert (first.text, first.need("b").text) == ("in  text", "bold")
    assert one.find("two") is first
    assert (second.line, second.column) == (3, 46)
    assert one.find("none") is None
    assert [e.tag for e in elements(tmp_path, DOCUMENT)] == ["top", "one", "two", "b", "two", "three"]


def test_what_is_missing_is_told_with_the_place(tmp_path):
    _, one, _ = elements(tmp_path, DOCUMENT, {"one"})
    for ask, words in (
        (lambda: one.need("none"), "m.xml:3:3: <one> needs a <none>"),
        (lambda: one.attribute("b"), "m.xml:3:3: <one> needs the attribute 'b'"),
    ):
        with pytest.raises(FormatError) as caught:
            ask()
        assert words in str(caught.value)


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufffe\uffff")))
def test_what_is_escaped_is_read_as_it_was(tmp_path_factory, text):
    document = f"<top name={quoted(text)}>{escape(text)}</top>"
    (top,) = elements(tmp_path_factory.mktemp("markup"), document, {"top"})
    assert (top.attributes["name"], top.text) == (text, text)


def test_a_long_text_comes_in_one_piece(tmp_path):
    _, inner = elements(tmp_path, f"<top>{' ' * 70_000}<inner>{'é' * 70_000}</inner></top>", {"inner"})
    assert inner.text == "é" * 70_000


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("<a>\n<b></a>", 2, "not well-formed XML: mismatched tag"),
        ("<a>", 1, "not well-formed XML: no element found"),
        ('<!DOCTYPE a [<!ENTITY x "y">]><a>&x;</a>', 1, "a document type .<!DOCTYPE a>"),
        ("<a>\n&x;</a>", 2, "not well-formed XML: undefined entity"),
        ("<a>" * 99 + "\n" + "<a>" * 2 + "</a>" * 101, 2, "nested more than 100 deep"),
    ],
)
def test_what_is_no_plain_xml_is_refused(tmp_path, text, line, words):
    with pytest.raises(FormatError, match=words) as caught:
        elements(tmp_path, text)
    assert caught.value.line == line
