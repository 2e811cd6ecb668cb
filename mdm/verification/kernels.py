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

_EACH = 8
"""One sweep in so many looks at all choices."""
_NOTHING = 1e-12


@compiled
def attract(
    before: Indices, ways: Indices, state: Indices, opened: Mask, inside: Mask, left: Indices, by: Indices
) -> None:
    """Add to a set the states that it attracts, each over its open choices that lead into it; in O(entries).

    ``before`` has for each state where its ``ways`` begin, the choices that may lead to it; ``left`` how many open
    choices of a state must lead into the set until it is attracted; ``by`` is written: the last of them.
    """
    queue = np.empty(len(inside), dtype=np.int64)
    at = end = 0
    for each in range(len(inside)):
        if inside[each]:
            queue[end] = each
            end += 1
    while at < end:
        for place in range(before[queue[at]], before[queue[at] + 1]):
            choice = ways[place]
            its = state[choice]
            if opened[choice] and not inside[its]:
                opened[choice] = False  # it counts once
                left[its] -= 1
                if left[its] == 0:
                    inside[its], by[its], queue[end] = True, choice, its
                    end += 1
        at += 1


@compiled
def settle(
    starts: Indices,
    columns: Indices,
    chances: Vector,
    constant: Vector,
    firsts: Indices,
    blocks: Indices,
    values: Vector,
    chosen: Indices,
    tolerance: float,
    most: int,
) -> None:
    """Back states up to their best choices in place, until no value of a block changes by more than a tolerance.

    A block is a strongly connected component, and its successors are before it. Sweeps go forward and
    backward in turn, and most of them follow the choices made so far. ``starts``, ``columns`` and ``chances`` are the
    rows, ``firsts`` each state's first choice, ``blocks`` each block's first state. Values and choices are written.
    """
    for block in range(len(blocks) - 1):
        low, high = blocks[block], blocks[block + 1]
        for turn in range(most):
            change = 0.0
            for place in range(low, high):
                each = place if turn % 2 == 0 else low + high - 1 - place
                first = chosen[each] if turn % _EACH else firsts[each]
                last = chosen[each] + 1 if turn % _EACH else firsts[each + 1]
                best, found = 0.0, -1
                for choice in range(first, last):
                    total, rest = constant[choice], 1.0
                    for at in range(starts[choice], starts[choice + 1]):
                        if columns[at] == each:
                            rest -= chances[at]
                        else:
                            total += chances[at] * values[columns[at]]
                    if rest > _NOTHING and (found < 0 or total / rest > best):  # those that never leave do not count
                        best, found = total / rest, choice
                if found >= 0:
                    change = max(change, abs(best - values[each]) / max(1.0, abs(values[each])))
                    values[each], chosen[each] = best, found
            if (turn % _EACH == 0 and change <= tolerance) or high - low == 1:
                break
