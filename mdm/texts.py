"""Texts from outside, such as those of exceptions, made fit for every record, page and terminal."""

from __future__ import annotations

__all__ = ["encodable"]

_LONGEST = 4_000
"""Characters: a page keeps thousands of texts."""
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(9), 11, 12, *range(14, 32), 127)}


def encodable(text: str) -> str:
    """Return a text with lone surrogates and control characters escaped, cut where it is longer than 4,000."""
    text = str.__str__(text)  # of a class of the program's own, too
    if len(text) <= _LONGEST and text.isprintable():
        return text
    told = text[:_LONGEST].encode("utf-8", "backslashreplace").decode().translate(_CONTROLS)
    if len(text) <= _LONGEST >= len(told):
        return told
    return f"{told[: _LONGEST - 40]}… ({len(text):,} characters)"
