"""Formulas of Kleene's strong three-valued propositional logic, and their functions over a list of values.

A value is ``True``, ``False`` or ``None`` (unknown). A conjunction is false if any part is false, else unknown if any
part is unknown, and so on (S. C. Kleene, *Introduction to Metamathematics*, 1952, section 64). In functions values are
coded as 0 (false), 1 (unknown) and 2 (true), so that a connective is a lookup in a table of nine.
"""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, NoReturn, cast
from weakref import WeakValueDictionary

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import CodeType

_BARE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:[./:][A-Za-z0-9_]+)*")
_DEEPEST = 270
_WORDS = frozenset({"and", "or", "not", "xor", "implies", "true", "false", "X", "F", "G", "U"})
FALSE, UNKNOWN, TRUE = 0, 1, 2
CODES = {False: FALSE, None: UNKNOWN, True: TRUE}
_PAIRS = [(left, right) for left in range(3) for right in range(3)]
_TABLES = {
    "AND": tuple(min(left, right) for left, right in _PAIRS),
    "OR": tuple(max(left, right) for left, right in _PAIRS),
    "XOR": tuple(UNKNOWN if UNKNOWN in pair else TRUE * (pair[0] != pair[1]) for pair in _PAIRS),
    "IMPLIES": tuple(max(TRUE - left, right) for left, right in _PAIRS),
}
_SCOPE: dict[str, object] = dict(_TABLES)
# Networks that are alike, such as those of many robots, share their functions: what is shared stays in the cache.
_FUNCTIONS: WeakValueDictionary[CodeType, Callable[[list[int]], int]] = WeakValueDictionary()


class Formula:
    """A formula, built from `P` with ``&``, ``|``, ``^``, ``~`` and ``>>`` (implication), or by `parse`.

    In Python ``>>`` binds tighter than ``&``, so put parentheses around implications. Formulas are immutable, compare
    by structure and are hashable.

    Example::

        waiting = mdm.P("PersonIsNear") & ~mdm.P("IsMoving")
        waiting == mdm.parse("PersonIsNear and not IsMoving")  # True
        waiting.evaluate({"PersonIsNear": None, "IsMoving": True})  # False
    """

    __slots__ = ("depth", "parts")
    _symbol = ""
    _level = 0

    def __init__(self, *parts: Formula) -> None:
        self.parts = parts
        self.depth: int = 1 + max((part.depth for part in parts), default=0)
        if self.depth > _DEEPEST:
            raise Error(f"a formula nests at most {_DEEPEST} deep: define a part of this one as a predicate of its own")

    @property
    def names(self) -> frozenset[str]:
        """The names of all predicates and events in the formula."""
        names: set[str] = set()
        waiting: list[Formula] = [self]
        while waiting:
            formula = waiting.pop()
            if isinstance(formula, P):
                names.add(formula.name)
            waiting += formula.parts
        return frozenset(names)

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the formula's value for given values of its names."""
        raise NotImplementedError

    def __and__(self, other: Formula | bool) -> Formula:
        return And(self, _formula(other))

    def __rand__(self, other: bool) -> Formula:
        return And(_formula(other), self)

    def __or__(self, other: Formula | bool) -> Formula:
        return Or(self, _formula(other))

    def __ror__(self, other: bool) -> Formula:
        return Or(_formula(other), self)

    def __xor__(self, other: Formula | bool) -> Formula:
        return Xor(self, _formula(other))

    def __rxor__(self, other: bool) -> Formula:
        return Xor(_formula(other), self)

    def __rshift__(self, other: Formula | bool) -> Formula:
        return Implies(self, _formula(other))

    def __rrshift__(self, other: bool) -> Formula:
        return Implies(_formula(other), self)

    def __invert__(self) -> Formula:
        return Not(self)

    def __bool__(self) -> NoReturn:
        raise TypeError("a formula has no truth value: combine formulas with &, |, ^ and ~, not with and, or, not")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Formula) and type(self) is type(other) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash((type(self), self._key()))

    def _key(self) -> object:
        return self.parts

    def _text(self, part: Formula, level: int) -> str:
        return f"({part})" if part._level < level else str(part)

    def __repr__(self) -> str:
        return f"parse({str(self)!r})"


class P(Formula):
    """A predicate or event by name; ``P("robot2/IsMoving")`` belongs to another agent.

    Example::

        idle = ~mdm.P("IsMoving")
        idle.evaluate({"IsMoving": False})  # True
    """

    __slots__ = ("name",)
    _level = 7

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the named value."""
        return values[self.name]

    def _key(self) -> object:
        return self.name

    def __str__(self) -> str:
        if _BARE.fullmatch(self.name) and self.name not in _WORDS:
            return self.name
        return '"' + self.name.replace("\\", "\\\\").replace('"', '\\"') + '"'


class Constant(Formula):
    """The constant true or false."""

    __slots__ = ("value",)
    _level = 7

    def __init__(self, value: bool) -> None:
        super().__init__()
        self.value = value

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the constant."""
        return self.value

    def _key(self) -> object:
        return self.value

    def __str__(self) -> str:
        return "true" if self.value else "false"


class Not(Formula):
    """True if its part is false."""

    __slots__ = ()
    _level = 6

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the opposite of the part, or unknown if that is unknown."""
        value = self.parts[0].evaluate(values)
        return None if value is None else not value

    def __str__(self) -> str:
        return f"not {self._text(self.parts[0], 6)}"


class _Binary(Formula):
    """Two parts with a word between them, of which the left one may be alike; of an implication the right one."""

    __slots__ = ()
    word = ""

    def __str__(self) -> str:
        left, right = self.parts
        right_first = self.word == "implies"
        return (
            f"{self._text(left, self._level + right_first)} {self.word} "
            f"{self._text(right, self._level + (not right_first))}"
        )


class And(_Binary):
    """True if both parts are."""

    __slots__ = ()
    _level, word = 4, "and"

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return false if a part is false, else unknown if a part is unknown, else true."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is False or right is False:
            return False
        return None if left is None or right is None else True


class Xor(_Binary):
    """True if exactly one of two parts is."""

    __slots__ = ()
    _level, word = 3, "xor"

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return whether the parts differ, or unknown if either is unknown."""
        left, right = (part.evaluate(values) for part in self.parts)
        return None if left is None or right is None else left is not right


class Or(_Binary):
    """True if a part is."""

    __slots__ = ()
    _level, word = 2, "or"

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return true if a part is true, else unknown if a part is unknown, else false."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is True or right is True:
            return True
        return None if left is None or right is None else False


class Implies(_Binary):
    """False only if the first part is true and the second is false."""

    __slots__ = ()
    _level, word = 1, "implies"

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the value of ``not first or second``."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is False or right is True:
            return True
        return None if left is None or right is None else False


def _formula(value: Formula | bool) -> Formula:
    if isinstance(value, Formula):
        return value
    if isinstance(value, bool):
        return Constant(value)
    raise TypeError(f"a formula can be combined with a formula or a bool, not with {value!r}")


def compile_formula(formula: Formula, index: Mapping[str, int]) -> Callable[[list[int]], int]:
    """Compile a formula to a function of a list of coded values; ``index`` maps names to places in the list.

    The code is generated from our own tree only. It costs 60 ns for ``a and not b``, a third of nested calls.
    """
    return _function(_expression(formula, index))


def compile_latch(on: Formula, off: Formula, index: Mapping[str, int], own: int) -> Callable[[list[int]], int]:
    """Compile a latch: false if ``off`` is true, else true if ``on`` is true, else unchanged."""
    turn_on, turn_off = compile_formula(on, index), compile_formula(off, index)

    def latch(values: list[int]) -> int:
        if turn_off(values) == TRUE:
            return FALSE
        return TRUE if turn_on(values) == TRUE else values[own]

    return latch


def compile_hold(formula: int, flag: int) -> Callable[[list[int]], int]:
    """Compile a hold: the value of its flag if the formula is true, else the value of the formula."""

    def hold(values: list[int]) -> int:
        value = values[formula]
        return values[flag] if value == TRUE else value

    return hold


def _function(body: ast.expr) -> Callable[[list[int]], int]:
    arguments = ast.arguments(posonlyargs=[], args=[ast.arg("v")], kwonlyargs=[], kw_defaults=[], defaults=[])
    tree = ast.fix_missing_locations(ast.Expression(ast.Lambda(arguments, body)))
    code = compile(tree, "<formula>", "eval")
    found = _FUNCTIONS.get(code)
    if found is None:
        found = _FUNCTIONS[code] = cast("Callable[[list[int]], int]", eval(code, _SCOPE))  # noqa: S307
    return found


def _expression(formula: Formula, index: Mapping[str, int]) -> ast.expr:
    if isinstance(formula, P):
        return ast.Subscript(ast.Name("v", ast.Load()), ast.Constant(index[formula.name]), ast.Load())
    if isinstance(formula, Constant):
        return ast.Constant(TRUE if formula.value else FALSE)
    parts = [_expression(part, index) for part in formula.parts]
    if isinstance(formula, Not):
        return ast.BinOp(ast.Constant(TRUE), ast.Sub(), parts[0])
    assert isinstance(formula, _Binary)
    row = ast.BinOp(ast.BinOp(ast.Constant(3), ast.Mult(), parts[0]), ast.Add(), parts[1])
    return ast.Subscript(ast.Name(formula.word.upper(), ast.Load()), row, ast.Load())
