"""Texts from outside, such as those of exceptions, made fit for every record, page and terminal."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["counted", "encodable", "in_words", "texts_in"]

_LONGEST = 4_000
"""Characters: a page keeps thousands of texts."""
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(9), 11, 12, *range(14, 32), 127)}

_EXPECTED = re.compile(r"Expected `(?P<kinds>[^`]+)`(?: (?P<sign>[<>]=?) (?P<limit>[\d.e+-]+))?(?:, got `[^`]+`)?")
_KINDS = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}
_KINDS |= {"object": "a table"}
_LIMITS = {">": "above", ">=": "of at least", "<": "below", "<=": "of at most"}
_STEP = re.compile(r"\.([^.\[]+)|\[(\d+)\]")


def counted(number: int, noun: str, form: str = "") -> str:
    """Return a number in a form with its noun: ``1 action``, ``2 actions``."""
    return f"{number:{form}} {noun}" if number == 1 else f"{number:{form}} {noun}s"


def texts_in(value: Any) -> Iterator[str]:
    """Yield the texts in tables and lists, however deep."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from texts_in(inner)


def in_words(text: str, value: Any, place: str) -> str:
    """Return what msgspec says of a value at a place, such as ``.actions[1]``, in the words of who wrote the file."""
    expected = _EXPECTED.fullmatch(text.replace(" | null", ""))  # TOML has none
    if expected is None:
        return text
    kinds = " or ".join(_KINDS.get(kind, kind) for kind in expected["kinds"].split(" | "))
    limit = f" {_LIMITS[expected['sign']]} {float(expected['limit']):,.10g}" if expected["sign"] else ""
    for name, index in _STEP.findall(place):
        value = value[int(index)] if index else value[name]
    found = "a table" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
    return f"{kinds}{limit} was expected, not {found.lower() if isinstance(value, bool) else found}"


def encodable(text: str) -> str:
    """Return a text with lone surrogates and control characters escaped, cut where it is longer than 4,000."""
    text = str.__str__(text)  # of a class of the program's own, too
    if len(text) <= _LONGEST and text.isprintable():
        return text
    told = text[:_LONGEST].encode("utf-8", "backslashreplace").decode().translate(_CONTROLS)
    if len(text) <= _LONGEST >= len(told):
        return told
    return f"{told[: _LONGEST - 40]}… ({len(text):,} characters)"
