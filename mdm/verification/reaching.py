"""Probabilities of reaching X, and expected steps until it, from each state: the least or greatest over the choices.

The graph comes first: states from which X is impossible and certain (0 and 1), and end components, in which a policy
may stay for ever without reaching anything, as one state each (L. de Alfaro, *Formal verification of probabilistic
systems*, 1997; K. Chatterjee and M. Henzinger, SODA 2011). All the rest ends for certain, and has one solution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.matrices import csr
from mdm.verification.choices import Choices, Graph, end_components
from mdm.verification.optimum import Optimum, optimum

if TYPE_CHECKING:
    from mdm.models.matrices import Vector


def reach(choices: Choices, *, greatest: bool) -> Optimum:
    """Return the least or greatest probability of reaching X from each state."""
    graph, chosen = Graph(choices), choices.firsts[:-1].copy()
    if greatest:
        none, (sure, _, by) = graph.impossible(), graph.certain()
        chosen = np.where(sure, by, chosen)
    else:
        none, avoiding = graph.avoiding()
        which = np.flatnonzero(avoiding)[::-1]
        chosen[choices.state[which]] = which
        sure = graph.unavoidable()[0]
    values, open_ = sure.astype(float), ~none & ~sure
    if not open_.any():
        return Optimum(values, chosen, 0.0)
    inside = open_[choices.state]
    component, stays = end_components(choices, inside & ~choices.lead_to(~open_))
    alone = open_ & (component < 0)
    node = np.where(alone, component.max() + np.cumsum(alone), component)
    rows, places = np.flatnonzero(inside & ~stays), np.flatnonzero(open_)
    rows = rows[np.argsort(node[choices.state[rows]], kind="stable")]
    merging = csr((np.ones(len(places)), (places, node[places])), (choices.size, int(node.max()) + 1))
    part = choices.subset(rows)
    constant = part.hit + np.asarray(part.moves @ values)
    found = optimum(csr(part.moves @ merging), node[part.state], constant, greatest=greatest)
    values[open_] = np.clip(found.values[node[open_]], 0, 1)
    leaving, doors = rows[found.chosen], np.zeros(choices.size, dtype=bool)
    doors[choices.state[leaving]] = True
    chosen[choices.state[leaving]] = leaving
    if stays.any():
        _, by = graph.attracted(doors, np.zeros(len(choices.state), dtype=bool), opened=stays)
        chosen = np.where(by >= 0, by, chosen)
    return Optimum(values, chosen, found.error)


def steps(choices: Choices, *, greatest: bool) -> Optimum:
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
    number, begin = np.cumsum(sure) - 1, np.searchsorted(rows, chosen[sure])
    found = optimum(part.moves[:, sure], number[part.state], 1 - part.hit, greatest=greatest, chosen=begin)
    values[sure], chosen[sure] = found.values, rows[found.chosen]
    return Optimum(values, chosen, found.error)


def within(choices: Choices, most: int, *, greatest: bool, kept: bool) -> tuple[Vector, list[Vector], int]:
    """Return the probability of reaching X within some steps from each state, the worth of choices, and the stages.

    The worth is that of each choice by stages, from the last to the first, or of the first alone unless all are kept;
    where nothing changes any more they end. Within 0 steps X holds at once.
    """
    pick, firsts = np.maximum if greatest else np.minimum, choices.firsts[:-1]
    worth = [choices.hit]
    values, stages = pick.reduceat(choices.hit, firsts), 1
    for _ in range(most):
        del worth[: 0 if kept else 1]
        worth.append(choices.hit + np.asarray(choices.moves @ values))
        before, values, stages = values, pick.reduceat(worth[-1], firsts), stages + 1
        if (values == before).all():
            break
    return values, worth, stages
