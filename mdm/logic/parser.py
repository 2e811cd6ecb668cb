"""Parser for formulas as text, such as ``"IsInSouthCorridor and not IsMoving"``.

In falling precedence: ``not`` (``~``, ``!``), ``and`` (``&``, ``&&``), ``xor`` (``^``), ``or`` (``|``, ``||``),
``implies`` (``->``, ``=>``, ``>>``; right-associative). Names consist of letters, digits and ``_``, with ``.``, ``/``
and ``:`` inside; other names need quotes.
"""

from __future__ import annotations

import re
from typing import ClassVar, NamedTuple

from mdm.errors import FormatError
from mdm.logic.formula import And, Constant, Formula, Implies, Not, Or, P, Xor

_TOKEN = re.compile(
    r"""\s*(?:
        (?P<operator>&&?|\|\|?|\^|~|!|->|=>|>>|\(|\))
      | (?P<name>[A-Za-z_][A-Za-z0-9_]*(?:[./:][A-Za-z0-9_]+)*)
      | "(?P<double>(?:[^"\\]|\\.)*)"
      | '(?P<single>(?:[^'\\]|\\.)*)'
      | (?P<end>\Z)
    )""",
    re.VERBOSE | re.DOTALL,
)
_SAME = {"&": "and", "&&": "and", "|": "or", "||": "or", "^": "xor", "~": "not", "!": "not"}
_SAME |= {"->": "implies", "=>": "implies", ">>": "implies"}
_BINARY: tuple[tuple[str, type[Formula]], ...] = (("or", Or), ("xor", Xor), ("and", And))
_DEEPEST = 100
_LONGEST = 250


class _Token(NamedTuple):
    kind: str
    text: str
    column: int


def parse(text: str) -> Formula:
    """Parse a formula.

    Example::

        formula = mdm.parse("IsInSouthCorridor and not IsMoving")
        formula.evaluate({"IsInSouthCorridor": True, "IsMoving": False})  # True

    Raises:
        FormatError: If the text is not a formula, with the column and the expected symbols.
    """
    return Parser.parse(text)


def _tokens(text: str, words: frozenset[str]) -> list[_Token]:
    tokens: list[_Token] = []
    position = 0
    while True:
        match = _TOKEN.match(text, position)
        if match is None:
            start = position + len(text[position:]) - len(text[position:].lstrip())
            raise FormatError(f"{text[start]!r} is not allowed in a formula: {text!r}", column=start + 1)
        kind = str(match.lastgroup)
        column = match.start(kind) + 1
        found = match.group(kind)
        if kind == "end":
            tokens.append(_Token("end", "the end", len(text) + 1))
            return tokens
        if kind == "operator":
            tokens.append(_Token(_SAME.get(found, found), found, column))
        elif kind == "name":
            tokens.append(_Token(found if found in words else "name", found, column))
        else:
            tokens.append(_Token("quoted", re.sub(r"\\(.)", r"\1", found, flags=re.DOTALL), column))
        position = match.end()


class Parser:
    """A recursive-descent parser with a method per level of precedence.

    Attributes:
        words: The words that are no names.
        prefixes: Those that come before a formula, with the formulas that they make.
        between: Those that may follow one, for a sentence.
    """

    words: ClassVar[frozenset[str]] = frozenset({"and", "or", "not", "xor", "implies"})
    prefixes: ClassVar[dict[str, type[Formula]]] = {"not": Not}
    between: ClassVar[str] = "'and', 'or', 'xor', 'implies'"

    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens = tokens
        self._position = 0
        self._depth = 0
        self._links = 0

    @classmethod
    def parse(cls, text: str) -> Formula:
        """Parse a whole text."""
        parser = cls(_tokens(text, cls.words))
        formula = parser._implication()
        parser._expect("end", f"{cls.between} or the end")
        return formula

    def _next(self) -> _Token:
        token = self._tokens[self._position]
        self._position += 1
        return token

    def _take(self, kind: str) -> bool:
        if self._tokens[self._position].kind == kind:
            self._position += 1
            return True
        return False

    def _expect(self, kind: str, expected: str) -> None:
        token = self._next()
        if token.kind != kind:
            raise FormatError(f"{expected} was expected, not {token.text!r}", column=token.column)

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > _DEEPEST:
            column = self._tokens[self._position].column
            raise FormatError(
                f"formulas nest at most {_DEEPEST} deep: define a part of this one as a predicate", column=column
            )

    def _implication(self) -> Formula:
        self._deeper()
        formula = self._binary(0)
        if self._take("implies"):
            formula = Implies(formula, self._implication())
        self._depth -= 1
        return formula

    def _binary(self, level: int) -> Formula:
        if level == len(_BINARY):
            return self._operand()
        word, kind = _BINARY[level]
        formula = self._binary(level + 1)
        while self._take(word):
            self._links += 1
            if self._links > _LONGEST:
                column = self._tokens[self._position].column
                raise FormatError(
                    f"a formula has at most {_LONGEST} connectives: define a part of this one as a predicate",
                    column=column,
                )
            formula = kind(formula, self._binary(level + 1))
        return formula

    def _operand(self) -> Formula:
        return self._prefixed()

    def _prefixed(self) -> Formula:
        kind = self.prefixes.get(self._tokens[self._position].kind)
        if kind is None:
            return self._atom()
        self._position += 1
        self._deeper()
        formula = kind(self._prefixed())
        self._depth -= 1
        return formula

    def _atom(self) -> Formula:
        token = self._next()
        if token.kind == "(":
            formula = self._implication()
            self._expect(")", "')'")
            return formula
        if token.kind == "quoted":
            return P(token.text)
        if token.kind == "name":
            return Constant(token.text == "true") if token.text in {"true", "false"} else P(token.text)
        raise FormatError(
            f"a name, {', '.join(map(repr, self.prefixes))} or '(' was expected, not {token.text!r}",
            column=token.column,
        )
