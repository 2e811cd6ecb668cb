"""Pruning: of vectors that no visited belief needs, points that are out of date, beliefs beyond bad actions.

A vector stays if it is the best, or nearly so, at a belief that was backed up (H. Kurniawati, D. Hsu and W. S. Lee,
RSS 2008, section III.D). An action whose upper bound is below the belief's lower bound is never taken again, and the
beliefs that only it leads to are forgotten.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mdm.solvers.sarsop.graph import (
    EDGES,
    LINKS,
    NODES,
    OUTCOMES,
    POINTS,
    VALUES,
    VECTORS,
    WEIGHTS,
    Graph,
    hashed,
    rows_of,
)

if TYPE_CHECKING:
    from mdm.models.matrices import Vector
    from mdm.solvers.sarsop.graph import Layout

Indices = npt.NDArray[np.intp]

_CHUNK = 1_000_000
"""Numbers that are held at once for some beliefs, and for their products with vectors."""
_NODES = 5_000
"""Beliefs whose actions are looked at at once."""


def bytes_to_need_vectors(graph: Graph) -> int:
    """Return how many bytes `needed_vectors` takes at most."""
    nodes = int(graph.counts[NODES])
    return int(graph.is_active[: graph.counts[VECTORS]].sum()) * nodes // 8 + 64 * nodes + 32 * _CHUNK


def bytes_to_forget_nodes(graph: Graph) -> int:
    """Return how many bytes `forget_nodes` takes at most: a few numbers for each node, edge and outcome."""
    numbers = graph.counts[NODES] + graph.counts[EDGES] + graph.counts[OUTCOMES]
    return 64 * int(numbers) + 2 * graph.table.nbytes


def needed_vectors(graph: Graph, layout: Layout, roots: npt.NDArray[np.int64], slack: float) -> npt.NDArray[np.bool_]:
    """Return few vectors, one of them within a slack of the best at each important belief.

    These are the roots, the beliefs that were backed up, and the beliefs after their best actions.
    """
    count = int(graph.counts[VECTORS])
    kept = np.zeros(count, dtype=np.bool_)
    active = np.flatnonzero(graph.is_active[:count])
    visited = np.flatnonzero(graph.first_edge[: graph.counts[NODES]] >= 0)
    parts = np.array_split(visited, len(visited) // _NODES + 1)
    visited = np.unique(np.concatenate((visited, roots, *(_followers(graph, layout, part) for part in parts))))
    by_block = active[np.argsort(graph.vector_block[active], kind="stable")]
    starts = np.searchsorted(graph.vector_block[by_block], np.arange(len(layout.first_state)))
    nodes = visited[np.argsort(graph.block[visited], kind="stable")]
    of_node = np.searchsorted(graph.block[nodes], np.arange(len(layout.first_state)))
    for block in range(len(layout.first_state) - 1):
        vectors = by_block[starts[block] : starts[block + 1]]
        beliefs = nodes[of_node[block] : of_node[block + 1]]
        width = int(layout.first_state[block + 1] - layout.first_state[block])
        if len(beliefs):
            kept[vectors[_cover(graph, rows_of(graph, width)[vectors], beliefs, slack)]] = True
    kept[graph.default_vector] = True
    return kept


def _followers(graph: Graph, layout: Layout, nodes: Indices) -> Indices:
    """Return the beliefs after the actions with the greatest lower bounds."""
    num_actions = graph.informed.shape[1]
    edges = (graph.first_edge[nodes][:, None] + np.arange(num_actions)).ravel()
    sizes = np.maximum(graph.num_outcomes[edges], 0)
    outcomes, of = _stretches(graph.first_outcome[edges], sizes)
    future = np.bincount(of, graph.chance[outcomes] * graph.lower[graph.child[outcomes]], minlength=len(edges))
    scores = np.where(sizes > 0, graph.reward[edges] + layout.discount * future, -np.inf).reshape(-1, num_actions)
    best = scores.argmax(axis=1) + num_actions * np.arange(len(nodes))
    chosen, _ = _stretches(graph.first_outcome[edges[best]], sizes[best])
    return np.asarray(graph.child[chosen])


def _dense(graph: Graph, nodes: Indices, width: int) -> Vector:
    """Return beliefs as the columns of an array."""
    sizes = graph.num_weights[nodes]
    entries, of = _stretches(graph.first_weight[nodes], sizes)
    result = np.zeros((width, len(nodes)))
    result[graph.place[entries], of] = graph.weight[entries]
    return result


def _stretches(starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int32]) -> tuple[Indices, Indices]:
    """Return the indices of some stretches in their order, and the stretch of each index."""
    of = np.repeat(np.arange(len(starts)), sizes)
    ends = np.cumsum(sizes)
    return np.arange(len(of)) - np.repeat(ends - sizes, sizes) + np.repeat(starts, sizes), of


def _move(arrays: tuple[npt.NDArray[Any], ...], starts: Indices, sizes: npt.NDArray[np.int32]) -> int:
    """Move stretches, given in the order that they lie in, to the front of arrays; return how much that is.

    A part is moved at a time, so that little is held twice. None is written over before it is moved.
    """
    ends = np.cumsum(sizes)
    total = int(ends[-1]) if len(ends) else 0
    at = 0
    for part in np.split(np.arange(len(starts)), np.searchsorted(ends, np.arange(_CHUNK, total, _CHUNK))):
        entries, _ = _stretches(starts[part], sizes[part])
        for array in arrays:
            array[at : at + len(entries)] = array[entries]
        at += len(entries)
    return total


def _cover(graph: Graph, vectors: Vector, beliefs: Indices, slack: float) -> Indices:
    """Return vectors of which each belief has one that is nearly its best."""
    count, width = vectors.shape
    size = 8 * max(1, _CHUNK // (8 * max(count, width)))
    # A bit for each vector and belief.
    near = np.empty((count, -(-len(beliefs) // 8)), dtype=np.uint8)
    times = np.zeros(count, dtype=np.intp)
    for begin in range(0, len(beliefs), size):
        scores = vectors @ _dense(graph, beliefs[begin : begin + size], width)
        close = scores >= scores.max(axis=0) - slack
        times += close.sum(axis=1)
        near[:, begin // 8 : (begin + size) // 8] = np.packbits(close, axis=1)
    open_ = np.packbits(np.ones(len(beliefs), dtype=np.bool_))
    chosen = []
    for vector in np.argsort(-times, kind="stable"):
        if (near[vector] & open_).any():
            chosen.append(vector)
            open_ &= ~near[vector]
            if not open_.any():
                break
    return np.array(chosen, dtype=np.intp)


def parts_of(graph: Graph, vectors: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return a mask of some vectors and of all that they are made of."""
    kept = vectors.copy()
    front = np.flatnonzero(kept)
    while len(front):
        links, _ = _stretches(graph.first_link[front], graph.num_links[front])
        front = np.unique(graph.link[links])
        front = front[~kept[front]]
        kept[front] = True
    return kept


def prune_vectors(graph: Graph, layout: Layout, active: npt.NDArray[np.bool_]) -> None:
    """Remove vectors. The parts of those that stay are kept, but no belief is compared with them.

    Beliefs whose best vector is gone find another at the next refresh.
    """
    kept = parts_of(graph, active)
    old = np.flatnonzero(kept)
    place = np.cumsum(kept) - 1
    widths = np.diff(layout.first_state)[graph.vector_block[old]]
    counts = graph.counts
    counts[VALUES] = _move((graph.values,), graph.first_value[old], widths.astype(np.int32))
    links, _ = _stretches(graph.first_link[old], graph.num_links[old])
    new = slice(0, len(old))
    graph.first_value[new] = np.cumsum(widths) - widths
    graph.link[: len(links)] = place[graph.link[links]]
    graph.num_links[new] = graph.num_links[old]
    graph.first_link[new] = np.cumsum(graph.num_links[new]) - graph.num_links[new]
    graph.vector_action[new] = graph.vector_action[old]
    graph.vector_block[new] = graph.vector_block[old]
    graph.is_active[new] = active[old]
    graph.default_vector[:] = place[graph.default_vector]
    counts[VECTORS] = len(old)
    counts[LINKS] = len(links)
    compared = np.flatnonzero(active[old])
    _link(graph.head_vector, graph.next_vector, graph.vector_block[compared], compared)
    nodes = slice(0, int(graph.counts[NODES]))
    best, seen = graph.best[nodes], graph.seen_vectors[nodes]
    lost = (best < 0) | ~active[np.maximum(best, 0)]
    graph.best[nodes] = np.where(lost, -1, place[np.maximum(best, 0)])
    graph.lower[nodes] = np.where(lost, -np.inf, graph.lower[nodes])
    before = np.concatenate(([0], np.cumsum(kept)))
    graph.seen_vectors[nodes] = np.where(lost, 0, before[seen])


def prune_points(graph: Graph) -> None:
    """Remove the points of beliefs that have a newer one."""
    count = int(graph.counts[POINTS])
    nodes = graph.point_node[:count]
    kept = graph.point_value[:count] <= graph.upper[nodes]
    # The last of several at one belief.
    _, first = np.unique(nodes[::-1], return_index=True)
    last = np.zeros(count, dtype=np.bool_)
    last[count - 1 - first] = True
    kept &= last
    _keep_points(graph, kept)


def _keep_points(graph: Graph, kept: npt.NDArray[np.bool_]) -> None:
    count = int(kept.sum())
    graph.point_node[:count] = graph.point_node[: len(kept)][kept]
    graph.point_value[:count] = graph.point_value[: len(kept)][kept]
    graph.point_drop[:count] = graph.point_drop[: len(kept)][kept]
    graph.counts[POINTS] = count
    _link(graph.head_point, graph.next_point, graph.block[graph.point_node[:count]], np.arange(count))
    before = np.concatenate(([0], np.cumsum(kept)))
    nodes = slice(0, int(graph.counts[NODES]))
    graph.seen_points[nodes] = before[graph.seen_points[nodes]]


def _link(
    heads: npt.NDArray[np.int32], after: npt.NDArray[np.int32], blocks: npt.NDArray[np.int32], entries: Indices
) -> None:
    """Chain the entries of each block, the newest first."""
    heads[:] = -1
    by_block = np.argsort(blocks, kind="stable")
    order, blocks = entries[by_block], blocks[by_block]
    if not len(order):
        return
    first = np.concatenate(([True], blocks[1:] != blocks[:-1]))
    after[order] = np.where(first, -1, np.concatenate(([-1], order[:-1])))
    last = np.concatenate((first[1:], [True]))
    heads[blocks[last]] = order[last]


def forget_nodes(graph: Graph, roots: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Remove beliefs that only bad actions lead to; return the roots' new nodes."""
    num_nodes = int(graph.counts[NODES])
    num_actions = graph.informed.shape[1]
    reached = np.zeros(num_nodes, dtype=np.bool_)
    reached[roots] = True
    front = np.unique(roots)
    while len(front):
        edges = _good_edges(graph, front, num_actions)
        outcomes, _ = _stretches(graph.first_outcome[edges], graph.num_outcomes[edges])
        front = np.unique(graph.child[outcomes])
        front = front[~reached[front]]
        reached[front] = True
    return _keep_nodes(graph, reached, roots, num_actions)


def _good_edges(graph: Graph, nodes: Indices, num_actions: int) -> Indices:
    """Return the edges of nodes that have outcomes and may still be the best."""
    opened = nodes[graph.first_edge[nodes] >= 0]
    edges = (graph.first_edge[opened][:, None] + np.arange(num_actions)).ravel()
    lower = np.repeat(graph.lower[opened], num_actions)
    return np.asarray(edges[(graph.num_outcomes[edges] >= 0) & (graph.edge_upper[edges] >= lower)])


def _keep_nodes(
    graph: Graph, reached: npt.NDArray[np.bool_], roots: npt.NDArray[np.int64], num_actions: int
) -> npt.NDArray[np.int64]:
    nodes = np.flatnonzero(reached)
    place = np.cumsum(reached) - 1
    # Edges of the nodes that stay; a bad one counts as not expanded, without outcomes.
    opened = nodes[graph.first_edge[nodes] >= 0]
    edges = (graph.first_edge[opened][:, None] + np.arange(num_actions)).ravel()
    good = np.zeros(int(graph.counts[EDGES]), dtype=np.bool_)
    good[_good_edges(graph, nodes, num_actions)] = True
    sizes = np.where(good[edges], graph.num_outcomes[edges], 0)
    outcomes, _ = _stretches(graph.first_outcome[edges], sizes)

    graph.symbol[: len(outcomes)] = graph.symbol[outcomes]
    graph.chance[: len(outcomes)] = graph.chance[outcomes]
    graph.child[: len(outcomes)] = place[graph.child[outcomes]]
    graph.reward[: len(edges)] = graph.reward[edges]
    graph.edge_upper[: len(edges)] = graph.edge_upper[edges]
    graph.num_outcomes[: len(edges)] = np.where(good[edges], graph.num_outcomes[edges], -1)
    graph.first_outcome[: len(edges)] = np.cumsum(sizes) - sizes
    num_weights = graph.num_weights[nodes]
    graph.counts[WEIGHTS] = _move((graph.place, graph.weight), graph.first_weight[nodes], num_weights)
    first_edge = np.full(len(reached), -1, dtype=np.int64)
    first_edge[opened] = np.arange(len(opened)) * num_actions

    count = int(graph.counts[POINTS])
    kept_points = reached[graph.point_node[:count]]
    graph.point_node[:count] = place[graph.point_node[:count]]

    for name in (
        "block", "num_weights", "lower", "upper", "entropy", "best", "seen_vectors", "seen_points", "informed", "code",
        "bin", "binned",
    ):  # fmt: skip
        array = getattr(graph, name)
        array[: len(nodes)] = array[nodes]
    graph.first_edge[: len(nodes)] = first_edge[nodes]
    graph.first_weight[: len(nodes)] = np.cumsum(num_weights, dtype=np.int64) - num_weights
    graph.counts[NODES] = len(nodes)
    graph.counts[EDGES] = len(edges)
    graph.counts[OUTCOMES] = len(outcomes)
    _keep_points(graph, kept_points)
    graph.table[:] = hashed(graph.code[: len(nodes)], len(graph.table))
    return np.asarray(place[roots])
