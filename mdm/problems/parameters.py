"""Parameters of problems: each is of the kind that its annotation says; and spaces of teams whose agents are alike."""

from __future__ import annotations

import functools
import inspect
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from mdm.checks import is_number, is_whole
from mdm.errors import ModelError
from mdm.models import Factor, Space

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

P = ParamSpec("P")
T = TypeVar("T")

_KINDS: dict[str, tuple[Callable[[object], bool], type, str]] = {
    "int": (is_whole, int, "a whole number"),
    "float": (is_number, float, "a number"),
    "str": (lambda given: isinstance(given, str), str, "a text"),
}


def checked(problem: Callable[P, T]) -> Callable[P, T]:
    """Return a problem that refuses numbers and texts of another kind than it takes; numpy's become plain ones.

    Its module keeps annotations as text; parameters of other kinds than ``int``, ``float`` and ``str`` are its own
    affair.
    """
    signature = inspect.signature(problem)

    @functools.wraps(problem)
    def check(*positional: P.args, **named: P.kwargs) -> T:
        given = signature.bind(*positional, **named)
        arguments: dict[str, Any] = given.arguments
        for name, value in arguments.items():
            if (kind := _KINDS.get(signature.parameters[name].annotation)) is not None:
                fits, convert, what = kind
                if not fits(value):
                    raise ModelError(f"{name} is {what}, not {value!r}")
                arguments[name] = convert(value)
        return problem(*given.args, **given.kwargs)

    return check


def agents(names: Sequence[str], count: int = 2) -> Space:
    """Return a joint space in which every agent has the same symbols; the first factor is ``agent0``."""
    return Space(Factor(f"agent{number}", names) for number in range(count))
