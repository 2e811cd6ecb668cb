"""Sweeps over the states, compiled: each visits the states in order and reads each row of the stacked matrix once.

The arguments ``data, indices, starts`` are the stacked CSR matrix (row s A + a), whose indices are unsigned, because
numba then need not look for negative ones, a third of the time; ``rewards`` is S x A. Values change in
place, so that a state's backup uses the newest values of those before it (Gauss-Seidel); forward and backward sweeps
take turns, so that values spread along any chain of states. What an action leaves in its own state is solved for:
V(s) = (R + discount * sum over s' other than s) / (1 - discount P(s | s, a)).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.models.compilation import compiled

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.integer]

__all__ = ["backup", "prioritised_sweeps", "sweep"]


@compiled
def backup(
    data: Vector,
    indices: Indices,
    starts: Indices,
    rewards: Vector,
    discount: float,
    values: Vector,
    backed: Vector,
    policy: Indices,
) -> None:
    """Write what the best action makes of each state's value, and that action; all from the old values."""
    size, count = rewards.shape
    for state in range(size):
        best, chosen = 0.0, -1
        for action in range(count):
            row = state * count + action
            total = 0.0
            for at in range(starts[row], starts[row + 1]):
                total += data[at] * values[indices[at]]
            worth = rewards[state, action] + discount * total
            if chosen < 0 or worth > best:
                best, chosen = worth, action
        backed[state] = best
        policy[state] = chosen


@compiled
def sweep(
    data: Vector,
    indices: Indices,
    starts: Indices,
    rewards: Vector,
    discount: float,
    values: Vector,
    policy: Indices,
    most: int,
    each: int,
    tolerance: float,
) -> None:
    """Back states up, in place; see `mdm.solvers.mdp.stack.Stack.sweep`.

    What a sweep for the best actions finds is copied: those after it read a matrix of their own, A times smaller.
    """
    size, count = rewards.shape
    firsts = np.zeros(size + 1, dtype=np.uintp)  # room for the longest row of each state
    for state in range(size):
        longest = np.uintp(0)
        for row in range(state * count, (state + 1) * count):
            longest = max(longest, np.uintp(starts[row + 1] - starts[row]))
        firsts[state + 1] = firsts[state] + longest
    ends = firsts[:-1].copy()
    weights, after = np.empty(firsts[size]), np.empty(firsts[size], dtype=indices.dtype)
    earned = np.empty(size)
    for turn in range(most):
        if turn % each:
            _follow(weights, after, firsts, ends, earned, values, turn)
            continue
        change = _choose(data, indices, starts, rewards, discount, values, policy, turn)
        if not change > tolerance:
            break
        if each > 1:
            _copy(data, indices, starts, rewards, discount, policy, weights, after, firsts, ends, earned)


@compiled
def _choose(
    data: Vector,
    indices: Indices,
    starts: Indices,
    rewards: Vector,
    discount: float,
    values: Vector,
    policy: Indices,
    turn: int,
) -> float:
    """Back each state up with its best action, and return by how much the values changed, at most."""
    size, count = rewards.shape
    change = 0.0
    for place in range(size):
        state = place if turn % 2 else size - 1 - place
        best, chosen = 0.0, -1
        for action in range(count):
            row = state * count + action
            total, rest = 0.0, 1.0
            for at in range(starts[row], starts[row + 1]):
                weight = discount * data[at]
                if indices[at] == state:
                    rest -= weight
                else:
                    total += weight * values[indices[at]]
            worth = rewards[state, action] + total
            if rest != 1.0:
                worth /= rest
            if chosen < 0 or worth > best:
                best, chosen = worth, action
        change = max(change, abs(best - values[state]))
        values[state] = best
        policy[state] = chosen
    return change


@compiled
def _copy(
    data: Vector,
    indices: Indices,
    starts: Indices,
    rewards: Vector,
    discount: float,
    policy: Indices,
    weights: Vector,
    after: Indices,
    firsts: Indices,
    ends: Indices,
    earned: Vector,
) -> None:
    """Copy the rows of a policy, solved for the state itself: V(s) = earned + sum of weights * V(after)."""
    size, count = rewards.shape
    for state in range(size):
        row = state * count + policy[state]
        rest = 1.0
        for at in range(starts[row], starts[row + 1]):
            if indices[at] == state:
                rest -= discount * data[at]
        earned[state] = rewards[state, policy[state]] / rest
        end = firsts[state]
        for at in range(starts[row], starts[row + 1]):
            if indices[at] != state:
                weights[end] = discount * data[at] / rest
                after[end] = indices[at]
                end += np.uintp(1)
        ends[state] = end


@compiled
def _follow(
    weights: Vector, after: Indices, firsts: Indices, ends: Indices, earned: Vector, values: Vector, turn: int
) -> None:
    """Back each state up with its policy's action."""
    size = len(values)
    for place in range(size):
        state = place if turn % 2 else size - 1 - place
        worth = earned[state]
        for at in range(firsts[state], ends[state]):
            worth += weights[at] * values[after[at]]
        values[state] = worth


@compiled
def prioritised_sweeps(
    data: Vector,
    indices: Indices,
    starts: Indices,
    rewards: Vector,
    discount: float,
    values: Vector,
    priorities: Vector,
    chances: Vector,
    before: Indices,
    firsts: Indices,
    threshold: float,
    floor: float,
    most: int,
) -> None:
    """Back up the states whose priority is above a threshold, in place, and halve it whenever there are none.

    Args:
        data: See above.
        indices: See above.
        starts: See above.
        rewards: See above.
        discount: See above.
        values: What the states are worth.
        priorities: By how much each state's value may be wrong.
        chances: With ``before, firsts`` a CSR matrix: row s' holds the states before it, with the greatest chance.
        before: See there.
        firsts: See there.
        threshold: The first threshold.
        floor: Stop when the threshold falls to it.
        most: The most backups.
    """
    size, count = rewards.shape
    done = 0
    while threshold > floor and done < most:
        found = False
        for state in range(size):
            if priorities[state] <= threshold:
                continue
            found = True
            done += 1
            best, chosen = 0.0, -1
            for action in range(count):
                row = state * count + action
                total = 0.0
                for at in range(starts[row], starts[row + 1]):
                    total += data[at] * values[indices[at]]
                worth = rewards[state, action] + discount * total
                if chosen < 0 or worth > best:
                    best, chosen = worth, action
            change = abs(best - values[state])
            values[state] = best
            priorities[state] = 0.0
            for at in range(firsts[state], firsts[state + 1]):
                raised = discount * chances[at] * change
                priorities[before[at]] = max(priorities[before[at]], raised)
        if not found:
            threshold /= 2
