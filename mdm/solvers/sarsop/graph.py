"""The graph of SARSOP: beliefs, the actions and observations between them, vectors, and points.

Everything lies in arrays that compiled code can fill; when they are full, they are copied to larger ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from mdm.solvers.sarsop.layout import Layout

__all__ = [
    "EDGES",
    "LINKS",
    "NODES",
    "OUTCOMES",
    "POINTS",
    "VALUES",
    "VECTORS",
    "WEIGHTS",
    "Graph",
    "Scratch",
    "bytes_of",
    "grown",
    "new_graph",
    "rows_of",
    "without_beliefs",
]

NODES, EDGES, OUTCOMES, WEIGHTS, VECTORS, VALUES, POINTS, LINKS = range(8)
"""Places in ``counts``."""

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]
Long = npt.NDArray[np.int64]


class Graph(NamedTuple):
    """Beliefs (nodes), a node's actions (edges), an edge's observations (outcomes), vectors and points.

    Missing indices are -1. A vector has links to the vectors that it was made of. Beliefs are compared with active
    vectors alone; others are kept as parts of these.
    """

    counts: Long

    block: Integers
    first_weight: Long
    num_weights: Integers
    lower: Floats
    upper: Floats
    entropy: Floats
    best: Integers
    seen_vectors: Integers
    seen_points: Integers
    first_edge: Long
    informed: Floats
    code: Long
    bin: Integers
    binned: Floats

    first_outcome: Long
    num_outcomes: Integers
    reward: Floats
    edge_upper: Floats

    symbol: Integers
    chance: Floats
    child: Integers

    place: Integers
    weight: Floats

    vector_action: Integers
    vector_block: Integers
    first_value: Long
    next_vector: Integers
    first_link: Long
    num_links: Integers
    is_active: Integers
    values: Floats
    link: Integers

    point_node: Integers
    point_value: Floats
    point_drop: Floats
    next_point: Integers

    head_vector: Integers
    head_point: Integers
    default_vector: Integers
    table: Integers
    bin_sum: Floats
    bin_count: Long


_SIZED: dict[str, int] = {
    **dict.fromkeys(
        (
            "block", "first_weight", "num_weights", "lower", "upper", "entropy", "best", "seen_vectors",
            "seen_points", "first_edge", "code", "bin", "binned",
        ),
        NODES,
    ),
    **dict.fromkeys(("first_outcome", "num_outcomes", "reward", "edge_upper"), EDGES),
    **dict.fromkeys(("symbol", "chance", "child"), OUTCOMES),
    **dict.fromkeys(("place", "weight"), WEIGHTS),
    **dict.fromkeys(
        ("vector_action", "vector_block", "first_value", "next_vector", "first_link", "num_links", "is_active"), VECTORS
    ),
    "values": VALUES,
    "link": LINKS,
    **dict.fromkeys(("point_node", "point_value", "point_drop", "next_point"), POINTS),
}  # fmt: skip
"""The count that limits the length of an array; ``informed`` has a row per node."""

_FLOATS = {
    "lower", "upper", "entropy", "binned", "reward", "edge_upper", "chance", "weight", "values", "point_value",
    "point_drop",
}  # fmt: skip
_LONG = {"first_weight", "first_edge", "code", "first_outcome", "first_value", "first_link"}


class Scratch(NamedTuple):
    """Room for the work of one step, which leaves it as it was."""

    predicted: Floats
    touched: Long
    dense: Floats
    tally: Integers
    offset: Long
    found: Integers
    entry_place: Integers
    entry_weight: Floats
    choice: Integers
    backed: Floats
    stamp: Long
    path: Integers
    path_action: Integers


def new_graph(layout: Layout, bins: int) -> Graph:
    """Return an empty graph."""
    num_actions = len(layout.rewards)
    num_blocks = len(layout.first_state) - 1
    room = room_for(layout)
    sized: dict[str, Any] = {
        name: np.zeros(
            2 * room[count] + 64, dtype=np.float64 if name in _FLOATS else np.int64 if name in _LONG else np.int32
        )
        for name, count in _SIZED.items()
    }
    return Graph(
        counts=np.zeros(8, dtype=np.int64),
        **sized,
        informed=np.zeros((len(sized["block"]), num_actions)),
        head_vector=np.full(num_blocks, -1, dtype=np.int32),
        head_point=np.full(num_blocks, -1, dtype=np.int32),
        default_vector=np.full(num_blocks, -1, dtype=np.int32),
        table=np.full(1 << 12, -1, dtype=np.int32),
        bin_sum=np.zeros(bins * bins),
        bin_count=np.zeros(bins * bins, dtype=np.int64),
    )


def room_for(layout: Layout) -> dict[int, int]:
    """Return the most that one expansion and one backup may take."""
    num_actions = len(layout.rewards)
    num_symbols = int(layout.observations.columns.max()) + 1
    starts, first = layout.observations.starts, layout.observations.first
    entries = int((starts[first + len(layout.state)] - starts[first]).max())
    outcomes = min(num_symbols, entries)
    widest = int(np.diff(layout.first_state).max())
    return {
        NODES: outcomes + 1,
        EDGES: num_actions,
        OUTCOMES: outcomes,
        WEIGHTS: entries + widest,
        VECTORS: 1,
        VALUES: widest,
        POINTS: 1,
        LINKS: max(outcomes, len(layout.first_state)),
    }


def new_scratch(layout: Layout, depth: int) -> Scratch:
    """Return room for the steps on a layout."""
    num_arrivals = len(layout.state)
    num_symbols = int(layout.observations.columns.max()) + 1
    entries = room_for(layout)[WEIGHTS]
    return Scratch(
        predicted=np.zeros(num_arrivals),
        touched=np.zeros(num_arrivals, dtype=np.int64),
        dense=np.zeros(int(np.diff(layout.first_state).max())),
        tally=np.zeros(num_symbols, dtype=np.int32),
        offset=np.zeros(num_symbols, dtype=np.int64),
        found=np.zeros(num_symbols, dtype=np.int32),
        entry_place=np.zeros(entries, dtype=np.int32),
        entry_weight=np.zeros(entries),
        choice=np.full(num_symbols, -1, dtype=np.int32),
        backed=np.zeros(num_arrivals),
        stamp=np.zeros(num_arrivals + 1, dtype=np.int64),
        path=np.zeros(depth, dtype=np.int32),
        path_action=np.zeros(depth, dtype=np.int32),
    )


def lacking(graph: Graph, room: dict[int, int]) -> dict[str, int]:
    """Return the arrays that have no room for another step, see `room_for`, and the lengths that they need."""
    result = {}
    for name, count in _SIZED.items():
        length, needed = len(getattr(graph, name)), int(graph.counts[count]) + room[count]
        if needed > length:
            result[name] = needed + length // 2
    if 2 * (int(graph.counts[NODES]) + room[NODES]) > len(graph.table):
        result["table"] = 4 * (int(graph.counts[NODES]) + room[NODES])
    return result


def bytes_of(graph: Graph, lengths: dict[str, int]) -> int:
    """Return how many bytes the arrays take that `grown` makes."""
    size: int = sum(length * getattr(graph, name)[:1].nbytes for name, length in lengths.items())
    return size + int(lengths.get("block", 0) * graph.informed[:1].nbytes)


def grown(graph: Graph, lengths: dict[str, int]) -> Graph:
    """Return the graph with some arrays made longer."""
    changed: dict[str, Any] = {}
    for name, length in lengths.items():
        if name == "table":
            changed[name] = hashed(graph.code[: graph.counts[NODES]], length)
        else:
            changed[name] = _longer(getattr(graph, name), length)
    if "block" in lengths:
        changed["informed"] = _longer(graph.informed, lengths["block"])
    return graph._replace(**changed)


def rows_of(graph: Graph, width: int) -> Floats:
    """Return the values of all vectors, which lie one after the other, as the rows of a view."""
    return graph.values[: graph.counts[VALUES]].reshape(-1, width)


def without_beliefs(graph: Graph) -> Graph:
    """Return the graph with its vectors and the best one of each node, but for what only trials need."""
    names = [name for name, count in _SIZED.items() if count in (EDGES, OUTCOMES, WEIGHTS, POINTS)]
    none = {name: np.empty(0, dtype=getattr(graph, name).dtype) for name in (*names, "table", "code")}
    return graph._replace(**none, informed=np.empty((0, graph.informed.shape[1])))


def _longer(array: Any, length: int) -> Any:
    longer = np.zeros((length, *array.shape[1:]), dtype=array.dtype)
    longer[: len(array)] = array
    return longer


def hashed(codes: Long, size: int) -> Integers:
    """Return a hash table of nodes by their codes, with open addressing."""
    length = 1 << max(12, (size - 1).bit_length())
    table = np.full(length, -1, dtype=np.int32)
    waiting = np.arange(len(codes))
    slots = codes & (length - 1)
    while len(waiting):
        # The last one written to a free slot has it.
        free = table[slots] < 0
        table[slots[free]] = waiting[free]
        settled = table[slots] == waiting
        waiting, slots = waiting[~settled], (slots[~settled] + 1) & (length - 1)
    return table
