"""Probabilities of reaching X, and expected steps until it, from each state: the least or greatest over the choices.

The graph comes first: states from which X is impossible and certain (0 and 1), and end components, in which a policy
may stay for ever without reaching anything, as one state each (L. de Alfaro, *Formal verification of probabilistic
systems*, 1997; K. Chatterjee and M. Henzinger, SODA 2011). All the rest ends for certain, and has one solution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.models.matrices import csr
from mdm.verification.choices import Choices, Graph, end_components
from mdm.verification.optimum import Optimum, optimum

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector
    from mdm.models.specification import Mask

    Indices = npt.NDArray[np.integer]


class Reached(NamedTuple):
    """Numbers for each state.

    Args:
        values: Probabilities, or expected steps, infinite where X is not certain.
        chosen: A choice for each state that attains it.
        error: The largest error of the values that are neither certain nor infinite.
    """

    values: Vector
    chosen: Indices
    error: float


def reach(choices: Choices, *, greatest: bool) -> Reached:
    """Return the least or greatest probability of reaching X from each state."""
    graph, values = Graph(choices), np.zeros(choices.size)
    chosen = choices.firsts[:-1].copy()
    if greatest:
        none = graph.impossible()
        sure, _, by = graph.certain()
        chosen = np.where(sure, by, chosen)
    else:
        none, avoiding = graph.avoiding()
        which = np.flatnonzero(avoiding)[::-1]
        chosen[choices.state[which]] = which
        sure = graph.unavoidable()[0]
    values[sure] = 1
    open_ = ~none & ~sure
    if not open_.any():
        return Reached(values, chosen, 0.0)
    rows = np.flatnonzero(open_[choices.state])
    part = choices.subset(rows)
    constant = part.hit + np.asarray(part.moves @ sure.astype(float))
    if greatest and len(rows) > open_.sum():
        found = _collapsed(choices, open_, rows, constant)
    else:
        number = np.cumsum(open_) - 1
        found = optimum(part.moves[:, open_], number[part.state], constant, greatest=greatest)
        found = found._replace(chosen=rows[found.chosen])
    values[open_] = np.clip(found.values, 0, 1)
    chosen[open_] = found.chosen
    return Reached(values, chosen, found.error)


def _collapsed(choices: Choices, open_: Mask, rows: Indices, constant: Vector) -> Optimum:
    """Return the greatest values of open states, whose end components are made one state each, and the choices."""
    inside = np.zeros(len(choices.state), dtype=bool)
    inside[rows] = True
    component, stays = end_components(choices, inside & ~choices.lead_to(~open_))
    count = int(component.max(initial=-1)) + 1
    node = np.where(component >= 0, component, 0)
    alone = open_ & (component < 0)
    node[alone] = count + np.arange(int(alone.sum()))
    kept = np.flatnonzero(~stays[rows])
    kept = kept[np.argsort(node[choices.state[rows[kept]]], kind="stable")]
    its, places = rows[kept], np.flatnonzero(open_)
    merging = csr((np.ones(len(places)), node[places], np.arange(len(places) + 1)), (len(places), count + alone.sum()))
    moves = csr(choices.moves[its][:, places] @ merging)
    found = optimum(moves, node[choices.state[its]], constant[kept], greatest=True)
    leaving = its[found.chosen]
    chosen = np.zeros(choices.size, dtype=np.int64)
    chosen[choices.state[leaving]] = leaving
    if count:
        doors = np.zeros(choices.size, dtype=bool)
        doors[choices.state[leaving]] = True
        _, by = Graph(choices).attracted(doors, np.zeros(len(choices.state), dtype=bool), opened=stays)
        chosen = np.where(by >= 0, by, chosen)
    return Optimum(found.values[node[open_]], chosen[open_], found.error)


def steps(choices: Choices, *, greatest: bool) -> Reached:
    """Return the least or greatest expected number of steps until X, infinite where it is not certain."""
    graph, values = Graph(choices), np.full(choices.size, np.inf)
    chosen = choices.firsts[:-1].copy()
    if greatest:
        sure, by = graph.unavoidable()
        avoids, avoiding = graph.avoiding()
        which = np.flatnonzero(avoiding)[::-1]
        chosen[choices.state[which]] = which
        chosen = np.where(~sure & ~avoids & (by >= 0), by, chosen)
        opened = sure[choices.state]
    else:
        sure, opened, by = graph.certain()
        chosen = np.where(sure, by, chosen)
    rows = np.flatnonzero(opened)
    part = choices.subset(rows)
    number = np.cumsum(sure) - 1
    begin = np.searchsorted(rows, chosen[sure])
    found = optimum(part.moves[:, sure], number[part.state], 1 - part.hit, greatest=greatest, chosen=begin)
    values[sure] = found.values
    chosen[sure] = rows[found.chosen]
    return Reached(values, chosen, found.error)


def within(choices: Choices, most: int, *, greatest: bool) -> tuple[Vector, list[Vector]]:
    """Return the probability of reaching X within some steps from each state, and the worth of each choice by stages.

    The stages are from the last to the first; where nothing changes any more they end. Within 0 steps X holds at once.
    """
    pick, firsts = np.maximum if greatest else np.minimum, choices.firsts[:-1]
    worth = [choices.hit]
    values = pick.reduceat(choices.hit, firsts)
    for _ in range(most):
        worth.append(choices.hit + np.asarray(choices.moves @ values))
        before, values = values, pick.reduceat(worth[-1], firsts)
        if (values == before).all():
            break
    return values, worth
