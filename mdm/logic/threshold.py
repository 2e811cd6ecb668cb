"""Thresholds with hysteresis, by which a number becomes a truth value, such as ``"< 0.2 until > 0.3"``."""

from __future__ import annotations

import math
import operator
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from mdm.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.checks import Number

_HOLDS: Final[dict[str, Callable[[Number, float], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_OPPOSITE: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}
_SIGN = re.compile(r"\s*([<>]=?)?")
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))?", re.ASCII)
_UNTIL = re.compile(r"\s*(until\b)?")


class Threshold(NamedTuple):
    """A comparison that makes true, and one that makes false again; in between what was known stays.

    Attributes:
        sign: That of the first comparison: ``<``, ``<=``, ``>`` or ``>=``.
        bound: The number that is compared with there.
        until: The sign of the second comparison.
        end: The number there.
    """

    sign: str
    bound: float
    until: str
    end: float

    def __str__(self) -> str:
        """Return it as it is written."""
        first = f"{self.sign} {_written(self.bound)}"
        alone = (self.until, self.end) == (_OPPOSITE[self.sign], self.bound)
        return first if alone else f"{first} until {self.until} {_written(self.end)}"

    def of(self, number: Number, before: bool | None) -> bool | None:
        """Return whether a number holds; NaN is unknown, and what lies in between is as before."""
        if number != number:  # noqa: PLR0124 - NaN, of whatever type
            return None
        if _HOLDS[self.sign](number, self.bound):
            return True
        return False if _HOLDS[self.until](number, self.end) else before


def parse_threshold(text: str) -> Threshold:
    """Parse a threshold: a comparison, and with ``until`` the opposite one that ends it.

    Raises:
        FormatError: If the text is none, or both comparisons may hold at once; with the column and what was expected.
    """
    sign, bound, at = _comparison(text, 0)
    match = _match(_UNTIL, text, at)
    if match.group(1) is None:
        _refuse_rest(text, match.end(), "'until' or the end")
        return Threshold(sign, bound, _OPPOSITE[sign], bound)
    beyond = match.end()
    until, end, at = _comparison(text, beyond)
    _refuse_rest(text, at, "the end")
    column = beyond + len(text[beyond:]) - len(text[beyond:].lstrip()) + 1
    if until[0] == sign[0]:
        raise FormatError(f"what begins with {sign} ends with {_OPPOSITE[sign][0]}, not with {until}", column=column)
    gap = end - bound if sign[0] == "<" else bound - end
    if gap < 0 or (gap == 0 and len(sign) == len(until) == 2):
        raise FormatError(
            f"{sign} {_written(bound)} and {until} {_written(end)} hold at once for some numbers: move one beyond the "
            f"other",
            column=column,
        )
    return Threshold(sign, bound, until, end)


def _comparison(text: str, at: int) -> tuple[str, float, int]:
    """Return the sign and number of the comparison at a place, and the place behind it."""
    sign = _match(_SIGN, text, at)
    if sign.group(1) is None:
        raise _unexpected(text, sign.end(), "'<', '<=', '>' or '>='")
    number = _match(_NUMBER, text, sign.end())
    if number.group(1) is None or not math.isfinite(float(number.group(1))):
        raise _unexpected(text, number.end() if number.group(1) is None else number.start(1), "a finite number")
    return sign.group(1), float(number.group(1)), number.end()


def _written(number: float) -> str:
    return repr(number).removesuffix(".0")


def _match(pattern: re.Pattern[str], text: str, at: int) -> re.Match[str]:
    match = pattern.match(text, at)
    assert match is not None  # for all that they ask for may be absent
    return match


def _refuse_rest(text: str, at: int, expected: str) -> None:
    if text[at:].strip():
        raise _unexpected(text, at, expected)


def _unexpected(text: str, at: int, expected: str) -> FormatError:
    rest = text[at:].lstrip()
    found = repr(rest.split()[0]) if rest else "the end"
    return FormatError(
        f'{expected} was expected, not {found}: a threshold is written as "< 0.2 until > 0.3"',
        column=len(text) - len(rest) + 1,
    )
