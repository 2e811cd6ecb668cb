"""Beliefs for the eye: the likeliest states, marginals of factors, and cells of a grid, of however many states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.beliefs import Support
from mdm.snapshots.frame import BeliefFrame, GridFrame, Marginal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import Space
    from mdm.models.matrices import Vector

_TOP = 12
"""States that are shown by name."""
_SYMBOLS = 24
"""Symbols of a factor that are shown."""
_CELLS = 4_096
_SEARCHED = 10_000
"""States up to which a belief is searched for its likeliest one, which costs their number."""
_ROWS = frozenset({"y", "row", "rows"})
_COLUMNS = frozenset({"x", "column", "columns", "col"})


def belief_frame(current: Any, space: Space | None) -> BeliefFrame | None:
    """Return an information state as it is shown; None where it is no belief.

    Costs the order of S for marginals of a dense belief, and of its support for others.

    Args:
        current: S numbers, or a `Support`.
        space: The states, where they have names.
    """
    found = chances_of(current)
    if found is None:
        return None
    states, chances = found
    size = len(current) if isinstance(current, np.ndarray) else int(states.max(initial=0)) + 1
    if space is not None and isinstance(current, Support):
        size = len(space)
    if not len(states) or (space is not None and len(space) != size):
        return None
    most = np.argpartition(-chances, _TOP)[:_TOP] if len(chances) > _TOP else np.arange(len(chances))
    most = most[np.argsort(-chances[most], kind="stable")]
    name: Any = str if space is None else space.names.__getitem__
    top = tuple([(name(int(states[place])), _short(chances[place])) for place in most])
    shares, grid = marginals(states, chances, space)
    return BeliefFrame(
        top=top,
        rest=_short(max(0.0, 1.0 - sum(chance for _, chance in top))),
        states=size,
        entropy=entropy(chances),
        marginals=shares,
        grid=grid,
        octaves=_octaves(chances) if len(chances) > _TOP else (),
    )


def _octaves(chances: Vector) -> tuple[tuple[float, int, float], ...]:
    powers = np.frexp(chances)[1]  # of which each is at least half, and less than 1
    low = int(powers.min())
    counts, masses = np.bincount(powers - low), np.bincount(powers - low, chances)
    pairs = zip(counts.tolist(), masses.tolist(), strict=True)
    return tuple([(2.0 ** (low + place), count, _short(mass)) for place, (count, mass) in enumerate(pairs) if count])


def chances_of(current: Any) -> tuple[Any, Vector] | None:
    """Return the states of a belief that are possible, with their probabilities; None where it is no belief."""
    if isinstance(current, Support):
        return np.asarray(current.states), np.asarray(current.probabilities, dtype=np.float64)
    if isinstance(current, np.ndarray) and current.ndim == 1 and current.dtype.kind == "f":
        return np.flatnonzero(current), current[current != 0]
    return None


def entropy(chances: Vector) -> float:
    """Return the entropy of probabilities in bits."""
    logs = np.log2(chances, out=np.zeros_like(chances), where=chances > 0)
    return round(max(0.0, float(-(chances * logs).sum())), 4)


def likeliest(current: Any) -> tuple[int, float] | None:
    """Return the likeliest state of a belief with its probability; None where it is none, or too large to search."""
    if isinstance(current, np.ndarray) and current.size > _SEARCHED:
        return None
    states, chances = chances_of(current) or ((), ())
    if not 0 < len(chances) <= _SEARCHED:
        return None
    place = int(np.argmax(chances))
    return int(states[place]), float(chances[place])


def _short(chance: Any) -> float:
    return round(float(chance), 6)


def marginals(states: Any, chances: Vector, space: Space | None) -> tuple[tuple[Marginal, ...], GridFrame | None]:
    """Return the probabilities of the factors' symbols, and of the cells of a grid; none where there is one factor."""
    if space is None or len(space.factors) < 2:
        return (), None
    parts = np.unravel_index(states, space.shape)
    shares = []
    for factor, own in zip(space.factors, parts, strict=True):
        summed = np.bincount(own, chances, minlength=len(factor))
        order: Sequence[int] = range(len(factor))
        if len(factor) > _SYMBOLS:
            order = np.sort(np.argpartition(-summed, _SYMBOLS)[:_SYMBOLS]).tolist()
        values = tuple([_short(summed[place]) for place in order])
        rest = _short(max(0.0, float(chances.sum()) - sum(values))) if len(factor) > _SYMBOLS else 0.0
        shares.append(Marginal(factor.name, tuple([factor.names[place] for place in order]), values, rest))
    return tuple(shares), _grid(parts, chances, space)


def grid_factors(space: Space | None) -> tuple[int, int] | None:
    """Return the factors that are the rows and the columns of a grid, by their names; None where there are none."""
    if space is None or len(space.factors) < 2:
        return None
    names = [factor.name.lower() for factor in space.factors]
    down = next((place for place, name in enumerate(names) if name in _ROWS), None)
    across = next((place for place, name in enumerate(names) if name in _COLUMNS), None)
    if down is None or across is None or len(space.factors[down]) * len(space.factors[across]) > _CELLS:
        return None
    return down, across


def _grid(parts: Sequence[Any], chances: Vector, space: Space) -> GridFrame | None:
    found = grid_factors(space)
    if found is None:
        return None
    down, across = found
    rows, columns = len(space.factors[down]), len(space.factors[across])
    cells = np.bincount(parts[down] * columns + parts[across], chances, minlength=rows * columns)
    names = space.factors[down].name, space.factors[across].name
    return GridFrame(*names, rows, columns, tuple([_short(cell) for cell in cells]))
