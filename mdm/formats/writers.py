"""The common part of writers: names as single words, distributions with the sums that the original tools ask for."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.errors import ModelWarning
from mdm.models.factored.two_slice import Node, Table
from mdm.models.matrices import csr, is_compressed

if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Container, Sequence

    from mdm.models import TwoSliceNetwork
    from mdm.models.factored.two_slice import Potential

_CLOSE = 1e-14
"""MADP takes a sum within 5e-13, added one number after the other."""


class Speller:
    """Turns names into single words, and warns of those that it changed.

    Args:
        foreign: Matches characters that are not allowed in a name.
        words: Reserved words.
        before: Put before a word that may not stand as it is.
        first: Matches the characters that a name may begin with; None for any that is allowed in it.
    """

    def __init__(
        self,
        foreign: re.Pattern[str],
        words: Container[str] = (),
        *,
        before: str = "_",
        first: re.Pattern[str] | None = None,
    ) -> None:
        self._foreign = foreign
        self._words = words
        self._before = before
        self._first = first
        self._changed: list[str] = []

    def spell(self, names: Sequence[str], taken: Container[str] = (), *, numbered: bool = True) -> list[str]:
        """Return a distinct word for each name.

        Args:
            names: The names.
            taken: Words already in use.
            numbered: Allow a name of digits only if it is its own index.
        """
        result: list[str] = []
        used: set[str] = set()
        for index, name in enumerate(names):
            word = self._foreign.sub("_", name) or "_"
            begins = self._first is None or self._first.match(word)
            if not begins or word in self._words or (numbered and word.isdecimal() and word != str(index)):
                word = f"{self._before}{word}"
            word = unused(word, lambda found: found in used or found in taken)
            if word != name:
                self._changed.append(f"{name!r} as {word!r}")
            used.add(word)
            result.append(word)
        return result

    def warn(self, format_name: str) -> None:
        """Warn if names were changed."""
        if self._changed:
            some = ", ".join(self._changed[:3]) + (", …" if len(self._changed) > 3 else "")
            text = f"{len(self._changed)} names not allowed in {format_name} were changed: {some}"
            warnings.warn(text, ModelWarning, stacklevel=4)


def unused(word: str, is_used: Callable[[str], bool]) -> str:
    """Return a word, with the first free number appended if it is used already."""
    found, number = word, 2
    while is_used(found):
        found, number = f"{word}_{number}", number + 1
    return found


def closed(distributions: Any) -> Any:
    """Return distributions along the last axis (rows of a CSR matrix), divided by their sums where these miss 1.

    A model's rows are within 1e-9 of 1. Most are closer, and stay as they are.
    """
    if not is_compressed(distributions):
        sums = np.add.accumulate(distributions, axis=-1)[..., -1:]
        return distributions / np.where(abs(sums - 1) > _CLOSE, sums, 1.0)
    sums = np.asarray(distributions.sum(axis=1)).ravel()
    sums[abs(sums - 1) <= _CLOSE] = 1
    data = distributions.data / np.repeat(sums, np.diff(distributions.indptr))
    return csr((data, distributions.indices, distributions.indptr), distributions.shape)


def initial(network: TwoSliceNetwork) -> list[Potential]:
    """Return a network's initial distributions; of those over a factor alone, the sums are as close to 1 as can be."""
    return [
        Table(each.scope, closed(each.values)) if isinstance(each, Table) and len(each.scope) == 1 else each
        for each in network.initial
    ]


def utilities(network: TwoSliceNetwork) -> tuple[Potential, ...]:
    """Return a network's utilities; one of 0 if there are none, for MADP and SARSOP need a reward."""
    return network.utilities or (Table([Node("action", 0)], np.zeros(len(network.actions.factors[0]))),)
