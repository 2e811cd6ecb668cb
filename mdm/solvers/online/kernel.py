"""The look-ahead tree of beliefs as arrays, and the functions that grow it, compiled where numba is installed.

A node is a belief: a list of states with weights, with bounds of its value for each action that may come next. The
children of a node by an action lie side by side, one for each possible observation. Where an event may go undetected,
one of them stands for that, and only the same action may follow in it. Uncompiled the
same code gives the same numbers, some 50 times slower.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mdm.compilation import compiled

if TYPE_CHECKING:
    from mdm.solvers.online.tree_search import SearchTables

Whole = npt.NDArray[np.int64]
Real = npt.NDArray[np.float64]


class SearchTree(NamedTuple):
    """The tree; its nodes count from 0, the root.

    Attributes:
        sizes: How many nodes there are, and how many entries of beliefs.
        begins: The first entry of each node's belief, and the end of the last.
        states: The states of all beliefs, one belief after the other.
        weights: Their probabilities.
        parents: For each node the one above, and the action that leads from there.
        chances: The probability of the observation that leads there.
        upper: For each node and action an upper bound of its value.
        lower: For each node and action a lower bound of its value.
        gains: For each node and action its expected reward.
        children: For each node and action its first child and how many there are; 0 where it was not expanded.
        best: For each node the action with the greatest upper bound.
        most: For each node this upper bound.
        least: For each node the greatest lower bound of its actions.
        errors: For each node the widest bounds of a leaf below it, by the leaf's weight in it.
        place: Room for a number for each state; -1 all over between uses.
        tally: Room for a number for each observation and for no detection; 0 all over between uses.
        possible: Room for the observations that are possible.
    """

    sizes: Whole
    begins: Whole
    states: Whole
    weights: Real
    parents: Whole
    chances: Real
    upper: Real
    lower: Real
    gains: Real
    children: Whole
    best: Whole
    most: Real
    least: Real
    errors: Real
    place: Whole
    tally: Whole
    possible: Whole


def search_tree(tables: SearchTables, nodes: int, entries: int) -> SearchTree:
    """Return a tree with room for some nodes and entries of beliefs; memory is used as it fills."""
    size, actions = tables.rewards.shape
    return SearchTree(
        sizes=np.zeros(2, dtype=np.int64),
        begins=np.zeros(nodes + 1, dtype=np.int64),
        states=np.zeros(entries, dtype=np.int64),
        weights=np.zeros(entries),
        parents=np.zeros((nodes, 2), dtype=np.int64),
        chances=np.zeros(nodes),
        upper=np.zeros((nodes, actions)),
        lower=np.zeros((nodes, actions)),
        gains=np.zeros((nodes, actions)),
        children=np.zeros((nodes, actions, 2), dtype=np.int64),
        best=np.zeros(nodes, dtype=np.int64),
        most=np.zeros(nodes),
        least=np.zeros(nodes),
        errors=np.zeros(nodes),
        place=np.full(size, -1),
        tally=np.zeros(tables.num_observations + 1, dtype=np.int64),
        possible=np.zeros(tables.num_observations + 1, dtype=np.int64),
    )


@compiled
def plant(
    tables: SearchTables,
    tree: SearchTree,
    states: Whole,
    weights: Real,
    generator: np.random.Generator,
    particles: int,
) -> None:
    """Begin a tree again, of a root alone: a belief as states and their probabilities."""
    tree.sizes[0] = tree.sizes[1] = 0
    length = len(states)
    tree.states[:length] = states
    tree.weights[:length] = weights
    if length > particles:
        length = _drawn(tree, int(np.int64(0)), length, particles, generator)
    none = int(np.int64(-1))
    _add(tables, tree, length, none, none, 1.0, none)


@compiled
def grow(tables: SearchTables, tree: SearchTree, generator: np.random.Generator, particles: int, count: int) -> int:
    """Expand one leaf after the other by its best action, always that with the greatest part in the root's error.

    Args:
        tables: The model.
        tree: The tree.
        generator: Samples large beliefs.
        particles: The most states of a belief; larger ones are sampled.
        count: How many leaves to expand.

    Returns:
        How many were expanded; less than ``count`` where the best action is certain, or the tree is full.
    """
    for done in range(count):
        if _settled(tree):
            return done
        node = int(np.int64(0))
        while tree.children[node, tree.best[node], 1] > 0:
            child, end = _children(tree, node, tree.best[node])
            node, widest = child, -1.0
            while child < end:
                error = tree.chances[child] * tree.errors[child]
                if error > widest:
                    node, widest = child, error
                child += 1
        if not _expand(tables, tree, node, tree.best[node], generator, particles):
            return done
        _back_up(tables, tree, node, tree.best[node])
    return count


@compiled
def _settled(tree: SearchTree) -> bool:
    """Whether the best action at the root is certain."""
    if tree.errors[0] <= 0.0:
        return True
    first = int(np.argmax(tree.lower[0]))
    for action in range(tree.upper.shape[1]):
        if action != first and tree.upper[0, action] > tree.lower[0, first]:
            return False
    return True


@compiled
def _children(tree: SearchTree, node: int, action: int) -> tuple[int, int]:
    first = tree.children[node, action, 0]
    return first, first + tree.children[node, action, 1]


@compiled
def _back_up(tables: SearchTables, tree: SearchTree, node: int, action: int) -> None:
    """Tighten the bounds from a node to the root."""
    while node >= 0:
        upper = lower = tree.gains[node, action]
        first, end = _children(tree, node, action)
        for child in range(first, end):
            weight = tables.discount * tree.chances[child]
            upper += weight * tree.most[child]
            lower += weight * tree.least[child]
        tree.upper[node, action] = min(tree.upper[node, action], upper)
        tree.lower[node, action] = max(tree.lower[node, action], lower)
        _judge(tables, tree, node)
        node, action = tree.parents[node, 0], tree.parents[node, 1]


@compiled
def _judge(tables: SearchTables, tree: SearchTree, node: int) -> None:
    """Find a node's best action and the error below it."""
    best, most, least = int(np.int64(0)), -np.inf, -np.inf
    for action in range(tree.upper.shape[1]):
        if tree.upper[node, action] > most:
            best, most = action, tree.upper[node, action]
        least = max(least, tree.lower[node, action])
    tree.best[node], tree.most[node], tree.least[node] = best, most, least
    first, end = _children(tree, node, best)
    if first == end:
        tree.errors[node] = most - least
        return
    widest = 0.0
    for child in range(first, end):
        widest = max(widest, tree.chances[child] * tree.errors[child])
    tree.errors[node] = tables.discount * widest


@compiled
def _expand(
    tables: SearchTables, tree: SearchTree, node: int, action: int, generator: np.random.Generator, particles: int
) -> bool:
    """Add a node's children by an action; return whether there was room."""
    observations = tables.observations
    after, mass, rows = _following(tables, tree, node, action)
    count = entries = 0
    for row in rows:
        for place in range(observations.starts[row], observations.starts[row + 1]):
            seen = observations.columns[place]
            if tree.tally[seen] == 0:
                tree.possible[count] = seen
                count += 1
            tree.tally[seen] += 1
            entries += 1
    start = tree.sizes[1]
    fits = start + entries <= len(tree.states) and tree.sizes[0] + count <= len(tree.chances)
    lengths = np.empty(count, dtype=np.int64)
    for index in range(count):
        seen = tree.possible[index]
        lengths[index] = tree.tally[seen]
        tree.tally[seen] = start if fits else 0  # where the next is to go from now on
        start += lengths[index]
    if not fits:
        return False
    for at, row in enumerate(rows):
        for place in range(observations.starts[row], observations.starts[row + 1]):
            seen = observations.columns[place]
            tree.states[tree.tally[seen]] = after[at]
            tree.weights[tree.tally[seen]] = mass[at] * observations.values[place]
            tree.tally[seen] += 1
    start = tree.sizes[1]
    tree.children[node, action, 0] = tree.sizes[0]
    for index in range(count):
        seen = tree.possible[index]
        tree.tally[seen] = 0
        length, chance = _gathered(tree, start, lengths[index], generator, particles)
        start += lengths[index]
        if length > 0:
            # Without a detection the action goes on.
            _add(tables, tree, length, node, action, chance, action if seen == tables.num_observations else -1)
    tree.children[node, action, 1] = tree.sizes[0] - tree.children[node, action, 0]
    return True


@compiled
def _following(tables: SearchTables, tree: SearchTree, node: int, action: int) -> tuple[Whole, Real, Whole]:
    """Return the states that may follow, their weights, and the rows of their observations; note the reward."""
    transitions, observations = tables.transitions, tables.observations
    begin, end = tree.begins[node], tree.begins[node + 1]
    room = 0
    for at in range(begin, end):
        row = transitions.first[action] + tree.states[at]
        room += int(transitions.starts[row + 1] - transitions.starts[row])
    after, mass, rows = np.empty(room, dtype=np.int64), np.empty(room), np.empty(room, dtype=np.int64)
    # Rows of events are those of T's entries, counted from the action's first.
    shift = observations.first[action] - int(transitions.starts[transitions.first[action]])
    length, gain = 0, 0.0
    for at in range(begin, end):
        state, weight = tree.states[at], tree.weights[at]
        gain += weight * tables.rewards[state, action]
        row = transitions.first[action] + state
        for entry in range(transitions.starts[row], transitions.starts[row + 1]):
            following, part = transitions.columns[entry], weight * transitions.values[entry]
            if tables.by_transition:
                after[length], mass[length], rows[length] = following, part, shift + int(entry)
                length += 1
            elif tree.place[following] >= 0:
                mass[tree.place[following]] += part
            else:
                tree.place[following] = length
                after[length], mass[length] = following, part
                rows[length] = observations.first[action] + following
                length += 1
    for at in range(length):
        tree.place[after[at]] = -1
    tree.gains[node, action] = gain
    return after[:length], mass[:length], rows[:length]


@compiled
def _gathered(
    tree: SearchTree, start: int, length: int, generator: np.random.Generator, particles: int
) -> tuple[int, float]:
    """Append a belief to the others, each state once, normalised, and sampled if it is large.

    Returns:
        How many states it has, and the sum of its weights.
    """
    begin = tree.sizes[1]
    end, total = begin, 0.0
    for at in range(start, start + length):
        state, weight = tree.states[at], tree.weights[at]
        total += weight
        if tree.place[state] >= 0:
            tree.weights[tree.place[state]] += weight
        elif weight > 0.0:
            tree.place[state] = end
            tree.states[end], tree.weights[end] = state, weight
            end += 1
    for at in range(begin, end):
        tree.place[tree.states[at]] = -1
        tree.weights[at] /= total
    if end - begin > particles:
        end = begin + _drawn(tree, begin, end - begin, particles, generator)
    return end - begin, total


@compiled
def _drawn(tree: SearchTree, begin: int, length: int, particles: int, generator: np.random.Generator) -> int:
    """Replace a belief by a sample (systematic resampling); return its number of states."""
    number, end, reached, taken = generator.random(), begin, 0.0, 0
    for at in range(begin, begin + length):
        reached += tree.weights[at] * particles
        hits = 0
        while taken < particles and (number + taken < reached or at == begin + length - 1):
            hits += 1
            taken += 1
        if hits > 0:
            tree.states[end], tree.weights[end] = tree.states[at], hits / particles
            end += 1
    return end - begin


@compiled
def _add(
    tables: SearchTables, tree: SearchTree, length: int, parent: int, action: int, chance: float, only: int
) -> None:
    """Add a node for the belief after the last one; only one action may come next, or any (-1)."""
    node, begin = tree.sizes[0], tree.sizes[1]
    tree.sizes[0] += 1
    tree.sizes[1] += length
    tree.begins[node], tree.begins[node + 1] = begin, begin + length
    tree.parents[node, 0], tree.parents[node, 1] = parent, action
    tree.chances[node] = chance
    tree.children[node] = 0
    upper, lower = tree.upper[node], tree.lower[node]
    upper[:] = 0.0
    lower[:] = -np.inf
    plans = np.zeros(len(tables.actions))
    for at in range(begin, begin + length):
        state, weight = tree.states[at], tree.weights[at]
        for other in range(len(upper)):
            upper[other] += weight * tables.upper[state, other]
        for plan in range(len(plans)):
            plans[plan] += weight * tables.lower[state, plan]
    for plan in range(len(plans)):
        lower[tables.actions[plan]] = max(lower[tables.actions[plan]], plans[plan])
    if only >= 0:
        for other in range(len(upper)):
            if other != only:
                upper[other] = lower[other] = -np.inf
    _judge(tables, tree, node)
