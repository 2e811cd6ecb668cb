"""Names as a format can spell them: where it ends names at blanks or has signs of its own, others stand in."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from mdm.errors import ModelWarning

if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Container, Sequence

__all__ = ["Speller", "unused"]


class Speller:
    """Spells names in one word each, and tells at the end which ones it changed.

    Args:
        foreign: Matches what no name may hold.
        words: Which whole words are no names.
    """

    def __init__(self, foreign: re.Pattern[str], words: Container[str] = ()) -> None:
        self._foreign = foreign
        self._words = words
        self._changed: list[str] = []

    def spell(self, names: Sequence[str], taken: Container[str] = (), *, numbered: bool = True) -> list[str]:
        """Return the names, each in one word that none of the others is.

        Args:
            names: The names.
            taken: Words that stand for something else already.
            numbered: Whether digits alone are a name only where they are its own index.
        """
        result: list[str] = []
        used: set[str] = set()
        for index, name in enumerate(names):
            word = self._foreign.sub("_", name) or "_"
            if word in self._words or (numbered and word.isdecimal() and word != str(index)):
                word = f"_{word}"
            word = unused(word, lambda found: found in used or found in taken)
            if word != name:
                self._changed.append(f"{name!r} as {word!r}")
            used.add(word)
            result.append(word)
        return result

    def warn(self, format_name: str) -> None:
        """Warn where a name was changed."""
        if self._changed:
            some = ", ".join(self._changed[:3]) + (", …" if len(self._changed) > 3 else "")
            text = f"{len(self._changed)} names that {format_name} cannot hold were written in another way: {some}"
            warnings.warn(text, ModelWarning, stacklevel=4)


def unused(word: str, is_used: Callable[[str], bool]) -> str:
    """Return a word, or the first one made of it by a number that is not used yet."""
    found, number = word, 2
    while is_used(found):
        found, number = f"{word}_{number}", number + 1
    return found
