"""Names of a ProbModelXML file that MADP reads as they are meant.

MADP finds a variable by the beginning of its name, within quotes of either kind; it cuts what ends with a bracket two
characters before that, wherever it stands, and then the blanks, but for those after a first letter.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

from mdm.formats.spelling import Speller, unused

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["Names"]

_FOREIGN = "^\\s+|\\s+$|[\x00-\x1f\ud800-\udfff\ufffe\uffff]"
_BRACKETS = r"\[(?=[^\[\]]*\]$)|\]+$"
"""A bracket that ends a name, with the one that it closes."""
_SLICE = r"\s*\[[01]\]"
"""What readers take for a time slice in a name."""


class Names:
    """The names of a file's variables and their values.

    Args:
        wanted: The names that variables would have, alike or not.
        observations: The places of the observations among them.
    """

    def __init__(self, wanted: Iterable[str], observations: range) -> None:
        self._values = Speller(re.compile(f"{_FOREIGN}|{_BRACKETS}"))
        titles = Speller(re.compile(f"{_FOREIGN}|{_BRACKETS}|{_SLICE}|[\"']"))
        taken: list[str] = []
        for name in wanted:
            taken += titles.spell([name], taken, numbered=False)
        # MADP takes the first variable whose name begins with the wanted one; a slice in each name ends them.
        self._with_slices = any(after.startswith(name) for name, after in pairwise(sorted(taken)))
        self.variables = taken
        if self._with_slices:
            for place in observations:
                if len(taken[place]) == 1:
                    taken[place] = unused(f"{taken[place]}_", taken.__contains__)

    def values(self, names: Sequence[str]) -> list[str]:
        """Return the names of a variable's values."""
        return self._values.spell(names, numbered=False)

    def of(self, variable: str, time: int) -> str:
        """Return the name of a variable at a time slice, as the file has it."""
        return f"{variable} [{time}]" if self._with_slices else variable

    def warn(self) -> None:
        """Warn if names of values were changed."""
        self._values.warn("ProbModelXML")
