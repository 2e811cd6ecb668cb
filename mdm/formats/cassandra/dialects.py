"""Words of other programs' dialects of Cassandra's format, and of misspelt sections, told as what they are."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["begins_foreign", "foreign"]

_DIALECTS = {
    "E": "'E:' names end states in a dialect of ZMDP and others, which is not read: take the line out, and let these "
    "states lead to themselves",
    "atom": "'atom' names the observations or states of an atomic proposition, for temporal logic, in a dialect that "
    "is not read: take the line out, and say what is wanted by rewards (R)",
    "prio": "'prio' gives states a priority, for parity objectives, in a dialect that is not read: take the line out, "
    "and say what is wanted by rewards (R)",
}
_NUMBERED = {"atom", "prio"}
"""Words that a number follows, before the colon."""


def foreign(word: str, sections: Iterable[str] = ()) -> str | None:
    """Return what is wrong with a word where a section or statement might begin; None where nothing is known of it.

    Args:
        word: The word.
        sections: The names of sections, for what may be misspelt.
    """
    if word in _DIALECTS:
        return _DIALECTS[word]
    close = difflib.get_close_matches(word, list(sections), n=1)
    return f"there is no section {word!r}; did you mean {close[0]!r}?" if close and word not in close else None


def begins_foreign(words: Sequence[str], at: int) -> bool:
    """Whether a line of another dialect or a misspelt section may begin at a word: a colon ends its head."""
    numbered = words[at] in _NUMBERED and words[at + 1 : at + 2] != [":"]
    return words[at + 1 + numbered : at + 2 + numbered] == [":"]
