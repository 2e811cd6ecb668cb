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
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from mdm.errors import FormatError, ModelError, ModelWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from mdm.models import MDP

    Mask = npt.NDArray[np.bool_]

_TOKEN = re.compile(r"""\s*(?:([()])|(?P<quote>["'])(?P<quoted>.*?)(?P=quote)|([^\s()"'][^\s()]*)|\Z)""", re.DOTALL)
_END, _MORE = "the end", "'and', 'or' or ')'"
_RESERVED = frozenset({"not", "and", "or", "within", "before", "(", ")", _END})
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
    def of(cls, text: str, model: MDP, *, until: bool = False) -> Specification:
        """Parse a specification for a model, or with ``until`` the part behind ``reach``.

        Warns of a formula that holds nowhere.

        Raises:
            FormatError: If the text is none: with the column, and the words expected there.
            ModelError: If the model has no such name: with those like it.

        Example::

            asked = Specification.of("P(reach position = stairs before goal within 50)", model)
            asked.target[:, 0]  # the states at the stairs
        """
        return _Parser(text, model).whole(until=until)

    @property
    def reached(self) -> Mask:
        """Where a run ends because X holds; a share of steps has no end."""
        return self.target & (self.kind != "S")

    @property
    def miss(self) -> Mask:
        """Where it ends because Y holds and X does not."""
        return np.zeros_like(self.target) if self.before is None else self.before & ~self.target


class _Token(NamedTuple):
    text: str
    column: int
    quoted: bool = False

    @property
    def is_name(self) -> bool:
        return self.quoted or self.text not in _RESERVED


def _unparsed(problem: str, column: int) -> FormatError:
    return FormatError(f"the specification does not parse at column {column}: {problem}")


class _Parser:
    """A recursive-descent parser that evaluates formulas on the way."""

    def __init__(self, text: str, model: MDP) -> None:
        self._text, self._model = text, model
        self._at = self._depth = position = 0
        self._tokens: list[_Token] = []
        while (match := _TOKEN.match(text, position)) is not None and match.lastindex is not None:
            group = match.lastindex
            self._tokens.append(_Token(match[group], match.start(group) + 1, match["quote"] is not None))
            position = match.end()
        if match is None:
            column = len(text) - len(text[position:].lstrip()) + 1
            raise _unparsed(f"the quotation that begins with {text[column - 1 :][:10]!r} has no end", column)
        self._tokens.append(_Token(_END, len(text) + 1))

    def whole(self, *, until: bool) -> Specification:
        kind: Any = "P" if until else self._take("P", "E", "S")
        if not until:
            self._take("(")
        found = Specification(self._text, kind, np.empty(0, dtype=np.bool_))
        if kind == "E":
            self._take("steps")
            self._take("until")
        if kind == "P" and not until and self._take("reach", "always") == "always":
            found = found._replace(target=~self._formula(told=False), always=True)
        else:
            found = found._replace(target=self._formula())
            while kind == "P" and self._is(*(each for each in ("within", "before") if getattr(found, each) is None)):
                if self._take("within", "before") == "before":
                    found = found._replace(before=self._formula())
                    continue
                most = self._next()
                if not (most.text.isascii() and most.text.isdecimal()):
                    raise self._refuse("a whole number of steps", most)
                found = found._replace(within=int(most.text))
        if not until:
            self._take(")", expected=_MORE)
        self._take(_END, expected=_END)
        return found

    def _is(self, *words: str) -> bool:
        token = self._tokens[self._at]
        return token.text in words and not token.quoted

    def _next(self) -> _Token:
        token = self._tokens[self._at]
        self._at += self._at < len(self._tokens) - 1
        return token

    def _take(self, *words: str, expected: str = "") -> Any:
        """Take one of some words."""
        known, token = self._is(*words), self._next()
        if not known:
            raise self._refuse(expected or " or ".join(map(repr, words)), token)
        return token.text

    def _refuse(self, expected: str, token: _Token) -> FormatError:
        found = token.text if token is self._tokens[-1] else repr(token.text)
        return _unparsed(f"{expected} was expected, not {found}", token.column)

    def _formula(self, *, told: bool = True) -> Mask:
        """Return where a formula holds, and warn where that is nowhere."""
        first = self._tokens[self._at]
        found = self._either()
        if told and not found.any():
            part = self._text[first.column - 1 : self._tokens[self._at].column - 1].strip()
            warnings.warn(f"nothing in the model satisfies {part}", ModelWarning, stacklevel=5)
        return np.broadcast_to(found, (len(self._model.state_space), len(self._model.action_space) + 1))

    def _either(self) -> Mask:
        found = self._both()
        while self._is("or"):
            self._next()
            found = found | self._both()
        return found

    def _both(self) -> Mask:
        found = self._negation()
        while self._is("and"):
            self._next()
            found = found & self._negation()
        return found

    def _negation(self) -> Mask:
        if not self._is("not", "("):
            return self._atom(self._next())
        token = self._next()
        self._depth += 1
        if self._depth > _DEEPEST:
            raise _unparsed(f"formulas nest at most {_DEEPEST} deep", token.column)
        if token.text == "not":
            found = ~self._negation()
        else:
            found = self._either()
            self._take(")", expected=_MORE)
        self._depth -= 1
        return found

    def _atom(self, token: _Token) -> Mask:
        if not token.is_name:
            raise self._refuse("a state, 'factor = value', 'action = NAME', 'not' or '('", token)
        if self._is("="):
            self._next()
            value = self._next()
            if not value.is_name:
                raise self._refuse(f"a value of {token.text!r}", value)
            return self._value(token.text, value)
        names = self._model.state_space.names
        name, _, text = token.text.partition("=")
        if name and text and not token.quoted and token.text not in names:
            return self._value(name, _Token(text, token.column))
        return self._chosen(names, token, "state", self._model.state_space.index)[:, None]

    def _value(self, name: str, value: _Token) -> Mask:
        """Return where a factor has a value, or an action, or an agent's part of it, is taken: not where plans end."""
        states, actions = self._model.state_space, self._model.action_space
        for space in (states, actions):
            for place, factor in enumerate(space.factors):
                if factor.name == name:
                    chosen = self._chosen(factor.names, value, "value", factor.index, f" of {name!r}")
                    part = np.arange(len(space)) // int(np.prod(space.shape[place + 1 :])) % len(factor)
                    return chosen[part][:, None] if space is states else np.append(chosen[part], False)[None, :]
        if name == "action":
            return np.append(self._chosen(actions.names, value, "action", actions.index), False)[None, :]
        known = [factor.name for space in (states, actions) for factor in space.factors]
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
            if token.quoted or not any(sign in text for sign in "*?["):
                raise ModelError(f"the model has no {what} {text!r}{of}; {_nearest(text, names)}") from None
            chosen[[place for place, name in enumerate(names) if fnmatchcase(name, text)]] = True
        return chosen


def _nearest(name: str, names: Sequence[str]) -> str:
    """Return the names that are like an unknown one, or some of them, as the end of a sentence."""
    if close := difflib.get_close_matches(name, list(names[:_COMPARED]), n=3):
        return f"did you mean {' or '.join(map(repr, close))}?"
    return f"it has {', '.join(map(repr, names[:10]))}{', …' if len(names) > 10 else ''}"
