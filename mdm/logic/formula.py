"""Formulas of Kleene's strong three-valued propositional logic.

A value is ``True``, ``False`` or ``None`` (unknown). A conjunction is false if any part is false, else unknown if any
part is unknown, and so on (S. C. Kleene, *Introduction to Metamathematics*, 1952, section 64).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NoReturn

from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["And", "Constant", "Formula", "Implies", "Not", "Or", "P", "Xor"]

_BARE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:[./:][A-Za-z0-9_]+)*")
_DEEPEST = 270
_WORDS = frozenset({"and", "or", "not", "xor", "implies", "true", "false"})


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
    _level = 6

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
    _level = 6

    def __init__(self, value: bool) -> None:
        super().__init__()
        self.value = value

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:  # noqa: ARG002
        """Return the constant."""
        return self.value

    def _key(self) -> object:
        return self.value

    def __str__(self) -> str:
        return "true" if self.value else "false"


class Not(Formula):
    """True if its part is false."""

    __slots__ = ()
    _level = 5

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the opposite of the part, or unknown if that is unknown."""
        value = self.parts[0].evaluate(values)
        return None if value is None else not value

    def __str__(self) -> str:
        return f"not {self._text(self.parts[0], 5)}"


class And(Formula):
    """True if both parts are."""

    __slots__ = ()
    _level = 4

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return false if a part is false, else unknown if a part is unknown, else true."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is False or right is False:
            return False
        return None if left is None or right is None else True

    def __str__(self) -> str:
        return f"{self._text(self.parts[0], 4)} and {self._text(self.parts[1], 5)}"


class Xor(Formula):
    """True if exactly one of two parts is."""

    __slots__ = ()
    _level = 3

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return whether the parts differ, or unknown if either is unknown."""
        left, right = (part.evaluate(values) for part in self.parts)
        return None if left is None or right is None else left is not right

    def __str__(self) -> str:
        return f"{self._text(self.parts[0], 3)} xor {self._text(self.parts[1], 4)}"


class Or(Formula):
    """True if a part is."""

    __slots__ = ()
    _level = 2

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return true if a part is true, else unknown if a part is unknown, else false."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is True or right is True:
            return True
        return None if left is None or right is None else False

    def __str__(self) -> str:
        return f"{self._text(self.parts[0], 2)} or {self._text(self.parts[1], 3)}"


class Implies(Formula):
    """False only if the first part is true and the second is false."""

    __slots__ = ()
    _level = 1

    def evaluate(self, values: Mapping[str, bool | None]) -> bool | None:
        """Return the value of ``not first or second``."""
        left, right = (part.evaluate(values) for part in self.parts)
        if left is False or right is True:
            return True
        return None if left is None or right is None else False

    def __str__(self) -> str:
        return f"{self._text(self.parts[0], 2)} implies {self._text(self.parts[1], 1)}"


def _formula(value: Formula | bool) -> Formula:
    if isinstance(value, Formula):
        return value
    if isinstance(value, bool):
        return Constant(value)
    raise TypeError(f"a formula can be combined with a formula or a bool, not with {value!r}")
