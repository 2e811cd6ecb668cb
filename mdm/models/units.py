"""The unit of a discount, and of the time of an action: a step of the model, or a second.

A step is ``"step"`` where nobody said how long it takes, else its seconds. ``"second"`` is for models whose steps take
the time that `Durations` say: without these nothing is known of a step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from mdm.checks import is_number
from mdm.errors import ModelError

if TYPE_CHECKING:
    from mdm.models.mdp import MDP

Unit = float | Literal["step", "second"]


def checked_unit(unit: Unit) -> Unit:
    """Return a unit.

    Raises:
        ModelError: If it is none.
    """
    if unit in ("step", "second"):
        return unit
    if not (is_number(unit) and 0 < unit < math.inf):
        raise ModelError(f"a unit of time is 'step', 'second', or the seconds of a step, not {unit!r}")
    return float(unit)


def in_words(unit: Unit) -> str:
    """Return a unit in words."""
    return f"a {unit}" if isinstance(unit, str) else f"a step of {unit:g} s"


def seconds_in(unit: Unit) -> float | None:
    """Return how many seconds a unit has; None of a step of which nobody said it."""
    if isinstance(unit, str):
        return 1.0 if unit == "second" else None
    return unit


def ratio(unit: Unit, other: Unit) -> float | None:
    """Return how many of the other unit one has; None where that is not known."""
    if unit == other:
        return 1.0
    seconds, others = seconds_in(unit), seconds_in(other)
    return None if seconds is None or others is None else seconds / others


def check_steps(model: MDP) -> None:
    """Refuse a model whose discount is of a second where the time of its steps is not known.

    Raises:
        ModelError: If it is one.
    """
    if model.discount_of == "second" and model.discount < 1:
        raise ModelError(
            "the model discounts by the second: say how long actions take by durations, or by the seconds of a step "
            "(--discount-of S; model.with_discount(…, of=S))"
        )
