"""Texts from outside, such as those of exceptions, made fit for every record, page and terminal."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from msgspec import Meta

__all__ = ["FINITE", "counted", "encodable", "in_words", "texts_in"]

_LONGEST = 4_000
"""Characters: a page keeps thousands of texts."""
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(9), 11, 12, *range(14, 32), 127)}

FINITE = sys.float_info.max
"""A bound of numbers that may be as large as they like, but not infinite."""
_EXPECTED = re.compile(r"Expected `(?P<kinds>[^`]+)`(?: (?P<sign>[<>]=?) (?P<limit>[\d.e+-]+))?(?:, got `[^`]+`)?")
_KINDS = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}
_KINDS |= {"object": "a table"}
_LIMITS = {">": "above", ">=": "of at least", "<": "below", "<=": "at most"}
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


def in_words(text: str, value: Any, place: str, bounds: Meta | None = None, choices: Sequence[str] = ()) -> str:
    """Return what msgspec says of a value at a place, such as ``.actions[1]``, in the words of who wrote the file.

    Args:
        text: What msgspec says.
        value: The whole value.
        place: The place.
        bounds: The bounds of numbers there, and their ``unit`` among the extras.
        choices: The texts that are allowed there, if these are not all.
    """
    for name, index in _STEP.findall(place):
        value = value[int(index)] if index else value[name]
    found = "a table" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
    found = found.lower() if isinstance(value, bool) else found
    if choices:
        return f"{found} is not one of {', '.join(map(repr, choices))}"
    expected = _EXPECTED.fullmatch(text.replace(" | null", ""))  # TOML has none
    if expected is None:
        return text
    kinds = " or ".join(_KINDS.get(kind, kind) for kind in expected["kinds"].split(" | "))
    if bounds is None:
        limits = [(expected["sign"], expected["limit"])]
    else:
        kinds = kinds.replace("number", f"number of {bounds.extra['unit']}") if bounds.extra else kinds
        finite = bounds.le == FINITE
        kinds = kinds.replace("a number", "a finite number") if finite else kinds
        limits = [(">", bounds.gt), (">=", bounds.ge), ("<", bounds.lt), ("<=", None if finite else bounds.le)]
    limit = " and".join(f" {_LIMITS[sign]} {float(limit):,.10g}" for sign, limit in limits if limit is not None)
    return f"{kinds}{limit} was expected, not {found}"


def encodable(text: str) -> str:
    """Return a text with lone surrogates and control characters escaped, cut where it is longer than 4,000."""
    text = str.__str__(text)  # of a class of the program's own, too
    if len(text) <= _LONGEST and text.isprintable():
        return text
    told = text[:_LONGEST].encode("utf-8", "backslashreplace").decode().translate(_CONTROLS)
    if len(text) <= _LONGEST >= len(told):
        return told
    return f"{told[: _LONGEST - 40]}… ({len(text):,} characters)"
