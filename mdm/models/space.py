"""Spaces: the named symbols of a model's states, actions and observations, joint over factors or agents."""

from __future__ import annotations

import difflib
import math
import operator
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import SupportsIndex, overload

from mdm.errors import ModelError

Symbol = str | SupportsIndex | Sequence[str | int]
"""A symbol of a space: its index, its name, or a name or index for each factor."""


_UNNAMED = re.compile(r"state|agent\d*")
"""Generated names of factors."""

_COMPARED = 10_000
"""The number of names compared with an unknown one for suggestions."""


class _Counted(Sequence[str]):
    """Names made of a prefix and a number, generated on access."""

    __slots__ = ("_numbers", "prefix")

    def __init__(self, prefix: str, count: int) -> None:
        self.prefix = prefix
        self._numbers = range(count)

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> str: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[str, ...]: ...

    def __getitem__(self, index: int | slice) -> str | tuple[str, ...]:
        if isinstance(index, slice):
            return tuple(f"{self.prefix}{number}" for number in self._numbers[index])
        return f"{self.prefix}{self._numbers[index]}"

    def find(self, name: str) -> int | None:
        """Return the index of a name; None if there is no such name."""
        digits = name.removeprefix(self.prefix) if name.startswith(self.prefix) else ""
        number = int(digits) if digits.isdecimal() and len(digits) < 20 else len(self)
        return number if number < len(self) and str(number) == digits else None

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.find(name) is not None

    def __eq__(self, other: object) -> bool:
        if isinstance(other, _Counted):
            return (self.prefix, self._numbers) == (other.prefix, other._numbers)
        return isinstance(other, Sequence) and len(self) == len(other) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))


class Factor:
    """One component of a space: a state factor, or one agent's actions or observations.

    Args:
        name: The component's name.
        names: Its symbols in order, or their number.
        prefix: The prefix of generated names.

    Raises:
        ModelError: If there is no symbol, a name is no text, or two have one name.

    Example::

        mdm.models.Factor("door", ["open", "closed"]).index("closed")  # 1
    """

    __slots__ = ("_index", "name", "names")

    def __init__(self, name: str, names: Iterable[str] | int, *, prefix: str = "") -> None:
        self.name = name
        self._index: dict[str, int] = {}
        if isinstance(names, int):
            self.names: Sequence[str] = _Counted(prefix, max(names, 0))
        else:
            self.names = tuple(names)
            if wrong := [symbol for symbol in self.names if not isinstance(symbol, str)]:
                raise ModelError(f"the symbols of {name!r} have names, which are texts, not {wrong[0]!r}")
            self._index = {symbol: index for index, symbol in enumerate(self.names)}
            if len(self._index) != len(self.names):
                twice = next(symbol for index, symbol in enumerate(self.names) if self._index[symbol] != index)
                raise ModelError(f"{name!r} has two symbols {twice!r}; names must differ")
        if not len(self.names):
            raise ModelError(f"{name!r} has no symbols; it needs at least one")

    def __len__(self) -> int:
        return len(self.names)

    def index(self, symbol: str | int) -> int:
        """Return the index of a symbol, given by name or by index.

        Raises:
            ModelError: If there is no such symbol; the message suggests similar ones.
        """
        # Hot path: whether something is a SupportsIndex takes a microsecond to find out.
        if symbol.__class__ is int and -1 < symbol < len(self.names):
            return symbol
        if isinstance(symbol, bool) or not isinstance(symbol, str | SupportsIndex):
            raise ModelError(f"{symbol!r} is not a symbol of {self.name!r}: give a name or an index")
        if isinstance(symbol, str):
            found = self.names.find(symbol) if isinstance(self.names, _Counted) else self._index.get(symbol)
            if found is not None:
                return found
            if not symbol.isdecimal():
                close = difflib.get_close_matches(symbol, self.names[:_COMPARED], n=3)
                known = " or ".join(map(repr, close)) if close else f"one of {', '.join(self.names[:10])}"
                raise ModelError(f"{self.name!r} has no symbol {symbol!r}; did you mean {known}?")
            symbol = int(symbol)
        if 0 <= symbol < len(self.names):
            return int(symbol)
        raise ModelError(f"{self.name!r} has no symbol {symbol}; its {len(self.names)} symbols count from 0")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Factor) and self.name == other.name and self.names == other.names

    def __hash__(self) -> int:
        return hash((self.name, len(self.names), self.names[0], self.names[-1]))

    def __repr__(self) -> str:
        return f"Factor({self.name!r}, {list(self.names)!r})"


class _JointNames(Sequence[str]):
    """The names of joint symbols, generated on access: the components' names, joined by blanks."""

    __slots__ = ("_space",)

    def __init__(self, space: Space) -> None:
        self._space = space

    def __len__(self) -> int:
        return len(self._space)

    @overload
    def __getitem__(self, index: int) -> str: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[str, ...]: ...

    def __getitem__(self, index: int | slice) -> str | tuple[str, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        if index < 0:
            index += len(self)
        if not 0 <= index < len(self):
            raise IndexError(index)
        components = self._space.unravel(index)
        return " ".join(factor.names[c] for factor, c in zip(self._space.factors, components, strict=True))

    def __iter__(self) -> Iterator[str]:
        return (self[index] for index in range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))


class Space:
    """The symbols of a model, joint over factors; the first factor is the most significant digit (row-major).

    A space of 10^6 joint symbols costs no more than its factors.

    Args:
        factors: The components, in order; a single one for a space that is not factored.

    Raises:
        ModelError: If there is no factor, or the joint symbols are too many to index.

    Example::

        robot, door = mdm.models.Factor("robot", ["hall", "lab"]), mdm.models.Factor("door", ["open", "closed"])
        states = mdm.models.Space([robot, door])
        states.index("lab open")  # 2
        states.names[3]  # 'lab closed'
    """

    __slots__ = ("__dict__", "_size", "_strides", "factors")

    def __init__(self, factors: Iterable[Factor]) -> None:
        self.factors = tuple(factors)
        if not self.factors:
            raise ModelError("a space needs at least one factor")
        strides = [1]
        for factor in reversed(self.factors[1:]):
            strides.insert(0, strides[0] * len(factor))
        self._strides = tuple(strides)
        self._size = math.prod(map(len, self.factors))
        if self._size > sys.maxsize:
            raise ModelError(f"{self._size} joint symbols are too many to index")

    @classmethod
    def single(cls, name: str, names: Iterable[str] | int, *, prefix: str = "") -> Space:
        """Return a space of one factor."""
        return cls([Factor(name, names, prefix=prefix)])

    def __len__(self) -> int:
        return self._size

    @cached_property
    def names(self) -> Sequence[str]:
        """The names of the (joint) symbols, in order; a joint name is the components' names joined by blanks."""
        return self.factors[0].names if len(self.factors) == 1 else _JointNames(self)

    @property
    def is_named(self) -> bool:
        """Whether at least one factor has a name that is not generated (``state``, ``agent``, ``agent0``, …)."""
        return not all(_UNNAMED.fullmatch(factor.name) for factor in self.factors)

    @property
    def shape(self) -> tuple[int, ...]:
        """The sizes of the factors."""
        return tuple(map(len, self.factors))

    def ravel(self, components: Sequence[int]) -> int:
        """Return the joint index of one index per factor.

        Raises:
            ModelError: If their number is wrong, or one is out of range.
        """
        if len(components) != len(self.factors):
            raise ModelError(f"a joint symbol has {len(self.factors)} components, not {len(components)}")
        total = 0
        for factor, stride, component in zip(self.factors, self._strides, components, strict=True):
            if not 0 <= component < len(factor):
                raise ModelError(f"{factor.name!r} has no symbol {component}; its {len(factor)} symbols count from 0")
            total += stride * component
        return int(total)

    def unravel(self, index: int) -> tuple[int, ...]:
        """Return the components of a joint index.

        Raises:
            ModelError: If the index is out of range.
        """
        if not 0 <= index < self._size:
            raise ModelError(f"there is no symbol {index}; the {self._size} symbols count from 0")
        return tuple(index // stride % len(factor) for stride, factor in zip(self._strides, self.factors, strict=True))

    def index(self, symbol: Symbol) -> int:
        """Return the joint index of a symbol.

        Args:
            symbol: An index, as a number or in decimal digits; a name; for a joint symbol the components' names or
                indices, joined by blanks or as a sequence. A name made of digits takes precedence over the index.

        Raises:
            ModelError: If there is no such symbol.
        """
        # Strings, numbers and tuples first: the check for SupportsIndex costs twenty times a look-up.
        if symbol.__class__ is int and -1 < symbol < self._size:
            return symbol
        if isinstance(symbol, str):
            if len(self.factors) == 1:
                return self.factors[0].index(symbol)
            if symbol.isdecimal():
                return self.index(int(symbol))
        elif isinstance(symbol, tuple | list):
            pass
        elif isinstance(symbol, SupportsIndex) and not isinstance(symbol, bool):
            index = operator.index(symbol)
            self.unravel(index)
            return index
        elif not isinstance(symbol, Sequence):
            raise ModelError(f"{symbol!r} is not a symbol: give a name, an index, or one of these for each component")
        words: Sequence[str | int] = self._words(symbol) if isinstance(symbol, str) else symbol
        if len(words) != len(self.factors):
            agents = ", ".join(factor.name for factor in self.factors)
            raise ModelError(f"{symbol!r} is not a joint symbol: it needs a component for each of {agents}")
        return self.ravel([factor.index(word) for factor, word in zip(self.factors, words, strict=True)])

    def _words(self, symbol: str) -> list[str]:
        """Return the components of a joint name; they may contain blanks themselves."""
        words = symbol.split()
        if len(words) == len(self.factors):
            return words
        found: list[tuple[list[str], str]] = [([], symbol.strip())]
        for factor in self.factors:
            found = [
                ([*before, name], rest[len(name) :].lstrip())
                for before, rest in found
                for name in factor.names
                if rest == name or rest.startswith(f"{name} ")
            ]
        whole = [names for names, rest in found if not rest]
        return whole[0] if len(whole) == 1 else words

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Space) and self.factors == other.factors

    def __hash__(self) -> int:
        return hash(self.factors)

    def __repr__(self) -> str:
        return f"Space({list(self.factors)!r})"
