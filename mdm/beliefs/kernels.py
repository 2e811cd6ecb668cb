"""The inner loops of belief filters, for numba.

Indices are unsigned: for signed ones numba adds a check for negative indices, which doubles the time of a loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.compilation import compiled

if TYPE_CHECKING:
    from mdm.models.matrices import Vector


@compiled
def move(matrix: Vector, before: Vector, after: Vector) -> float:
    """Write the product of a belief and a matrix; return its sum."""
    size = before.size
    for t in range(size):
        after[t] = 0.0
    s = 0
    while s < size:
        if before[s] == 0.0:
            s += 1
            continue
        # Four rows at a time, so that the result is read and written a quarter as often.
        if s + 4 <= size:
            w0, w1, w2, w3 = before[s], before[s + 1], before[s + 2], before[s + 3]
            r0, r1, r2, r3 = matrix[s], matrix[s + 1], matrix[s + 2], matrix[s + 3]
            for t in range(size):
                after[t] += (w0 * r0[t] + w1 * r1[t]) + (w2 * r2[t] + w3 * r3[t])
            s += 4
        else:
            w0, r0 = before[s], matrix[s]
            for t in range(size):
                after[t] += w0 * r0[t]
            s += 1
    total = 0.0
    for t in range(size):
        total += after[t]
    return total


@compiled
def move_dense(room: Vector, place: int, row: int) -> float:
    """Multiply a belief by a matrix and a likelihood, and normalise it, unless its sum is 0.

    Args:
        room: An array of rows of one width, S or more: the belief, what is not yet normalised, and then likelihoods
            and matrices. What is beyond S is 0.
        place: The first row of the matrix.
        row: The row of the likelihood.

    Returns:
        The sum.
    """
    width = np.uint64(room.shape[1])
    first = np.uint64(place)
    for t in range(width):
        room[1, t] = 0.0
    for s in range(width):
        weight = room[0, s]
        if weight != 0.0:
            # A row at a time: what the processor fetches ahead is worth more than to write the result less often.
            for t in range(width):
                room[1, t] += weight * room[first + s, t]
    return normalise(room, row)


@compiled
def move_sparse(room: Vector, place: int, row: int) -> float:
    """As `move_dense`, with a matrix that has pairs of column and entry, row by row.

    Before these are, for each row and for the end, how far from its begin they are. These and the columns are unsigned
    integers.
    """
    width = np.uint64(room.shape[1])
    flat = room.reshape(room.size)
    whole = flat.view(np.uint64)
    start = np.uint64(place) * width
    one = np.uint64(1)
    for t in range(width):
        room[1, t] = 0.0
    for s in range(width):
        weight = room[0, s]
        if weight != 0.0:
            at, end = start + whole[start + s], start + whole[start + s + one]
            while at < end:
                room[1, whole[at]] += weight * flat[at + one]
                at += np.uint64(2)
    return normalise(room, row)


@compiled
def normalise(room: Vector, row: int) -> float:
    """Multiply the second row by a likelihood; write it, normalised, to the first, unless its sum is 0."""
    width = np.uint64(room.shape[1])
    likelihood = np.uint64(row)
    for t in range(width):
        room[1, t] *= room[likelihood, t]
    # Four sums, of which none waits for another.
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    for t in range(np.uint64(0), width, np.uint64(4)):
        first += room[1, t]
        second += room[1, t + np.uint64(1)]
        third += room[1, t + np.uint64(2)]
        fourth += room[1, t + np.uint64(3)]
    total = (first + second) + (third + fourth)
    if not total > 0.0:
        return 0.0
    for t in range(width):
        room[0, t] = room[1, t] / total
    return total


@compiled
def move_likely(matrix: Vector, likelihood: Vector, before: Vector, after: Vector) -> float:
    """As `move`, with each result multiplied by a likelihood."""
    move(matrix, before, after)
    total = 0.0
    for t in range(after.size):
        after[t] *= likelihood[t]
        total += after[t]
    return total


@compiled
def arrange(starts: Any, columns: Any, data: Vector, cursors: Any, sources: Any, weights: Vector) -> None:
    """Transpose a CSR matrix: write each column's rows and entries from the column's cursor on."""
    for s in range(starts.size - 1):
        for entry in range(starts[s], starts[s + 1]):
            column = columns[entry]
            at = cursors[column]
            sources[at] = s
            weights[at] = data[entry]
            cursors[column] = at + np.uint64(1)


@compiled
def pull(
    first: Any,
    lengths: Any,
    offsets: Any,
    targets: Any,
    sources: Any,
    weights: Vector,
    cuts: Any,
    places: Any,
    likelihood: Vector,
    before: Vector,
    after: Vector,
) -> tuple[float, int]:
    """Multiply a transposed matrix, rows grouped by length, by a belief, and the result by a likelihood.

    All rows of a group have the same length, so the processor predicts the end of every inner loop.

    Args:
        first: The place of the first row of each of G groups; then S.
        lengths: The length of the rows of each group.
        offsets: The start of each group's entries.
        targets: The state of the row at each place.
        sources: The columns of the entries.
        weights: The entries.
        cuts: The start of each group in ``places``; then its length.
        places: The places of rows with non-zero likelihood, ascending.
        likelihood: Their likelihood.
        before: The belief.
        after: The result; its other rows become 0.

    Returns:
        The sum of the result, and the size of its support.
    """
    total = 0.0
    count = 0
    if places.size < after.size:
        for t in range(after.size):
            after[t] = 0.0
    for group in range(lengths.size):
        length = np.uint64(lengths[group])
        origin = np.uint64(first[group])
        whole = cuts[group + 1] - cuts[group] == first[group + 1] - first[group]
        at = np.uint64(offsets[group])
        for chosen in range(np.uint64(cuts[group]), np.uint64(cuts[group + 1])):
            if whole:
                place = origin + (chosen - np.uint64(cuts[group]))
            else:
                place = np.uint64(places[chosen])
                at = np.uint64(offsets[group]) + (place - origin) * length
            value = 0.0
            for entry in range(at, at + length):
                value += weights[entry] * before[sources[entry]]
            at += length
            value *= likelihood[chosen]
            after[targets[place]] = value
            total += value
            count += value != 0.0
    return total, count


@compiled
def push(
    starts: Any,
    columns: Any,
    data: Vector,
    rows: Any,
    symbols: Any,
    chances: Vector,
    observation: int,
    states: Any,
    values: Vector,
    count: int,
    sums: Vector,
    next_states: Any,
    next_values: Vector,
) -> tuple[float, int]:
    """Multiply a belief, given by its support, by a CSR matrix and a likelihood.

    Args:
        starts: The row starts of the matrix.
        columns: The columns of its entries.
        data: Its entries.
        rows: The row starts of P(o | s'), S' x O in CSR.
        symbols: The columns of its entries, ascending in each row.
        chances: Its entries.
        observation: The observation; negative for no likelihood.
        states: The states of the belief.
        values: Their weights.
        count: Their number.
        sums: S zeros, which are zeros again on return.
        next_states: The states of the result.
        next_values: Their weights.

    Returns:
        The sum of the result, and the size of its support.
    """
    reached = 0
    for index in range(count):
        state = np.uint64(states[index])
        weight = values[index]
        for entry in range(starts[state], starts[state + np.uint64(1)]):
            target = columns[entry]
            if sums[target] == 0.0:
                next_states[reached] = target
                reached += 1
            sums[target] += weight * data[entry]
            if sums[target] == 0.0:  # underflow: the state must not be listed twice
                reached -= 1
    total = 0.0
    kept = 0
    for index in range(reached):
        target = np.uint64(next_states[index])
        value = sums[target]
        sums[target] = 0.0
        if observation >= 0:
            symbol = np.uint32(observation)
            low, end = rows[target], rows[target + np.uint64(1)]
            high = end
            while low < high:
                middle = (low + high) >> np.uint64(1)
                if symbols[middle] < symbol:
                    low = middle + np.uint64(1)
                else:
                    high = middle
            value = value * chances[low] if low < end and symbols[low] == symbol else 0.0
        if value != 0.0:
            next_states[kept] = next_states[index]
            next_values[kept] = value
            total += value
            kept += 1
    return total, kept
