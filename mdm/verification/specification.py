"""Specifications: questions about a model or a policy, as text such as ``P(reach pit-* before goal)``.

Kinds: ``P(reach X)``, ``P(always X)``, ``E(steps until X)`` and ``S(X)``, the long-run share of steps. ``within N`` and
``before Y`` may follow ``reach X``. X and Y are formulas, with ``not`` before ``and`` before ``or``. Their atoms are
states, patterns of them (``pit-*``), values of a factor (``position = stairs``) and actions (``action = Grab``).
"""

from __future__ import annotations

import difflib
import re
import warnings
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from mdm.errors import FormatError, ModelError, ModelWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from mdm.models import MDP

    Mask = npt.NDArray[np.bool_]

_TOKEN = re.compile(r"""\s*(?:(?P<sign>[()])|"(?P<double>[^"]*)"|'(?P<single>[^']*)'|(?P<word>[^\s()"'][^\s()]*)|\Z)""")
_WORDS = frozenset({"not", "and", "or", "within", "before"})
_DEEPEST = 100
_COMPARED = 10_000
"""The names that an unknown one is compared with."""


class Specification(NamedTuple):
    """A question about a model.

    Args:
        text: As it was given.
        kind: ``P`` for a probability, ``E`` for an expectation of steps, ``S`` for a share of steps.
        target: X: for each state and action whether it holds where that action is taken there, S x (A + 1). The last
            column is for a plan that has ended, whose state stays as it is.
        before: Y, in the same form; None where there is none.
        within: The most steps; None without a limit.
        always: Whether the probability is that of never reaching ``target``.
    """

    text: str
    kind: Literal["P", "E", "S"]
    target: Mask
    before: Mask | None = None
    within: int | None = None
    always: bool = False

    @classmethod
    def of(cls, text: str, model: MDP) -> Specification:
        """Parse a specification for a model.

        Warns of a formula that holds nowhere.

        Raises:
            FormatError: If the text is none: with the column, and the words expected there.
            ModelError: If the model has no such name: with those like it.

        Example::

            asked = Specification.of("P(reach position = stairs before goal within 50)", model)
            asked.target[:, 0]  # the states at the stairs
        """
        return _Parser(text, model).whole()


class _Token(NamedTuple):
    kind: str
    text: str
    column: int


def _tokens(text: str) -> list[_Token]:
    tokens, position = [], 0
    while (match := _TOKEN.match(text, position)) is not None and match.lastgroup is not None:
        kind, found = match.lastgroup, match[match.lastgroup]
        if kind == "sign" or (kind == "word" and found in _WORDS):
            kind = found
        tokens.append(_Token(kind, found, match.start(match.lastgroup) + 1))
        position = match.end()
    if match is None:
        column = len(text) - len(text[position:].lstrip()) + 1
        raise _unparsed(f"the quotation that begins with {text[column - 1 :][:10]!r} has no end", column)
    return [*tokens, _Token("end", "the end", len(text) + 1)]


def _unparsed(problem: str, column: int) -> FormatError:
    return FormatError(f"the specification does not parse at column {column}: {problem}")


class _Parser:
    """A recursive-descent parser that evaluates formulas on the way."""

    def __init__(self, text: str, model: MDP) -> None:
        self._text = text
        self._model = model
        self._tokens = _tokens(text)
        self._at = 0
        self._depth = 0

    def whole(self) -> Specification:
        kind = self._keyword("P", "E", "S")
        self._expect("(")
        found = Specification(self._text, "S", np.empty(0, dtype=np.bool_))
        if kind == "S":
            found = found._replace(target=self._formula())
        elif kind == "E":
            self._keyword("steps")
            self._keyword("until")
            found = found._replace(kind="E", target=self._formula())
        elif self._keyword("reach", "always") == "always":
            found = found._replace(kind="P", target=~self._formula(told=False), always=True)
        else:
            found = found._replace(kind="P", target=self._formula())
            while self._tokens[self._at].kind in {"within", "before"}:
                if self._next().kind == "before":
                    found = found._replace(before=self._formula())
                else:
                    found = found._replace(within=self._number())
        self._expect(")", "'and', 'or' or ')'")
        self._expect("end", "the end")
        return found

    def _next(self) -> _Token:
        token = self._tokens[self._at]
        self._at += token.kind != "end"
        return token

    def _refuse(self, expected: str, token: _Token) -> FormatError:
        found = token.text if token.kind == "end" else repr(token.text)
        return _unparsed(f"{expected} was expected, not {found}", token.column)

    def _keyword(self, *words: str) -> str:
        token = self._next()
        if token.text not in words or token.kind != "word":
            raise self._refuse(" or ".join(map(repr, words)), token)
        return token.text

    def _expect(self, kind: str, expected: str = "") -> None:
        token = self._next()
        if token.kind != kind:
            raise self._refuse(expected or repr(kind), token)

    def _number(self) -> int:
        token = self._next()
        if not (token.text.isascii() and token.text.isdecimal()):
            raise self._refuse("a whole number of steps", token)
        return int(token.text)

    def _formula(self, *, told: bool = True) -> Mask:
        """Return where a formula holds, and warn where that is nowhere."""
        first = self._tokens[self._at]
        found = self._either()
        size, actions = len(self._model.state_space), len(self._model.action_space)
        whole = np.broadcast_to(found, (size, actions + 1))
        if told and not found.any():
            part = self._text[first.column - 1 : self._tokens[self._at].column - 1].strip()
            warnings.warn(f"nothing in the model satisfies {part}", ModelWarning, stacklevel=5)
        return whole

    def _either(self) -> Mask:
        found = self._both()
        while self._tokens[self._at].kind == "or":
            self._next()
            found = found | self._both()
        return found

    def _both(self) -> Mask:
        found = self._negation()
        while self._tokens[self._at].kind == "and":
            self._next()
            found = found & self._negation()
        return found

    def _negation(self) -> Mask:
        token = self._next()
        if token.kind not in {"not", "("}:
            return self._atom(token)
        self._depth += 1
        if self._depth > _DEEPEST:
            raise _unparsed(f"formulas nest at most {_DEEPEST} deep", token.column)
        if token.kind == "not":
            found = ~self._negation()
        else:
            found = self._either()
            self._expect(")", "'and', 'or' or ')'")
        self._depth -= 1
        return found

    def _atom(self, token: _Token) -> Mask:
        if token.kind not in {"word", "double", "single"}:
            raise self._refuse("a state, 'factor = value', 'action = NAME', 'not' or '('", token)
        if self._tokens[self._at].text == "=" and self._tokens[self._at].kind == "word":
            self._next()
            value = self._next()
            if value.kind not in {"word", "double", "single"}:
                raise self._refuse(f"a value of {token.text!r}", value)
            return self._value(token.text, value)
        names = self._model.state_space.names
        if token.kind == "word" and "=" in token.text and token.text not in names:
            name, _, text = token.text.partition("=")
            if name and text:
                return self._value(name, _Token("word", text, token.column))
        return self._chosen(names, token, "state", self._model.state_space.index)[:, None]

    def _value(self, name: str, value: _Token) -> Mask:
        """Return where a factor has a value, or an action, or an agent's part of it, is taken."""
        model = self._model
        for space, is_state in ((model.state_space, True), (model.action_space, False)):
            for place, factor in enumerate(space.factors):
                if factor.name == name:
                    chosen = self._chosen(factor.names, value, "value", factor.index, f" of {name!r}")
                    part = np.arange(len(space)) // int(np.prod(space.shape[place + 1 :])) % len(factor)
                    return chosen[part][:, None] if is_state else _taken(chosen[part])
        if name == "action":
            return _taken(self._chosen(model.action_space.names, value, "action", model.action_space.index))
        known = [factor.name for space in (model.state_space, model.action_space) for factor in space.factors]
        raise ModelError(f"the model has no factor {name!r}; {_nearest(name, [*known, 'action'])}")

    def _chosen(
        self, names: Sequence[str], token: _Token, what: str, index: Callable[[str], int], of: str = ""
    ) -> Mask:
        """Return which of some names an atom stands for: one of them, or those that a pattern fits."""
        chosen = np.zeros(len(names), dtype=np.bool_)
        text = token.text
        try:
            chosen[index(text)] = True
        except ModelError:
            if token.kind != "word" or not any(sign in text for sign in "*?["):
                raise ModelError(f"the model has no {what} {text!r}{of}; {_nearest(text, names)}") from None
            chosen[[place for place, name in enumerate(names) if fnmatchcase(name, text)]] = True
        return chosen


def _taken(chosen: Mask) -> Mask:
    """Return a mask of actions, where no action is taken behind a plan's end."""
    return np.append(chosen, False)[None, :]


def _nearest(name: str, names: Sequence[str]) -> str:
    """Return the names that are like an unknown one, or some of them, as the end of a sentence."""
    close = difflib.get_close_matches(name, list(names[:_COMPARED]), n=3)
    if close:
        return f"did you mean {' or '.join(map(repr, close))}?"
    more = ", …" if len(names) > 10 else ""
    return f"it has {', '.join(map(repr, names[:10]))}{more}"
