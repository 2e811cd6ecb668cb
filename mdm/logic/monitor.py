"""Monitors: formulas in time over predicates, as ``"G(not Stairs) and F(Dock)"``, with verdicts on valuations so far.

``X p``: there is a next valuation, and p holds there; ``p U q``: q comes to hold, and p does until then; ``F p``: p
comes to hold; ``G p``: it always does. Prefixes bind most, then ``U`` (right-associative), then the words of plain
formulas. A trace ends, and a formula holds of it or not (G. De Giacomo, M. Y. Vardi, IJCAI 2013); it has a verdict once
all continuations agree (A. Bauer, M. Leucker, C. Schallhart, TOSEM 2011, section 2).

A future says which parts in time hold at the next place of a trace. Read backwards, a trace leads from the future at
its end to all others that there are. A state is the set of futures with which the formula holds: progression
(F. Bacchus, F. Kabanza, AI 2000, section 4), with formulas of one meaning as one. A state without futures is false for
ever, one with all of them true for ever: verdicts are exact. Cost: 2^N steps for each state and each future of N
predicates, once; an update is one look-up.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING, Any, ClassVar

from mdm.errors import Error
from mdm.logic.formula import CODES, FALSE, TRUE, UNKNOWN, Formula
from mdm.logic.parser import Parser

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Table = tuple[list[list[int]], list[tuple[bool | None, bool]], dict[frozenset[int], "_Node"]]
    """The next state by state and valuation, of which a predicate is a bit; verdicts and values by state; nodes."""

_PREDICATES, _STATES = 8, 512
"""The most of a monitor."""


class _Timed(Formula):
    """A part in time: its value depends on its future, which is ``at_end`` at the end of a trace."""

    _level, word, at_end = 6, "", False

    def __str__(self) -> str:
        return f"{self.word}({self.parts[0]})"


class _Next(_Timed):
    word = "X"

    def evaluate(self, values: Mapping[Any, bool | None]) -> bool | None:
        return values[id(self)]


class _Finally(_Timed):
    word = "F"

    def evaluate(self, values: Mapping[Any, bool | None]) -> bool | None:
        return self.parts[0].evaluate(values) or values[id(self)]


class _Always(_Timed):
    word, at_end = "G", True

    def evaluate(self, values: Mapping[Any, bool | None]) -> bool | None:
        return self.parts[0].evaluate(values) and values[id(self)]


class _Until(_Timed):
    _level = 5

    def evaluate(self, values: Mapping[Any, bool | None]) -> bool | None:
        return self.parts[1].evaluate(values) or (self.parts[0].evaluate(values) and values[id(self)])

    def __str__(self) -> str:
        return f"{self._text(self.parts[0], 6)} U {self._text(self.parts[1], 5)}"


class _Parser(Parser):
    words: ClassVar = Parser.words | {"X", "F", "G", "U"}
    prefixes: ClassVar = {**Parser.prefixes, "G": _Always, "F": _Finally, "X": _Next}
    between = "'U', " + Parser.between

    def _operand(self) -> Formula:
        formula = self._prefixed()
        if self._take("U"):
            self._deeper()
            formula = _Until(formula, self._operand())
            self._depth -= 1
        return formula


class Monitor:
    """A formula in time, with its verdict after the valuations so far.

    A valuation with unknown predicates stands for one or more in which these have any values. The formula may then be
    in several states; a verdict is one on which all of them agree.

    Raises:
        FormatError: If the text is no formula, with the column and the words expected.
        Error: If it has no predicate, more than 8, or more than 512 states.

    Example::

        monitor = mdm.logic.Monitor("G(not Stairs) and F(Dock)")
        monitor.update({"Stairs": False, "Dock": True})  # None: open
        monitor.update({"Stairs": True, "Dock": False})  # False, for ever
    """

    __slots__ = ("formula", "names", "node")

    def __init__(self, formula: Formula | str) -> None:
        self.formula = _Parser.parse(formula) if isinstance(formula, str) else formula
        self.names = tuple(sorted(self.formula.names))
        self.node = _start(self.formula)

    @property
    def verdict(self) -> bool | None:
        """True or False where the formula is so for ever; None while that is open."""
        return self.node.verdict

    @property
    def holds(self) -> bool | None:
        """Whether the formula holds if nothing follows; None where unknown predicates leave that open."""
        return self.node.holds

    def update(self, values: Mapping[str, bool | None]) -> bool | None:
        """Take the next valuation; return the verdict."""
        codes = tuple([CODES[values[name]] for name in self.names])
        self.node = self.node[codes if len(codes) > 1 else codes[0]]
        return self.node.verdict

    def compiled(self, index: Mapping[str, int]) -> Callable[[list[int]], int]:
        """Return a function that takes the next valuation of coded values at these places: see `compile_formula`."""
        read = itemgetter(*(index[name] for name in self.names))

        def take(values: list[int]) -> int:
            node = self.node = self.node[read(values)]
            return FALSE if node.verdict is False else TRUE

        return take


class _Node(dict[Any, "_Node"]):
    """The states that a monitor may be in, with the next node by codes of a valuation: found when first needed."""

    def __init__(self, table: Table, states: frozenset[int]) -> None:
        self.table, self._states = table, states
        verdicts, held = ({table[1][state][which] for state in states} for which in (0, 1))
        self.verdict = verdicts.pop() if len(verdicts) == 1 else None
        self.holds = held.pop() if len(held) == 1 else None

    def __missing__(self, codes: tuple[int, ...] | int) -> _Node:
        """Find the next node; unknown predicates have all values, one after the other, in any order."""
        (rows, _, nodes), each = self.table, codes if isinstance(codes, tuple) else (codes,)
        bits = [(0, 1) if code == UNKNOWN else (code // TRUE,) for code in each]
        valuations = [sum(bit << place for place, bit in enumerate(one)) for one in product(*bits)]
        found, before = frozenset([rows[state][one] for state in self._states for one in valuations]), self._states
        while UNKNOWN in each and found != before:
            found, before = found | {rows[state][one] for state in found for one in valuations}, found
        if found not in nodes:
            nodes[found] = _Node(self.table, found)
        self[codes] = nodes[found]
        return nodes[found]


@lru_cache(maxsize=256)
def _start(formula: Formula) -> _Node:
    """Return where the monitors of a formula start."""
    names = sorted(formula.names)
    if not 0 < len(names) <= _PREDICATES:
        text = f"a monitor has 1 to {_PREDICATES} predicates, not {len(names)}"
        raise Error(f"{text}: define a part as a predicate of its own" if names else text)
    parts: list[Formula] = [_Next(formula)]
    for part in parts:
        parts += part.parts
    timed = [part for part in parts if isinstance(part, _Timed)]

    def before(future: Any, valuation: int) -> Any:
        values: dict[Any, bool] = {name: bool(valuation >> place & 1) for place, name in enumerate(names)}
        values.update(zip(map(id, timed), future, strict=True))
        return tuple([(each.parts[0] if isinstance(each, _Next) else each).evaluate(values) for each in timed])

    futures: dict[Any, int] = {tuple([part.at_end for part in timed]): 0}
    rows = _explored(futures, len(names), before)

    def behind(state: Any, valuation: int) -> Any:
        return frozenset([future for future, row in enumerate(rows) if row[valuation] in state])

    states: dict[Any, int] = {frozenset([place for future, place in futures.items() if future[0]]): 0}
    following = _explored(states, len(names), behind)
    told = [(None if 0 < len(state) < len(futures) else bool(state), 0 in state) for state in states]
    return _Node((following, told, {}), frozenset([0]))


def _explored(found: dict[Any, int], size: int, following: Callable[[Any, int], Any]) -> list[list[int]]:
    """Number all that follow by valuations of so many predicates; return the next number by number and valuation."""
    rows: list[list[int]] = []
    for each in (waiting := list(found)):
        rows.append([])
        for valuation in range(1 << size):
            other = following(each, valuation)
            if other not in found:
                found[other] = len(found)
                waiting.append(other)
            rows[-1].append(found[other])
        if len(found) > _STATES:
            raise Error(f"the formula has more than {_STATES} states in time: divide it into several monitors")
    return rows
