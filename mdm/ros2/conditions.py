"""Conditions on messages, such as ``"percentage < 0.2 until > 0.3"``: one field, compared with a constant."""

from __future__ import annotations

import math
import re
from numbers import Real
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mdm.errors import ConfigError, FormatError
from mdm.logic import parse_threshold
from mdm.ros2.wire import near

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mdm.logic import Threshold

_PATH = re.compile(r"\s*(not\s+(?=[A-Za-z]))?([A-Za-z]\w*(?:\.[A-Za-z]\w*|\[-?\d{1,9}\])*)\s*", re.ASCII)
_STEP = re.compile(r"\[(-?\d+)\]|(\w+)", re.ASCII)
_EQUAL = re.compile(
    r"""([=!])=\s*(?:(true|false)|'([^']*)'|"([^"]*)"|([+-]?(?:\d{1,99}\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?))(?![\w.])\s*\Z""",
    re.ASCII,
)
_SEQUENCE = re.compile(r"sequence<(.*?)(?:, \d+)?>|(.*)\[(\d+)\]")
_WRITTEN: Final = (
    "a condition is a field and a comparison, such as 'percentage < 0.2 until > 0.3', 'not data', 'ranges[0] < 0.5' "
    "or \"state == 'docked'\"; or a function 'module:name'"
)


class Condition:
    """Tells from a message whether one of its fields holds; None where that is unknown.

    Unknown is a field that is not there, an index out of range, NaN, a value of another kind than the constant, and a
    number between two thresholds before it was beyond either.

    Args:
        text: A path of fields and indices (negative ones count from the end); alone or behind ``not`` of a boolean, or
            before a threshold, or before ``==`` or ``!=`` and a number, a text in quotes, ``true`` or ``false``.

    Raises:
        FormatError: If it is none; with the column.
    """

    __slots__ = ("_before", "_constant", "_equal", "_steps", "_text", "_threshold", "_wanted", "path")

    def __init__(self, text: str) -> None:
        match = _PATH.match(text)
        if match is None:
            raise FormatError(_WRITTEN, column=len(text) - len(text.lstrip()) + 1)
        self.path: str = match.group(2)
        self._text = text.strip()
        self._steps = [int(index) if index else name for index, name in _STEP.findall(self.path)]
        self._threshold: Threshold | None = None
        self._constant: Any = True
        self._equal = match.group(1) is None
        self._before: bool | None = None
        rest = text[match.end() :]
        if self._equal and rest[:1] in {"<", ">"}:
            try:
                self._threshold = parse_threshold(rest)
            except FormatError as error:
                raise FormatError(error.message, column=match.end() + (error.column or 1)) from None
        elif rest:
            equal = _EQUAL.match(rest) if self._equal else None
            if equal is None:
                raise FormatError(_WRITTEN, column=match.end() + 1)
            sign, truth, single, double, number = equal.groups()
            self._equal = sign == "="
            whole = number is not None and number.lstrip("+-").isdigit()
            self._constant = truth == "true" if number is None else int(number) if whole else float(number)
            if truth is None and number is None:
                self._constant = single or double or ""
        self._wanted = "a number" if self._threshold is not None else _kind(self._constant)

    def __str__(self) -> str:
        """Return it as it is written."""
        return self._text

    def __call__(self, message: Any) -> bool | None:
        """Return whether a message meets it."""
        value = self._value(message)
        if _kind(value) != self._wanted:
            return None
        if self._threshold is None:
            return bool(value == self._constant) is self._equal
        self._before = self._threshold.of(value, self._before)
        return self._before

    def _value(self, value: Any) -> Any:
        for step in self._steps:
            try:
                value = value[step] if isinstance(step, int) else getattr(value, step)
            except (AttributeError, IndexError, KeyError, TypeError):
                return None
        return value[0] if isinstance(value, bytes) and len(value) == 1 else value  # an octet

    def begin(self) -> None:
        """Forget which threshold was passed."""
        self._before = None

    def check(self, kind: str, fields: Callable[[str], Mapping[str, str]]) -> None:
        """Refuse, as a `ConfigError`, a path that no message of a type has, or a field of another kind.

        ``fields`` returns the type of each field of a type, by name.
        """
        its, path = kind, ""
        for step in self._steps:
            sequence = _SEQUENCE.fullmatch(its)
            if isinstance(step, int):
                length = sequence and sequence.group(3)
                if sequence is None or (length and not -int(length) <= step < int(length)):
                    raise ConfigError(f"{kind}: {path} is {its}, and has no element {step}")
                its, path = sequence.group(1) or sequence.group(2), f"{path}[{step}]"
                continue
            full = its if its.count("/") > 1 else its.replace("/", "/msg/")
            names = {} if sequence or "/" not in its else fields(full)
            if step not in names:
                whole = f"{path} is {its}, which" if path else kind
                raise ConfigError(f"{whole} has no {step!r}{near(step, names)}")
            its, path = names[step], f"{path}.{step}".lstrip(".")
        plain = "nothing to compare" if "/" in its or _SEQUENCE.fullmatch(its) else _PLAIN.get(its[:7], "a number")
        if plain != self._wanted:
            raise ConfigError(f"{kind}: {path} is {its}, {plain}: {self._text!r} is about {self._wanted}")


_PLAIN: Final = {"boolean": "a truth value", "string": "a text", "wstring": "a text", "string<": "a text"}


def _kind(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "a truth value"
    if isinstance(value, Real):
        return "" if math.isnan(value) else "a number"
    return "a text" if isinstance(value, str) else ""
