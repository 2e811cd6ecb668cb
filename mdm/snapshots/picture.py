"""A policy as a picture: plain paths and texts in their places, which the page and an SVG file draw alike.

Tables are decision diagrams, controllers and hierarchies graphs, in columns by the distance from their first node (K.
Sugiyama, S. Tagawa and M. Toda, *Methods for visual understanding of hierarchical system structures*, IEEE Transactions
on Systems, Man, and Cybernetics 11, 1981): an edge has a place in each column that it passes, and sweeps bring all to
the mean height of their neighbours, as near as there is room. Alpha vectors over two or three states have the exact
regions of their actions; over more states, vectors are asked where they are sure of a state, by two factors.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable
from contextlib import suppress
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec
import numpy as np
from scipy.sparse import csr_array

from mdm.errors import ModelError
from mdm.explanation.case import Case, belief_of, beliefs, state_of
from mdm.models import Factor
from mdm.policies import AlphaVectors, StagedPolicy, StatePolicy, StochasticPolicy
from mdm.policies.finite_state_controller import Plan
from mdm.policies.shielded import Shielded
from mdm.snapshots.beliefs import chances_of
from mdm.snapshots.diagram import Diagram
from mdm.texts import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from mdm.actors import Ensemble
    from mdm.models import Space
    from mdm.policies import FiniteStateController
    from mdm.snapshots.frame import EnsembleScene

MOST = 40
"""Nodes up to which a graph is drawn whole."""
_SHOWN, _FAN, _OPENED = 22, 6, 60
"""Of a larger graph: the nodes that are drawn, the followers of each, and those of one that is opened."""
_LETTER, _LINE, _PAD, _LONGEST = 6.9, 15.0, 14.0, 26
"""The width of a letter, the height of a line, the room around a text, and the letters of the longest one."""
_SIDE, _BAND, _CELLS, _CELL = 260.0, 44.0, (20, 7), (100.0, 24.0)
"""The side of a triangle, the height of regions on a line; how many cells two factors have, and the size of one."""
_CODE = "it is code, or searches: only tables, controllers and alpha vectors have a picture"
_GAP, _SWEEPS, _NAMED, _PART = 18.0, 24, 12, 1 << 15
"""The room between columns, sweeps over them, names that are kept of an edge, entries of a table at a time."""


class Shape(msgspec.Struct, frozen=True, omit_defaults=True):
    """A shape, in the order of drawing.

    Attributes:
        kind: An ``area`` of beliefs, an ``edge``, ``box`` or ``text``, the ``way`` of the belief, its place ``now``.
        path: As SVG has it.
        x: The middle of the text.
        y: The middle of its lines.
        text: Its lines.
        title: The whole text.
        action: The name of the action whose colour it has; empty for none.
        lit: Whether the present decision passes it.
        opens: The node whose followers are drawn where somebody presses it; -1 for none.
    """

    kind: Literal["area", "edge", "box", "text", "way", "now"]
    path: str = ""
    x: float = 0.0
    y: float = 0.0
    text: tuple[str, ...] = ()
    title: str = ""
    action: str = ""
    lit: bool = False
    opens: int = -1


class Picture(msgspec.Struct, frozen=True, omit_defaults=True):
    """A policy, or the hierarchy of ensembles, drawn.

    Attributes:
        title: The kind of picture, and of how much.
        remarks: How much is folded; where there is no picture they say why.
        width: In pixels of a text of 12.
        height: The same.
        shapes: The picture.
    """

    title: str
    remarks: tuple[str, ...] = ()
    width: float = 0.0
    height: float = 0.0
    shapes: tuple[Shape, ...] = ()


def picture_of(case: Case, opened: Collection[int] = (), way: Sequence[Any] | None = None) -> Picture:
    """Return the policy of a case as a picture, with the decision lit.

    Args:
        case: The decision; ``at`` is None where there is none.
        opened: The nodes whose followers are drawn, though others are folded.
        way: The beliefs of the decisions before; by default those that the case tells.

    Example::

        picture_of(mdm.Controller("tiger.vf", "tiger.pomdp").start().case()).title  # 'actions over beliefs in 2 states'
    """
    policy: Any = case.policy
    if isinstance(policy, Plan):
        return _drawn(_plan(case, policy.controllers), opened)
    kept = diagram if isinstance(policy, Hashable) else diagram.__wrapped__  # policies of users may have no hash
    if (found := kept(policy, case.states)) is not None:
        return _drawn(_decisions(case, *found), opened)
    if isinstance(policy, AlphaVectors):
        return _simplex(case, way) if policy.num_states in {2, 3} else _regions(case)
    if isinstance(policy, Shielded):
        told = picture_of(case._replace(policy=policy.policy), opened, way)
        remarks = "drawn without its shield, which may replace actions", *told.remarks
        return msgspec.structs.replace(told, remarks=remarks)
    return Picture(getattr(policy, "form", "a policy of another kind"), (_CODE,))


def pictures(
    case: Case | None,
    scenes: Sequence[EnsembleScene],
    path: str,
    running: Mapping[str, Collection[str]],
    **options: Any,
) -> tuple[Picture, ...]:
    """Return the policy of an ensemble as a picture, and that of its hierarchy where it has one.

    Args:
        case: Its last decision; None where its policy is not known.
        scenes: All ensembles.
        path: Its path.
        running: The live actions of each, or its last one.
        options: As of `picture_of`.
    """
    own = Picture("no picture", ("its policy is not known here",)) if case is None else picture_of(case, **options)
    above = hierarchy(scenes, running, path)
    return (own,) if above is None else (own, above)


def case_of(ensemble: Ensemble, at: Any = None) -> Case:
    """Return a decision of an ensemble on some information, with all names, as far as a picture needs it."""
    controller, symbols = ensemble.controller, ensemble.controller.symbols
    states = symbols.state_space or getattr(controller.policy, "state_space", None)
    spaces = states, symbols.action_space, symbols.observation_space
    return ensemble.named(Case(controller.policy, controller.model, *spaces, -1, -1, at))


# -- Graphs ------------------------------------------------------------------------------------------------------------

Edges = dict[int, tuple[int, list[str]]]
"""The nodes that follow one, each with the number of edges to it and the first names of these."""


class _Graph(NamedTuple):
    """A graph: an entry for each edge, N x N; the text, title and action of a node; its edges; the first nodes.

    ``lit`` has the nodes that are lit, each with those after it to which the way goes, ``kept`` those that are drawn
    besides, whatever is folded. A column is by default the distance from the first nodes.
    """

    title: str
    links: Any
    node: Callable[[int], tuple[str, str, str]]
    edges: Callable[[int], Edges]
    firsts: Sequence[int]
    lit: dict[int, list[int]]
    column: Callable[[int], int] | None = None
    kept: Sequence[int] = ()


def _folded(graph: _Graph, opened: Collection[int]) -> tuple[dict[int, Edges], dict[int, int]]:
    """Return the nodes that are drawn with their edges, of many the lit ones and those near the first; and columns."""
    few, waiting = graph.links.shape[0] <= MOST, deque((*graph.firsts, *graph.lit))
    kept = {node: graph.edges(node) for node in (*graph.lit, *graph.kept)}
    met = set[int]()
    while waiting:
        node = waiting.popleft()
        if node not in met and (node in kept or few or len(kept) < _SHOWN):
            met.add(node)
            kept[node] = graph.edges(node)
            near = [*kept[node]]
            waiting += near if few else [*near[:_FAN], *(other for other in near if other in kept)]
    for node in opened:
        kept |= {other: graph.edges(other) for other in [*kept.get(node, ())][:_OPENED]}
    if graph.column is not None:
        return kept, {node: graph.column(node) for node in kept}
    columns: dict[int, int] = {}
    for starts in (graph.firsts, *([node] for node in kept)):  # a lit node that is reached stands where it is reached
        reached = deque((node, 0) for node in starts)
        while reached:
            node, column = reached.popleft()
            if node in kept and node not in columns:
                columns[node] = column
                reached += [(other, column + 1) for other in kept[node]]
    return kept, columns


def _drawn(graph: _Graph, opened: Collection[int] = ()) -> Picture:
    """Return a graph as a picture: boxes in the even columns, and the texts of edges in the odd ones between."""
    from scipy.sparse.csgraph import breadth_first_order  # noqa: PLC0415 - slow to import

    (kept, columns), count = _folded(graph, opened), graph.links.shape[0]
    free = np.ones(count, np.bool_)
    free[[*kept]] = False
    hidden = graph.links.multiply(free).tocsr()  # edges to nodes that are not drawn
    hidden.eliminate_zeros()
    stops: dict[Any, tuple[int, Shape]] = {}  # boxes, and each edge in each column that it passes
    edges: list[tuple[int, int, Shape]] = []
    for node, after in kept.items():
        text, title, action = graph.node(node)
        texts = (_short(text), *([f"↻ {_listed([after[node]])}"] if node in after else []))
        stops[node] = 2 * columns[node], Shape("box", text=texts, title=title, action=action, lit=node in graph.lit)
        seen = {other: [edge] for other, edge in after.items() if other in kept and other != node}
        if folded := [edge for other, edge in after.items() if free[other]]:
            seen[-2 - node] = folded
            text = f"+ {len(breadth_first_order(hidden, node, return_predecessors=False)) - 1:,} folded"
            stops[-2 - node] = 2 * columns[node] + 2, Shape("box", text=(text,), title=f"open {text[2:]}", opens=node)
        for other, parts in seen.items():
            whole = ", ".join(name for _, names in parts for name in names[:_NAMED])
            lit = other in graph.lit.get(node, ())
            edges.append((node, other, Shape("edge", text=(_listed(parts),), title=whole, lit=lit)))
    ways = []
    for place, (source, target, edge) in enumerate(edges):
        begin, end = stops[source][0], stops[target][0]
        passed = range(begin - 1, end, -1) if end < begin else range(begin + 1, max(end, begin + 2))
        stops |= {(place, at): (at, edge if at == passed[0] else Shape("edge")) for at in passed}
        ways.append([source, *((place, at) for at in passed), target])
    heights = {stop: _LINE * len(each.text) + (12 if each.kind == "box" else 3) for stop, (_, each) in stops.items()}
    y = _heights({stop: column for stop, (column, _) in stops.items()}, ways, heights)
    widths = [0.0] * (2 + max(column for column, _ in stops.values()))
    for column, each in stops.values():
        widths[column] = max(widths[column], _width(each.text))
    lefts = [*accumulate((width + _GAP for width in widths), initial=_PAD)]
    middles = {stop: lefts[column] + widths[column] / 2 for stop, (column, _) in stops.items()}
    halves = {stop: (_width(each.text) if each.kind == "box" else widths[at]) / 2 for stop, (at, each) in stops.items()}
    shapes = []
    for way, (_, _, edge) in zip(ways, edges, strict=True):
        path = _path([(middles[stop] - halves[stop], middles[stop] + halves[stop], y[stop]) for stop in way])
        shapes.append(msgspec.structs.replace(edge, path=path, x=round(middles[way[1]], 1), y=round(y[way[1]], 1)))
    shapes.sort(key=lambda edge: edge.lit)
    for stop, (_, box) in stops.items():
        if box.kind == "box":
            x, height = middles[stop], heights[stop] - 4
            path = _rectangle(x - halves[stop], y[stop] - height / 2, 2 * halves[stop], height)
            shapes.append(msgspec.structs.replace(box, path=path, x=round(x, 1), y=round(y[stop], 1)))
    bottom = max(y[stop] + heights[stop] / 2 for stop in stops) + _PAD
    unmet = [graph.node(int(node))[1] for node in np.flatnonzero(free)[:MOST]]
    folds = f"{free.sum():,} of {count:,} nodes are folded: press one to open it"
    remarks = ((folds if count > MOST else f"never reached: {', '.join(unmet)}"),) if unmet else ()
    return Picture(graph.title, remarks, round(lefts[-2]), round(bottom), tuple(shapes))


def _heights(columns: dict[Any, int], ways: list[list[Any]], room: dict[Any, float]) -> dict[Any, float]:
    """Return the height of the middle of each stop, in an order of each column that crosses few edges."""
    held: defaultdict[int, list[Any]] = defaultdict(list)
    near: defaultdict[Any, list[Any]] = defaultdict(list)
    for stop, column in columns.items():
        held[column].append(stop)
    for one, two in (pair for way in ways for pair in pairwise(way)):
        near[one].append(two)
        near[two].append(one)
    y = dict.fromkeys(columns, 0.0)
    for turn in range(_SWEEPS):
        back, last = turn % 2 == 1, turn > _SWEEPS - 5
        for column in sorted(held, reverse=back):
            wanted = {}
            for stop in held[column]:
                beside = [y[other] for other in near[stop] if last or (columns[other] > column) == back]
                wanted[stop] = sum(beside) / len(beside) if beside else y[stop]
            y |= _spread({stop: wanted[stop] for stop in sorted(wanted, key=wanted.__getitem__)}, room)
    top = min(y[stop] - room[stop] / 2 for stop in y) - _PAD
    return {stop: height - top for stop, height in y.items()}


def _spread(wanted: dict[Any, float], room: dict[Any, float]) -> dict[Any, float]:
    """Return the heights nearest to those that are wanted, by least squares, where each has its room, in their order.

    Those that would be too near to each other are pooled (R. E. Barlow, D. J. Bartholomew, J. M. Bremner and H. D.
    Brunk, *Statistical inference under order restrictions*, Wiley 1972).
    """
    pools: list[tuple[float, list[tuple[Any, float]]]] = []  # sums, and stops with how far each is below the first
    offset = before = 0.0
    for stop, height in wanted.items():
        offset += (before + room[stop]) / 2
        before = room[stop]
        total, pooled = height - offset, [(stop, offset)]
        while pools and pools[-1][0] / len(pools[-1][1]) > total / len(pooled):
            above, others = pools.pop()
            total, pooled = total + above, others + pooled
        pools.append((total, pooled))
    return {stop: total / len(pooled) + offset for total, pooled in pools for stop, offset in pooled}


def _path(spans: list[tuple[float, float, float]]) -> str:
    """Return the path of an edge through stops, each with its left, its right and its height."""
    (first, right, y), (left, _, middle), (last, end, below) = spans[0], spans[1], spans[-1]
    if left > max(right, end):  # both ends are in one column
        there = f"Q{left:.1f} {y:.1f} {left:.1f} {middle:.1f}Q{left:.1f} {below:.1f} {end:.1f} {below:.1f}"
        return f"M{right:.1f} {y:.1f}{there}"
    back = first > last
    path, x = f"M{first if back else right:.1f} {y:.1f}", first if back else right
    for left, right, height in spans[1:]:
        enter, leave = (right, left) if back else (left, right)
        half = (x + enter) / 2
        path += f"C{half:.1f} {y:.1f} {half:.1f} {height:.1f} {enter:.1f} {height:.1f}"
        path += f"H{leave:.1f}" * ((left, right, height) != spans[-1])
        x, y = leave, height
    return path


def _rectangle(left: float, top: float, width: float, height: float) -> str:
    return f"M{left:.1f} {top:.1f}h{width:.1f}v{height:.1f}h{-width:.1f}z"


def _short(text: str, most: int = _LONGEST) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _listed(parts: Sequence[tuple[int, list[str]]]) -> str:
    """Return the names of edges as a text of a line."""
    names, count = [name for _, names in parts for name in names], sum(count for count, _ in parts)
    whole = ", ".join(names)
    if count <= 1 or (count == len(names) and len(whole) <= _LONGEST):
        return _short(whole)
    return f"{_short(names[0], _LONGEST - 10)} and {count - 1:,} more"


def _width(text: Sequence[str]) -> float:
    return max([_LETTER * len(line) for line in text if line] + [0.0]) + _PAD


# -- Tables, controllers and hierarchies -------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def diagram(policy: Any, states: Space | None) -> tuple[Diagram, Any, list[Factor], list[Any]] | None:
    """Return a table as a diagram, its links, its factors, and the actions of each of its entries; None of no table.

    An entry is an action, or the probabilities of all. Where decisions are counted, their number is the first factor.
    """
    form, entries = getattr(policy, "table", None), list[Any](range(policy.num_actions))
    if isinstance(policy, StagedPolicy):
        table = policy.values.argmax(axis=2)
    elif form is not None:  # in parts, for whoever waits for the interpreter meanwhile
        table = np.concatenate([np.array(form[at : at + _PART]) for at in range(0, len(form), _PART)])
    elif isinstance(policy, StatePolicy) and isinstance(getattr(policy, "policy", policy), StochasticPolicy):
        found, table = np.unique(policy.weights().T, axis=0, return_inverse=True)
        entries = [*found]
    else:
        return None
    factors = _factors(policy, states)
    if table.ndim == 2 and policy.horizon is not None:
        factors.insert(0, Factor("decision", [str(number) for number in range(1, len(table) + 1)]))
    made = Diagram.of(table.reshape([len(each) for each in factors]).astype(np.int64), len(entries))
    count = len(entries) + sum(map(len, made.levels))
    levels = zip(made.firsts, made.levels, strict=True)
    heads = np.concatenate([np.arange(first, first + len(rows)).repeat(rows.shape[1]) for first, rows in levels])
    return made, _links(count, heads, np.concatenate([*map(np.ravel, made.levels)])), factors, entries


def _factors(policy: Any, states: Space | None) -> list[Factor]:
    """Return the factors of a policy's states; one without names where none are known that fit."""
    if states is None or len(states) != policy.num_states:
        return [Factor("state", policy.num_states)]
    return [*states.factors]


def _decisions(case: Case, made: Diagram, links: Any, factors: list[Factor], entries: list[Any]) -> _Graph:
    """Return the graph of a diagram, with the way of the state lit."""
    state, staged = state_of(case.at), [case.at.stage] if hasattr(case.at, "stage") else []
    own = [len(each) for each in factors[len(staged) :]]
    values = [] if state is None else [*staged, *np.unravel_index(state, own)]
    way = made.path(values) if values else []

    def node(number: int) -> tuple[str, str, str]:
        if (at := made.place(number)) < len(factors):
            return factors[made.order[at]].name, f"asks for {factors[made.order[at]].name}", ""
        entry = entries[number]
        if isinstance(entry, int):
            return case.action_name(entry), case.action_name(entry), case.action_name(entry)
        likely = [int(action) for action in np.argsort(-entry, kind="stable") if entry[action] > 0]
        told = " or ".join(f"{case.action_name(action)} {entry[action]:.0%}" for action in likely)
        return told, told, case.action_name(likely[0])

    def edges(number: int) -> Edges:
        if (at := made.place(number)) == len(factors):
            return {}
        factor, row = factors[made.order[at]], made.levels[at][number - made.firsts[at]]
        order = np.argsort(row, kind="stable")
        if number in way:  # the present value comes first
            order = np.concatenate([[now := values[made.order[at]]], order[order != now]])
            order = order[np.argsort(row[order], kind="stable")]
        parts = np.split(order, np.flatnonzero(np.diff(row[order])) + 1)
        return {int(row[part[0]]): (len(part), [factor.names[int(place)] for place in part[:_NAMED]]) for part in parts}

    asked = [at for at, rows in enumerate(made.levels) if len(rows)]
    names = ", ".join(factors[made.order[at]].name for at in asked)
    title = f"decides by {names}" if asked else "decides always the same"
    columns = {at: column for column, at in enumerate([*asked, len(factors)])}
    lit = {one: [two] for one, two in pairwise(way)} | {each: [] for each in way[-1:]}
    return _Graph(title, links, node, edges, [made.root], lit, lambda number: columns[made.place(number)])


def _listing(nodes: Sequence[tuple[str, str, str]], after: Sequence[Mapping[int, list[str]]], **options: Any) -> _Graph:
    """Return a graph of nodes that are listed, each with the names of the edges to those after it."""
    heads = [one for one, edges in enumerate(after) for _ in edges]
    links = _links(len(nodes), heads, [two for edges in after for two in edges])
    parts = [{two: (len(names), names) for two, names in edges.items()} for edges in after]
    return _Graph(links=links, node=nodes.__getitem__, edges=parts.__getitem__, **options)


def _links(count: int, heads: Any, tails: Any) -> Any:
    return csr_array((np.ones(len(heads), np.bool_), (heads, tails)), (count, count))


def _plan(case: Case, plans: Sequence[FiniteStateController]) -> _Graph:
    """Return the graph of a finite-state controller, or of those of all agents; of a large one around its node."""
    nodes: list[tuple[str, str, str]] = []
    after: list[dict[int, list[str]]] = []
    firsts, now = [], []
    for agent, plan in enumerate(plans):
        start = len(nodes)
        firsts.append(start + plan.start)
        now += [] if case.at is None else [start + case.at[agent]]
        whose = f"agent {agent}: " if len(plans) > 1 else ""
        action_name, seen_name = (_own(space, agent, len(plans)) for space in (case.actions, case.observations))
        for number, (action, row) in enumerate(zip(plan.actions, plan.successors, strict=True)):
            name = action_name(action)
            nodes.append((f"{whose}{name}", f"{whose}node {number}: {name}", name))
            edges: defaultdict[int, list[str]] = defaultdict(list)
            for seen, other in enumerate(row):
                if other is not None:
                    edges[start + other].append(seen_name(seen))
            after.append(edges)
    around, lit = now if now and len(nodes) > MOST else firsts, {each: list[int]() for each in now}
    return _listing(nodes, after, title=f"a controller of {counted(len(nodes), 'node')}", firsts=around, lit=lit)


def _own(space: Space | None, agent: int, agents: int) -> Callable[[int], str]:
    """Return the names of an agent's own actions or observations."""
    if space is None or len(space.factors) != agents > 1:
        return str
    return (space if agents == 1 else space.factors[agent]).names.__getitem__


def hierarchy(ensembles: Sequence[EnsembleScene], acting: Mapping[str, Collection[str]], chosen: str) -> Picture | None:
    """Return the hierarchy of an ensemble as a picture, by path, with those lit that act; None where it is alone."""
    first = len(ensembles)
    nodes = [(each.path.rpartition("/")[2], f"ensemble {each.path}", "") for each in ensembles]
    after: list[dict[int, list[str]]] = [{} for _ in ensembles]
    numbers: dict[tuple[int, str], int] = {}
    for place, each in enumerate(ensembles):
        for name in each.actions:
            numbers[place, name] = len(nodes)
            after[place][len(nodes)] = [""]
            nodes.append((name, f"action {name} of {each.path}", name))
            after.append({})
    way = [next(place for place, each in enumerate(ensembles) if each.path == chosen)]
    for place, each in enumerate(ensembles):
        if each.parent >= 0:
            after[numbers.get((each.parent, each.bound), each.parent)][place] = [""]
    while (parent := ensembles[way[0]].parent) >= 0:
        way = [parent, numbers.get((parent, ensembles[way[0]].bound), parent), *way]
    if len(way) == 1 and not any(after[other] for other in after[way[0]]):
        return None
    lit: dict[int, list[int]] = {}
    running = way[:1]
    for number in running:
        acts = () if number >= first else acting.get(ensembles[number].path, ())
        lit[number] = [other for other in after[number] if not other >= first > number or nodes[other][0] in acts]
        running += lit[number]
    made = _drawn(_listing(nodes, after, title="which ensemble runs in which", firsts=way[:1], lit=lit, kept=way))
    shapes = tuple([msgspec.structs.replace(shape, opens=-1) for shape in made.shapes])
    remarks = ("of many ensembles those near the top and the chosen one are drawn",) if made.remarks else ()
    return msgspec.structs.replace(made, shapes=shapes, remarks=remarks)


# -- Beliefs -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def regions(policy: AlphaVectors) -> list[tuple[int, Any]]:
    """Return the action of each vector that is greatest somewhere, with the corners of where that is, N x S.

    A region is cut out of all beliefs by the vector that is greatest beyond it, until there is none.
    """
    _, kept = np.unique(policy.vectors, axis=0, return_index=True)
    vectors, found = policy.vectors[np.sort(kept)], []
    close = 1e-12 * (1.0 + np.abs(vectors).max())
    for action, vector in zip(np.asarray(policy.actions)[np.sort(kept)].tolist(), vectors, strict=True):
        corners, greater = np.eye(policy.num_states), vectors - vector
        while len(corners) >= policy.num_states:
            most = (greater @ corners.T).max(axis=1)
            if most[worst := int(most.argmax())] <= close:
                found.append((action, corners))
                break
            corners, greater[worst] = _cut(corners, -greater[worst]), 0.0
    return found


def _cut(corners: Any, normal: Any) -> Any:
    """Return the part of a convex polygon, or of a line, in which a linear function is not negative."""
    values, kept = corners @ normal, []
    for one, two in pairwise([*range(len(corners)), 0]):
        if values[one] >= 0:
            kept.append(corners[one])
        if values[one] * values[two] < 0 and (len(corners) > 2 or one < two):
            kept.append(corners[one] + (corners[two] - corners[one]) * values[one] / (values[one] - values[two]))
    return np.array(kept)


def _simplex(case: Case, way: Sequence[Any] | None) -> Picture:
    """Return alpha vectors over two states as a line, over three as a triangle, with the way of the belief."""
    policy: Any = case.policy
    states = [_short(case.state_name(state)) for state in range(policy.num_states)]
    three, left, top = len(states) == 3, max(_width((state,)) for state in states), 2 * _LINE
    height = _SIDE * 0.75**0.5 if three else _BAND
    corners = np.array([(left, top + height), (left + _SIDE, top + height), (left + _SIDE / 2, top)][: len(states)])
    areas, named = [], dict[str, tuple[float, float, float]]()
    for action, found in regions(policy):
        points = found @ corners
        points = points if three else np.concatenate([points, points[::-1] - (0, height)])
        name, (x, y), size = case.action_name(action), points.mean(axis=0).tolist(), np.ptp(points, axis=0).prod()
        named[name] = max(named.get(name, (0.0, 0.0, 0.0)), (float(size), x, y))  # in its largest part
        areas.append(Shape("area", f"M{_points(points)}z", title=name, action=name))
    order = {name: x for name, (_, x, _) in sorted(named.items(), key=lambda item: item[1][1])}
    across = order if three else _spread(order, {name: _width((name,)) for name in order})
    texts = [Shape("text", "", across[name], named[name][2] if three else top - 12, (name,)) for name in order]
    for state, (x, y), side in zip(states, corners.tolist(), (-0.5, 0.5, 0), strict=False):
        texts.append(Shape("text", "", x + side * left, y - 12 if not side else y - height / 2 * (not three), (state,)))
    known: list[Any] = [belief_of(case._replace(at=at)) for at in [*(way or ()), case.at]]
    with suppress(ModelError):  # of a tracker of the user's it is the present one alone
        known = (beliefs(case) if way is None else None) or known
    points = np.array([belief for belief in known if belief is not None]).reshape(-1, len(states)) @ corners
    if not three:  # each one below those after it
        points[:, 1] += _LINE * np.arange(len(points))[::-1] - height / 2
    if len(points):
        dot = "m-6 0a6 6 0 1 0 12 0a6 6 0 1 0 -12 0"
        texts += [Shape("way", f"M{_points(points)}"), Shape("now", f"M{_points(points[-1:])}{dot}", lit=True)]
    title, low = f"actions over beliefs in {len(states)} states", max([top + height, *points[:, 1]]) + _PAD
    return Picture(title, (), _SIDE + 2 * left, round(low), (*areas, *texts))


def _points(points: Any) -> str:
    return "L".join(f"{x:.1f} {y:.1f}" for x, y in points.tolist())


@lru_cache(maxsize=8)
def _certain(policy: AlphaVectors, shape: tuple[int, ...]) -> tuple[Any, list[int]]:
    """Return the action where the state is known, by factors; and the factors, those that change most actions first."""
    table = np.asarray(policy.actions)[policy.vectors.argmax(axis=0)].reshape(shape)
    changed = [np.count_nonzero(table != table.take([0], axis)) for axis in range(len(shape))]
    return table, sorted(range(len(shape)), key=lambda axis: -changed[axis])


def _regions(case: Case) -> Picture:
    """Return the actions over the two factors that matter most where the state is known, other factors as they are."""
    policy: Any = case.policy
    factors = _factors(policy, case.states)
    factors += [Factor("action", [""])] * (len(factors) == 1)
    shape = tuple(map(len, factors))
    table, order = _certain(policy, shape)
    states, chances = chances_of(case.at) or ([0], [1.0])
    now = [int(np.bincount(part, chances).argmax()) for part in np.unravel_index(states, shape)]
    axes, (wide, high), shapes = sorted(order[:2]), _CELL, []
    starts = [max(0, min(now[axis] - most // 2, shape[axis] - most)) for axis, most in zip(axes, _CELLS, strict=True)]
    rows, columns = (range(shape[axis])[start:][:most] for axis, start, most in zip(axes, starts, _CELLS, strict=True))
    names = [factors[axis].names for axis in axes]
    for y, row in enumerate(rows, 1):
        shapes.append(Shape("text", "", wide / 2, high * (y + 0.5), (_short(names[0][row], 13),)))
        for x, column in enumerate(columns, 1):
            at = [{axes[0]: row, axes[1]: column}.get(axis, value) for axis, value in enumerate(now)]
            name, path = case.action_name(int(table[tuple(at)])), _rectangle(wide * x, high * y, wide, high)
            title, middle = f"{names[0][row]} {names[1][column]}: {name}", (wide * (x + 0.5), high * (y + 0.5))
            shapes.append(Shape("area", path, *middle, (_short(name, 13),), title, name, at == now))
    for x, column in enumerate(columns, 1):
        shapes.append(Shape("text", "", wide * (x + 0.5), high / 2, (_short(names[1][column], 13),)))
    shapes.sort(key=lambda shape: shape.lit)
    others = [f"{factors[axis].name} {factors[axis].names[now[axis]]}" for axis in order[2:]]
    remarks = [f"drawn for beliefs that are sure of the state{', with ' * bool(others)}{', '.join(others)}"]
    if len(rows) * len(columns) < shape[axes[0]] * shape[axes[1]]:
        sizes = f"{len(rows)} of {shape[axes[0]]} and {len(columns)} of {shape[axes[1]]}"
        remarks.append(f"{sizes} values, near the likeliest")
    title = f"actions by {' and '.join(factors[axis].name for axis in axes if shape[axis] > 1)}"
    return Picture(title, tuple(remarks), wide * (len(columns) + 1), high * (len(rows) + 1), tuple(shapes))
