"""Loops over the choices of a decision process, compiled.

Choices are the rows of a CSR matrix, those of a state beside each other; ``state`` has the state of each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.compilation import compiled

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.integer]
    Mask = npt.NDArray[np.bool_]
    Reverse = tuple[Indices, Indices]
    Rows = tuple[Indices, Indices, Vector]

_EACH = 8
"""One sweep in so many looks at all choices."""
_NOTHING = 1e-12


@compiled
def attract(
    reverse: Reverse, state: Indices, opened: Mask, inside: Mask, touched: Mask, left: Indices, by: Indices
) -> None:
    """Add to a set the states that it attracts, each over its open choices that lead into it; in O(entries).

    ``touched`` has the open choices that are known to lead into it, ``left`` how many more of a state must until it is
    attracted; ``by`` is written: the last such choice. ``reverse`` has for each state where the choices that may lead
    to it begin, and these choices.
    """
    before, ways = reverse
    queue = np.empty(len(inside), dtype=np.int64)
    end = 0
    for each in range(len(inside)):
        if inside[each]:
            queue[end] = each
            end += 1
    for choice in range(len(state)):
        if touched[choice]:
            end = int(np.int64(_counted(choice, state, inside, left, by, queue, end)))
    at = 0
    while at < end:
        for place in range(before[queue[at]], before[queue[at] + 1]):
            choice = ways[place]
            if opened[choice] and not touched[choice]:
                touched[choice] = True
                end = int(np.int64(_counted(choice, state, inside, left, by, queue, end)))
        at += 1


@compiled
def _counted(choice: int, state: Indices, inside: Mask, left: Indices, by: Indices, queue: Indices, end: int) -> int:
    """Count a choice that leads into the set, and add its state if none is left; return the queue's end."""
    its = state[choice]
    if inside[its]:
        return end
    left[its] -= 1
    if left[its] != 0:
        return end
    inside[its] = True
    by[its] = choice
    queue[end] = its
    return end + 1


@compiled
def settle(
    rows: Rows,
    firsts: Indices,
    blocks: Indices,
    constant: Vector,
    sign: float,
    values: Vector,
    chosen: Indices,
    tolerance: float,
    most: int,
) -> None:
    """Back states up in place, block by block, until no value of a block changes by more than a tolerance.

    A block is a strongly connected component; its successors come before it. Sweeps go forward and backward in turn,
    and most of them follow the choices made so far. ``rows`` are the choices: where the entries of each begin, their
    states, their probabilities; ``firsts`` has each state's first choice, ``blocks`` each block's first state. The
    sign is 1 for the greatest values, -1 for the least. Values and choices are written.
    """
    for block in range(len(blocks) - 1):
        low, high = blocks[block], blocks[block + 1]
        for turn in range(most):
            change = 0.0
            for place in range(high - low):
                each = low + place if turn % 2 == 0 else high - 1 - place
                first, last = firsts[each], firsts[each + 1]
                if turn % _EACH:
                    first, last = chosen[each], chosen[each] + 1
                old = values[each]
                _best(rows, constant, sign, values, chosen, each, first, last)
                change = max(change, abs(values[each] - old) / max(1.0, abs(old)))
            if (turn % _EACH == 0 and change <= tolerance) or high - low == 1:
                break


@compiled
def _best(
    rows: Rows, constant: Vector, sign: float, values: Vector, chosen: Indices, each: int, first: int, last: int
) -> None:
    """Back up a state by the best of some choices; those that never leave it do not count."""
    starts, columns, chances = rows
    best, found = 0.0, -1
    for choice in range(first, last):
        total, rest = constant[choice], 1.0
        for at in range(starts[choice], starts[choice + 1]):
            if columns[at] == each:
                rest -= chances[at]
            else:
                total += chances[at] * values[columns[at]]
        if rest > _NOTHING and (found < 0 or sign * total / rest > sign * best):
            best, found = total / rest, choice
    if found >= 0:
        values[each] = best
        chosen[each] = found
