"""Linear systems of values, ``values - ahead(values) = earned``, solved as far as there is time.

The stabilised method of biconjugate gradients (H. A. van der Vorst, *Bi-CGSTAB*, SIAM Journal on Scientific and
Statistical Computing 13, 1992). Its residual goes up and down, so the values with the least one are kept; where it
breaks down, or comes no nearer for a while, it begins again after a step of value iteration, which always comes nearer.

Cost of an iteration: two products, and some passes over ten arrays. Arrays are multiplied by numpy alone: the threads
of its libraries wait for each other where cores are busy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.models.matrices import Vector

__all__ = ["solved"]

_ITERATIONS = 300
_PATIENCE = 40
"""Iterations without a smaller residual before it begins again."""


def solved(ahead: Callable[[Vector], Vector], earned: Vector, begin: Vector, close: float) -> Vector:
    """Return the values with the smallest residual that were found.

    Args:
        ahead: Returns what values are worth one step before: linear, and a contraction. Where it raises a
            `TimeoutError` there is no more time.
        earned: What each step earns.
        begin: The first values.
        close: A residual whose numbers are no greater is small enough.
    """
    best, least = begin, np.inf
    waited = _PATIENCE
    try:
        with np.errstate(all="ignore"):  # it may break down
            for _ in range(_ITERATIONS):
                if waited >= _PATIENCE:
                    values = earned + ahead(best)
                    residual = earned + ahead(values) - values
                    best, least, waited = values, float(np.abs(residual).max()), 0
                    shadow = direction = residual
                    match = _product(shadow, residual)
                if least <= close:
                    break
                image = direction - ahead(direction)
                step = match / _product(shadow, image)
                half = residual - step * image
                turned = half - ahead(half)
                weight = _product(turned, half) / max(_product(turned, turned), np.finfo(np.float64).tiny)
                values = values + step * direction + weight * half
                residual = half - weight * turned
                before, match = match, _product(shadow, residual)
                direction = residual + match / before * (step / weight) * (direction - weight * image)
                worst = float(np.abs(residual).max())
                if worst < least:
                    best, least, waited = values, worst, 0
                else:
                    waited = waited + 1 if worst < np.inf else _PATIENCE
    except TimeoutError:
        pass
    return best


def _product(one: Vector, other: Vector) -> np.float64:
    return np.float64((one * other).sum())  # to divide by it raises nothing
