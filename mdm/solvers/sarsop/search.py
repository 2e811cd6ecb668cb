"""SARSOP's steps, compiled where there is numba: expansion, bounds, backups, and the sampling of trials.

They call each other, and so they are in one file: numba does not renew what it keeps of a function on disk when a
function in another file changes. A call costs as much as a comparison: the innermost loops have none, or hand over a
few arrays in place of a whole graph.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mdm.compilation import compiled
from mdm.solvers.sarsop.graph import EDGES, LINKS, NODES, OUTCOMES, POINTS, VALUES, VECTORS, WEIGHTS, Graph, Scratch

if TYPE_CHECKING:
    from mdm.solvers.sarsop.graph import Layout

_GRID = 1e12
"""Beliefs that agree to one part in so many are one, and have one upper bound: a coarser grid shows in it."""
_NEGLIGIBLE = 1e-10
"""Weights below this part of a belief are left out. In models of some noise they are most of its states."""
_DEEP, _SHALLOW = 0.2, 0.5


@compiled
def _informed(graph: Graph, node: int) -> float:
    """Return the informed bound of a belief."""
    best = graph.informed[node, 0]
    for action in range(1, graph.informed.shape[1]):
        best = max(best, graph.informed[node, action])
    return float(best)


@compiled
def _product(values: np.ndarray, at: int, place: np.ndarray, weight: np.ndarray, first: int, last: int) -> float:
    """Return the product of a vector and a belief, in four sums that need not wait for each other."""
    one = two = three = four = 0.0
    k = first
    while k + 3 < last:
        one += values[at + place[k]] * weight[k]
        two += values[at + place[k + 1]] * weight[k + 1]
        three += values[at + place[k + 2]] * weight[k + 2]
        four += values[at + place[k + 3]] * weight[k + 3]
        k += 4
    while k < last:
        one += values[at + place[k]] * weight[k]
        k += 1
    return float((one + two) + (three + four))


@compiled
def _raise(graph: Graph, node: int) -> None:
    """Compare the lower bound of a belief with the vectors that are new to it."""
    first = graph.first_weight[node]
    last = first + graph.num_weights[node]
    vector = graph.head_vector[graph.block[node]]
    seen = graph.seen_vectors[node]
    while vector >= seen:
        value = _product(graph.values, graph.first_value[vector], graph.place, graph.weight, first, last)
        if value > graph.lower[node]:
            graph.lower[node] = value
            graph.best[node] = vector
        vector = graph.next_vector[vector]
    graph.seen_vectors[node] = graph.counts[VECTORS]


@compiled
def _reduce(graph: Graph, scratch: Scratch, node: int) -> None:  # noqa: C901 - one pass, no calls
    """Compare the upper bound of a belief with the points that are new to it."""
    point = graph.head_point[graph.block[node]]
    seen = graph.seen_points[node]
    if point >= seen:
        first = graph.first_weight[node]
        last = first + graph.num_weights[node]
        num_actions = graph.informed.shape[1]
        dense = scratch.dense
        for k in range(first, last):
            dense[graph.place[k]] = graph.weight[k]
        upper = graph.upper[node]
        most = _informed(graph, node)
        while point >= seen:
            other = graph.point_node[point]
            if graph.num_weights[other] <= last - first and graph.point_value[point] <= graph.upper[other]:
                # A point lowers the informed bound by no more than its ratio times its own drop.
                least = (most - upper) / graph.point_drop[point]
                ratio = np.inf
                begin = graph.first_weight[other]
                for k in range(begin, begin + graph.num_weights[other]):
                    if dense[graph.place[k]] < ratio * graph.weight[k]:
                        ratio = dense[graph.place[k]] / graph.weight[k]
                        if ratio <= least:
                            break
                if ratio > least:
                    rest = -np.inf
                    for action in range(num_actions):
                        value = graph.informed[node, action] - ratio * graph.informed[other, action]
                        rest = max(rest, value)
                    upper = min(upper, ratio * graph.point_value[point] + rest)
            point = graph.next_point[point]
        graph.upper[node] = upper
        for k in range(first, last):
            dense[graph.place[k]] = 0.0
    graph.seen_points[node] = graph.counts[POINTS]


@compiled
def refresh(graph: Graph, scratch: Scratch, node: int) -> None:
    """Compare the bounds of a belief with the vectors and points that are new to it."""
    _raise(graph, node)
    _reduce(graph, scratch, node)


@compiled
def add_node(  # noqa: C901 - one pass, no calls
    layout: Layout, graph: Graph, scratch: Scratch, informed: np.ndarray, block: int, begin: int, end: int, total: float
) -> int:
    """Return the node of the belief in a stretch of the scratch entries; make one for a new belief."""
    code = np.int64(block + 1)
    for k in range(begin, end):
        scratch.entry_weight[k] /= total
        part = np.int64(scratch.entry_weight[k] * _GRID + 0.5)
        # 42 bits, so that no product overflows.
        code = ((code * 1000003) ^ (np.int64(scratch.entry_place[k]) * 2654435 + part)) & 0x3FFFFFFFFFF
    code ^= code >> 21
    size = end - begin
    mask = len(graph.table) - 1
    slot = code & mask
    while graph.table[slot] >= 0:
        other = graph.table[slot]
        if graph.code[other] == code and graph.block[other] == block and graph.num_weights[other] == size:
            at = graph.first_weight[other] - begin
            same = True
            for k in range(begin, end):
                if (
                    graph.place[at + k] != scratch.entry_place[k]
                    or abs(graph.weight[at + k] - scratch.entry_weight[k]) * _GRID > 2.0
                ):
                    same = False
                    break
            if same:
                return int(other)
        slot = (slot + 1) & mask
    node = graph.counts[NODES]
    graph.counts[NODES] += 1
    graph.table[slot] = node
    at = graph.counts[WEIGHTS]
    graph.counts[WEIGHTS] += size
    graph.code[node] = code
    graph.block[node] = block
    graph.first_weight[node] = at
    graph.num_weights[node] = size
    graph.first_edge[node] = -1
    graph.bin[node] = -1
    graph.binned[node] = np.nan
    base = layout.first_state[block]
    entropy = 0.0
    for k in range(size):
        graph.place[at + k] = scratch.entry_place[begin + k]
        weight = scratch.entry_weight[begin + k]
        graph.weight[at + k] = weight
        if weight > 0:
            entropy -= weight * math.log(weight)
    upper = -np.inf
    for action in range(graph.informed.shape[1]):
        value = 0.0
        for k in range(at, at + size):
            value += informed[action, base + graph.place[k]] * graph.weight[k]
        graph.informed[node, action] = value
        upper = max(upper, value)
    graph.upper[node] = upper
    graph.entropy[node] = entropy
    graph.lower[node] = -np.inf
    graph.best[node] = -1
    graph.seen_vectors[node] = 0
    graph.seen_points[node] = 0
    return int(node)


@compiled
def _without_least(place: np.ndarray, weight: np.ndarray, begin: int, end: int, least: float) -> tuple[int, float]:
    """Drop entries with weights below a least one; return the new end, and the weight that is dropped."""
    kept = begin
    lost = 0.0
    for k in range(begin, end):
        if weight[k] < least:
            lost += weight[k]
        else:
            place[kept] = place[k]
            weight[kept] = weight[k]
            kept += 1
    return kept, lost


@compiled
def _expand(  # noqa: C901 - one pass, no calls
    layout: Layout, graph: Graph, scratch: Scratch, informed: np.ndarray, node: int, action: int, high: float
) -> None:
    """Find the outcomes of an action at a belief. The rest is taken for the greatest value, ``high``."""
    edge = graph.first_edge[node] + action
    base = layout.first_state[graph.block[node]]
    predicted, touched = scratch.predicted, scratch.touched
    count = 0
    reward = 0.0
    first = graph.first_weight[node]
    for k in range(first, first + graph.num_weights[node]):
        state = base + graph.place[k]
        weight = graph.weight[k]
        reward += weight * layout.rewards[action, state]
        row = layout.transitions.first[action] + state
        for j in range(layout.transitions.starts[row], layout.transitions.starts[row + 1]):
            gain = weight * layout.transitions.values[j]
            if gain == 0.0:  # an underflow: the state would count as new each time it is reached
                continue
            after = layout.transitions.columns[j]
            if predicted[after] == 0.0:
                touched[count] = after
                count += 1
            predicted[after] += gain
    touched[:count].sort()
    tally, offset, found = scratch.tally, scratch.offset, scratch.found
    num_found = 0
    for i in range(count):
        row = layout.observations.first[action] + touched[i]
        for j in range(layout.observations.starts[row], layout.observations.starts[row + 1]):
            symbol = layout.observations.columns[j]
            if tally[symbol] == 0:
                found[num_found] = symbol
                num_found += 1
            tally[symbol] += 1
    end = 0
    for i in range(num_found):
        offset[found[i]] = end
        end += tally[found[i]]
    for i in range(count):
        after = touched[i]
        state = layout.state[after]
        place = state - layout.first_state[layout.block[state]]
        row = layout.observations.first[action] + after
        for j in range(layout.observations.starts[row], layout.observations.starts[row + 1]):
            symbol = layout.observations.columns[j]
            at = offset[symbol]
            scratch.entry_place[at] = place
            scratch.entry_weight[at] = predicted[after] * layout.observations.values[j]
            offset[symbol] = at + 1
        # The block of a symbol is that of any state in which it is observed.
        for j in range(layout.observations.starts[row], layout.observations.starts[row + 1]):
            scratch.choice[layout.observations.columns[j]] = layout.block[state]
        predicted[after] = 0.0
    outcome = graph.counts[OUTCOMES]
    graph.first_outcome[edge] = outcome
    for i in range(num_found):
        symbol = found[i]
        begin = offset[symbol] - tally[symbol]
        total = 0.0
        for k in range(begin, offset[symbol]):
            total += scratch.entry_weight[k]
        if total > 0.0:
            block = int(np.int64(scratch.choice[symbol]))
            least = _NEGLIGIBLE * total
            end, lost = _without_least(scratch.entry_place, scratch.entry_weight, begin, offset[symbol], least)
            total -= lost
            reward += layout.discount * lost * high
            child = add_node(layout, graph, scratch, informed, block, begin, end, total)
            graph.symbol[outcome] = symbol
            graph.chance[outcome] = total
            graph.child[outcome] = child
            outcome += 1
        tally[symbol] = 0
        scratch.choice[symbol] = -1
    graph.reward[edge] = reward
    graph.num_outcomes[edge] = outcome - graph.counts[OUTCOMES]
    graph.counts[OUTCOMES] = outcome


@compiled
def _open(graph: Graph, node: int) -> None:
    """Give a node its edges; their outcomes are found when they are needed."""
    edge = graph.counts[EDGES]
    num_actions = graph.informed.shape[1]
    graph.counts[EDGES] += num_actions
    graph.first_edge[node] = edge
    for action in range(num_actions):
        graph.num_outcomes[edge + action] = -1
        graph.edge_upper[edge + action] = graph.informed[node, action]


@compiled
def _edge_upper(layout: Layout, graph: Graph, scratch: Scratch, edge: int) -> float:
    """Update the upper bound of an action."""
    first = graph.first_outcome[edge]
    value = 0.0
    for k in range(first, first + graph.num_outcomes[edge]):
        child = int(np.int64(graph.child[k]))
        if graph.seen_points[child] < graph.counts[POINTS]:
            _reduce(graph, scratch, child)
        value += graph.chance[k] * graph.upper[child]
    value = min(graph.edge_upper[edge], graph.reward[edge] + layout.discount * value)
    graph.edge_upper[edge] = value
    return float(value)


@compiled
def _edge_lower(layout: Layout, graph: Graph, edge: int) -> float:
    first = graph.first_outcome[edge]
    value = 0.0
    for k in range(first, first + graph.num_outcomes[edge]):
        child = int(np.int64(graph.child[k]))
        if graph.seen_vectors[child] < graph.counts[VECTORS]:
            _raise(graph, child)
        value += graph.chance[k] * graph.lower[child]
    return float(graph.reward[edge] + layout.discount * value)


@compiled
def _best_upper(layout: Layout, graph: Graph, scratch: Scratch, edge: int) -> int:
    """Return the action of the greatest upper bound, found again whenever its update lowers that bound.

    It may be one that is not expanded.
    """
    action = int(np.int64(-1))
    while True:
        best = int(np.int64(0))
        for other in range(1, graph.informed.shape[1]):
            if graph.edge_upper[edge + other] > graph.edge_upper[edge + best]:
                best = other
        if best == action or graph.num_outcomes[edge + best] < 0:
            return best
        action = best
        _edge_upper(layout, graph, scratch, edge + action)


@compiled
def _best_lower(layout: Layout, graph: Graph, edge: int, least: float) -> tuple[int, float]:
    """Return the action of the greatest lower bound and that bound, of the expanded ones that may exceed a value.

    Where there are none the action is -1.
    """
    chosen = int(np.int64(-1))
    best = -np.inf
    for action in range(graph.informed.shape[1]):
        if graph.num_outcomes[edge + action] >= 0 and graph.edge_upper[edge + action] >= max(least, best):
            value = _edge_lower(layout, graph, edge + action)
            if value > best:
                best = value
                chosen = action
    return chosen, best


@compiled
def add_vector(layout: Layout, graph: Graph, block: int, action: int) -> int:
    """Return a new vector of a block, whose values are still to be written."""
    vector = graph.counts[VECTORS]
    at = graph.counts[VALUES]
    graph.counts[VECTORS] += 1
    graph.counts[VALUES] += layout.first_state[block + 1] - layout.first_state[block]
    graph.vector_action[vector] = action
    graph.vector_block[vector] = block
    graph.first_value[vector] = at
    graph.first_link[vector] = graph.counts[LINKS]
    graph.num_links[vector] = 0
    graph.is_active[vector] = 1
    graph.next_vector[vector] = graph.head_vector[block]
    graph.head_vector[block] = vector
    return int(vector)


@compiled
def _back_up_vector(layout: Layout, graph: Graph, scratch: Scratch, node: int, action: int) -> None:
    """Add the vector of an action at a belief, followed by the best vector after each observation."""
    num_arrivals = len(layout.state)
    edge = graph.first_edge[node] + action
    block = int(np.int64(graph.block[node]))
    first = graph.first_outcome[edge]
    last = first + graph.num_outcomes[edge]
    for k in range(first, last):
        scratch.choice[graph.symbol[k]] = graph.best[graph.child[k]]
    scratch.stamp[num_arrivals] += 1
    now = scratch.stamp[num_arrivals]
    base, end = layout.first_state[block], layout.first_state[block + 1]
    vector = add_vector(layout, graph, block, action)
    at = graph.first_value[vector]
    for k in range(first, last):
        graph.link[graph.counts[LINKS]] = graph.best[graph.child[k]]
        graph.counts[LINKS] += 1
    graph.num_links[vector] = last - first
    for state in range(base, end):
        row = layout.transitions.first[action] + state
        total = 0.0
        for j in range(layout.transitions.starts[row], layout.transitions.starts[row + 1]):
            after = layout.transitions.columns[j]
            if scratch.stamp[after] != now:
                scratch.stamp[after] = now
                of = layout.block[layout.state[after]]
                place = layout.state[after] - layout.first_state[of]
                seen = layout.observations.first[action] + after
                value = 0.0
                for i in range(layout.observations.starts[seen], layout.observations.starts[seen + 1]):
                    chosen = scratch.choice[layout.observations.columns[i]]
                    if chosen < 0:
                        chosen = graph.default_vector[of]
                    value += layout.observations.values[i] * graph.values[graph.first_value[chosen] + place]
                scratch.backed[after] = value
            total += layout.transitions.values[j] * scratch.backed[after]
        graph.values[at + state - base] = layout.rewards[action, state] + layout.discount * total
    for k in range(first, last):
        scratch.choice[graph.symbol[k]] = -1


@compiled
def follow(
    layout: Layout,
    actions: np.ndarray,
    blocks: np.ndarray,
    after: np.ndarray,
    defaults: np.ndarray,
    values: np.ndarray,
    scratch: Scratch,
    begin: int,
    end: int,
    result: np.ndarray,
) -> None:
    """Write the worth after some nodes of a controller, discounted: N x Y, of which rows ``begin`` to ``end``.

    ``after`` has the node after each node and observation, -1 for the one of ``defaults`` in the block of what is
    observed; ``values`` has the worth of each of them, N x Y.
    """
    num_arrivals = len(layout.state)
    for node in range(begin, end):
        scratch.stamp[num_arrivals] += 1
        now = scratch.stamp[num_arrivals]
        action = actions[node]
        base, last = layout.first_state[blocks[node]], layout.first_state[blocks[node] + 1]
        for state in range(base, last):
            row = layout.transitions.first[action] + state
            total = 0.0
            for j in range(layout.transitions.starts[row], layout.transitions.starts[row + 1]):
                arrival = layout.transitions.columns[j]
                if scratch.stamp[arrival] != now:
                    scratch.stamp[arrival] = now
                    of = layout.block[layout.state[arrival]]
                    place = layout.state[arrival] - layout.first_state[of]
                    seen = layout.observations.first[action] + arrival
                    value = 0.0
                    for i in range(layout.observations.starts[seen], layout.observations.starts[seen + 1]):
                        chosen = after[node, layout.observations.columns[i]]
                        if chosen < 0:
                            chosen = defaults[of]
                        value += layout.observations.values[i] * values[chosen, place]
                    scratch.backed[arrival] = value
                total += layout.transitions.values[j] * scratch.backed[arrival]
            result[node, state - base] = layout.discount * total


@compiled
def arrive(
    layout: Layout,
    actions: np.ndarray,
    blocks: np.ndarray,
    after: np.ndarray,
    defaults: np.ndarray,
    visits: np.ndarray,
    scratch: Scratch,
    nodes: np.ndarray,
    result: np.ndarray,
) -> None:
    """Add the visits, N x Y, that follow those to some nodes of a controller, discounted; see `follow`."""
    predicted, touched = scratch.predicted, scratch.touched
    for node in nodes:
        action = actions[node]
        base, last = layout.first_state[blocks[node]], layout.first_state[blocks[node] + 1]
        count = 0
        for state in range(base, last):
            weight = visits[node, state - base] * layout.discount
            if weight == 0.0:
                continue
            row = layout.transitions.first[action] + state
            for j in range(layout.transitions.starts[row], layout.transitions.starts[row + 1]):
                gain = weight * layout.transitions.values[j]
                if gain == 0.0:
                    continue
                arrival = layout.transitions.columns[j]
                if predicted[arrival] == 0.0:
                    touched[count] = arrival
                    count += 1
                predicted[arrival] += gain
        for k in range(count):
            arrival = touched[k]
            of = layout.block[layout.state[arrival]]
            place = layout.state[arrival] - layout.first_state[of]
            seen = layout.observations.first[action] + arrival
            for i in range(layout.observations.starts[seen], layout.observations.starts[seen + 1]):
                chosen = after[node, layout.observations.columns[i]]
                if chosen < 0:
                    chosen = defaults[of]
                result[chosen, place] += predicted[arrival] * layout.observations.values[i]
            predicted[arrival] = 0.0


@compiled
def backup(layout: Layout, graph: Graph, scratch: Scratch, node: int, step: float) -> None:
    """Back up both bounds at a belief. An improvement by less than a step adds no vector and no point."""
    edge = graph.first_edge[node]
    refresh(graph, scratch, node)
    chosen = _best_upper(layout, graph, scratch, edge)
    upper = graph.edge_upper[edge + chosen]
    chosen, best = _best_lower(layout, graph, edge, graph.lower[node])
    if upper < graph.upper[node]:
        if upper < graph.upper[node] - step:
            block = graph.block[node]
            point = graph.counts[POINTS]
            graph.counts[POINTS] += 1
            graph.point_node[point] = node
            graph.point_value[point] = upper
            graph.point_drop[point] = _informed(graph, node) - upper
            graph.next_point[point] = graph.head_point[block]
            graph.head_point[block] = point
        graph.upper[node] = upper
    if best > graph.lower[node] + step and chosen >= 0:
        _back_up_vector(layout, graph, scratch, node, chosen)
        _raise(graph, node)


@compiled
def _has_room(graph: Graph, room: np.ndarray) -> bool:
    counts = graph.counts
    return bool(
        counts[NODES] + room[NODES] <= len(graph.block)
        and counts[EDGES] + room[EDGES] <= len(graph.reward)
        and counts[OUTCOMES] + room[OUTCOMES] <= len(graph.child)
        and counts[WEIGHTS] + room[WEIGHTS] <= len(graph.place)
        and counts[VECTORS] + room[VECTORS] <= len(graph.next_vector)
        and counts[VALUES] + room[VALUES] <= len(graph.values)
        and counts[POINTS] + room[POINTS] <= len(graph.next_point)
        and counts[LINKS] + room[LINKS] <= len(graph.link)
        and 2 * (counts[NODES] + room[NODES]) <= len(graph.table)
    )


@compiled
def _predicted(graph: Graph, node: int, low: float, width: float, entropy: float, bins: int) -> float:
    """Return an estimate of a belief's value: the mean of similar beliefs, or its upper bound where there are none."""
    if graph.bin[node] < 0:
        row = min(bins - 1, max(0, int((_informed(graph, node) - low) / width * bins)))
        column = min(bins - 1, max(0, int(graph.entropy[node] / entropy * bins)))
        graph.bin[node] = row * bins + column
    place = graph.bin[node]
    if graph.bin_count[place] == 0:
        return float(graph.upper[node])
    return float(graph.bin_sum[place] / graph.bin_count[place])


@compiled
def _learn(graph: Graph, node: int) -> None:
    """Add a belief's lower bound to the mean of similar beliefs."""
    place = graph.bin[node]
    if math.isnan(graph.binned[node]):
        graph.bin_count[place] += 1
        graph.bin_sum[place] += graph.lower[node]
    else:
        graph.bin_sum[place] += graph.lower[node] - graph.binned[node]
    graph.binned[node] = graph.lower[node]


@compiled
def explore(  # noqa: C901 - one pass, no calls
    layout: Layout,
    graph: Graph,
    scratch: Scratch,
    informed: np.ndarray,
    roots: np.ndarray,
    shares: np.ndarray,
    room: np.ndarray,
    scale: np.ndarray,
    goal: float,
    budget: int,
) -> int:
    """Sample trials and back them up until bounds meet or a budget is used up; return the number of backups.

    Where room is lacking it is ``-1 - backups``. ``scale`` is the least informed value, the width of their range, the
    greatest entropy and the number of bins.
    """
    discount = layout.discount
    bins = int(scale[3])
    deepest = len(scratch.path)
    done = 0
    trial = 0
    while done < budget:
        node = roots[0]
        most = -np.inf
        total = 0.0
        for i in range(len(roots)):
            refresh(graph, scratch, roots[i])
            width = shares[i] * (graph.upper[roots[i]] - graph.lower[roots[i]])
            total += width
            if width > most:
                most = width
                node = roots[i]
        if total <= goal:
            break
        # The gap at which a trial may end: deep ones find good vectors, shallow ones lower the upper bound sooner.
        gap = max(0.5 * goal, (_DEEP if trial % 2 else _SHALLOW) * total)
        trial += 1
        step = max(1e-4 * total, 1e-3 * goal)
        least = graph.lower[node]
        target = least + gap
        depth = 0
        spread = gap
        enough = True
        while depth < deepest:
            enough = _has_room(graph, room)
            if not enough:
                break
            if depth > 0:
                if spread > 10 * scale[1]:  # discounted so far, no gap matters
                    break
                refresh(graph, scratch, node)
                guess = _predicted(graph, node, scale[0], scale[1], scale[2], bins)
                if guess <= least and graph.upper[node] <= max(target, graph.lower[node] + spread):
                    break
                if graph.upper[node] - graph.lower[node] <= gap * 1e-3:
                    break
            if graph.first_edge[node] < 0:
                _open(graph, node)
            edge = graph.first_edge[node]
            action = _best_upper(layout, graph, scratch, edge)
            while graph.num_outcomes[edge + action] < 0:
                enough = _has_room(graph, room)
                if not enough:
                    break
                _expand(layout, graph, scratch, informed, node, action, scale[0] + scale[1])
                action = _best_upper(layout, graph, scratch, edge)
            if not enough:
                break
            scratch.path[depth] = node
            scratch.path_action[depth] = action
            depth += 1
            low = _edge_lower(layout, graph, edge + action)
            low = max(low, _best_lower(layout, graph, edge, low)[1])
            least = max(least, low)
            target = max(target, low + spread)
            spread /= discount
            edge += action
            first = graph.first_outcome[edge]
            most = -np.inf
            pick = -1
            sum_lower = 0.0
            sum_upper = 0.0
            for k in range(first, first + graph.num_outcomes[edge]):
                child = graph.child[k]
                sum_lower += graph.chance[k] * graph.lower[child]
                sum_upper += graph.chance[k] * graph.upper[child]
                excess = graph.chance[k] * (graph.upper[child] - graph.lower[child] - spread)
                if excess > most:
                    most = excess
                    pick = k
            if pick < 0:
                break
            child = graph.child[pick]
            chance = graph.chance[pick]
            least = ((least - graph.reward[edge]) / discount - (sum_lower - chance * graph.lower[child])) / chance
            target = ((target - graph.reward[edge]) / discount - (sum_upper - chance * graph.upper[child])) / chance
            node = child
        for i in range(depth - 1, -1, -1):
            if not _has_room(graph, room):
                enough = False
                break
            node = int(np.int64(scratch.path[i]))
            backup(layout, graph, scratch, node, step)
            _predicted(graph, node, scale[0], scale[1], scale[2], bins)
            _learn(graph, node)
            done += 1
        if not enough:
            return -1 - done
        done += 1
    return done
