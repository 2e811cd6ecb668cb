"""The data of SARSOP: the layout of a model, and the graph of beliefs, actions, observations, vectors and points.

Where part of the state is seen (mixed observability), beliefs never leave the states of one value of it. Such states
make a block; states are renumbered so that a block's lie side by side, and vectors are over one block each.

Where observations are events, and where there are false negatives, an action leads to *arrivals*: pairs of a state and
the observation on the way there. Its transition is the one to the next detection: the discounted steps without one,
and the step that ends in it (see `mdm.solvers.joint_dynamics`). Else a state is its own arrival.

The graph lies in arrays that compiled code can fill; when they are full, they are copied to larger ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt

from mdm.models.dynamics import Dynamics, Indices, Rows, dense, stacked
from mdm.models.matrices import csr

if TYPE_CHECKING:
    from mdm.models import POMDP
    from mdm.models.matrices import Matrix
    from mdm.solvers.joint_dynamics import JointDynamics

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]
Long = npt.NDArray[np.int64]

_BYTES = 32
"""For each number of T: itself and its column, in one matrix and in all of them together."""


class Layout(NamedTuple):
    """A model's numbers.

    Attributes:
        discount: In (0, 1).
        rewards: A x S.
        transitions: T, from states to arrivals.
        observations: O, a row for each arrival.
        state: Each arrival's state.
        block: Each state's block.
        first_state: Where each block begins, and the end of the last.
    """

    discount: float
    rewards: npt.NDArray[np.float64]
    transitions: Rows
    observations: Rows
    state: Long
    block: Integers
    first_state: Long


def layout_of(model: POMDP, dynamics: Dynamics, detections: JointDynamics | None = None) -> tuple[Layout, Indices]:
    """Return a model's layout, and the model's states in the layout's order.

    Args:
        model: The model.
        dynamics: Its dynamics.
        detections: The ways to detections, where observations are events or may be missed.
    """
    blocks = model.layout
    order: Indices = blocks.ravel()
    rewards = dynamics.rewards.T
    if detections is not None:
        rewards = np.stack([detections.earned(action, values) for action, values in enumerate(detections.rewards)])
        transitions, observations, state = _arrivals(detections, order)
    else:
        transitions, observations, state = dynamics.transitions, dynamics.observations, np.arange(len(order))
        if len(blocks) > 1:
            transitions = _renumbered(transitions, order, len(order))
            transitions = transitions._replace(columns=_places(order)[transitions.columns].astype(np.uint32))
            observations = _renumbered(observations, order, dynamics.num_observations)
    count, width = blocks.shape
    return Layout(
        dynamics.discount,
        np.ascontiguousarray(rewards[:, order]),
        transitions,
        observations,
        state,
        np.repeat(np.arange(count, dtype=np.int32), width),
        np.arange(count + 1, dtype=np.int64) * width,
    ), order


def _places(order: Indices) -> Indices:
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    return place


def _renumbered(rows: Rows, order: Indices, width: int) -> Rows:
    """Return rows with those of each action in another order."""
    size = len(order)
    begins = np.arange(0, len(rows.starts) - 1, size)
    moved = rows.matrix(width)[(begins[:, None] + order).ravel()]
    return Rows(rows.first, moved.indptr.astype(np.uint64), moved.indices.astype(np.uint32), moved.data)


def bytes_of_arrivals(detections: JointDynamics) -> int:
    """Return about how many bytes the rows take of actions that go on without a detection; they have few zeros."""
    widths = [len(detections.columns(a)[0]) for a in range(detections.num_actions) if detections.waits_in(a)]
    return _BYTES * detections.size * sum(widths)


def _arrivals(detections: JointDynamics, order: Indices) -> tuple[Rows, Rows, Long]:
    """Return T to arrivals, the observations at them, and their states; arrivals are ordered by observation."""
    size, place = len(order), _places(order)
    columns = [o * size + place[s] for o, s in map(detections.columns, range(detections.num_actions))]
    arrivals = np.unique(np.concatenate([[0], *columns]))  # one at least, where nothing is ever detected
    matrices: list[Matrix] = []
    for action, own in enumerate(columns):
        matrix = detections.ahead[action]
        if detections.waits_in(action):
            matrix = detections.earned(action, dense(matrix))
        rows = csr(matrix[order])
        parts = rows.data, np.searchsorted(arrivals, own)[rows.indices], rows.indptr
        matrices.append(csr(parts, (size, len(arrivals))))
    symbols, state = np.divmod(arrivals, size)
    count = len(arrivals)
    first, starts = np.zeros(len(columns), dtype=np.int64), np.arange(count + 1, dtype=np.uint64)
    return stacked(matrices), Rows(first, starts, symbols.astype(np.uint32), np.ones(count)), state


# -- The graph ---------------------------------------------------------------------------------------------------------

NODES, EDGES, OUTCOMES, WEIGHTS, VECTORS, VALUES, POINTS, LINKS = range(8)
"""Places in ``counts``."""


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

_KINDS: dict[Any, Any] = {Floats: np.float64, Integers: np.int32, Long: np.int64}
"""The numbers of arrays, by the type of their field."""


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
    hints = get_type_hints(Graph)
    sized: dict[str, Any] = {
        name: np.zeros(2 * room[count] + 64, dtype=_KINDS[hints[name]]) for name, count in _SIZED.items()
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
    """Return the graph with its vectors and the best one of each node, but for the arrays of trials alone."""
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
