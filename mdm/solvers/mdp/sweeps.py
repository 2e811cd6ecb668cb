"""Sweeps over the states, compiled: each visits the states in order and reads each row of T once.

Values change in place, so that a state's backup uses the newest values of those before it (Gauss-Seidel). Forward and
backward sweeps take turns, so that values spread along any chain of states. The part of V(s) that an action leaves in s
is solved for: V(s) = (R + discount * sum over s' other than s) / (1 - discount P(s | s, a)). ``rewards`` is S x A.
A sweep of the fast informed bound reads the observations as well; see `mdm.solvers.bounds`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.compilation import compiled

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.dynamics import Rows
    from mdm.models.matrices import Vector

    Indices = npt.NDArray[np.integer]


@compiled
def backup(
    transitions: Rows,
    rewards: Vector,
    discount: float,
    values: Vector,
    backed: Vector,
    policy: Indices,
) -> None:
    """Write each state's value after a backup, and its best action; all from the old values."""
    size, count = rewards.shape
    for state in range(size):
        best, chosen = 0.0, -1
        for action in range(count):
            row = transitions.first[action] + state
            total = 0.0
            for at in range(transitions.starts[row], transitions.starts[row + 1]):
                total += transitions.values[at] * values[transitions.columns[at]]
            value = rewards[state, action] + discount * total
            if chosen < 0 or value > best:
                best, chosen = value, action
        backed[state] = best
        policy[state] = chosen


@compiled
def sweep(
    transitions: Rows,
    rewards: Vector,
    discount: float,
    values: Vector,
    policy: Indices,
    most: int,
    each: int,
    tolerance: float,
) -> None:
    """Back states up, in place; see `mdm.solvers.mdp.value_iteration.sweep`.

    The rows of the best actions are copied: the sweeps that follow them read a matrix that is A times smaller.
    """
    size, count = rewards.shape
    firsts = np.zeros(size + 1, dtype=np.uintp)  # room for the longest row of each state
    for state in range(size):
        longest = np.uintp(0)
        for action in range(count):
            row = transitions.first[action] + state
            longest = max(longest, np.uintp(transitions.starts[row + 1] - transitions.starts[row]))
        firsts[state + 1] = firsts[state] + longest
    ends = firsts[:-1].copy()
    weights, after = np.empty(firsts[size]), np.empty(firsts[size], dtype=np.uint32)
    earned = np.empty(size)
    for turn in range(most):
        if turn % each:
            _follow(weights, after, firsts, ends, earned, values, turn)
            continue
        change = _choose(transitions, rewards, discount, values, policy, turn)
        if not change > tolerance:
            break
        if each > 1:
            _copy(transitions, rewards, discount, policy, weights, after, firsts, ends, earned)


@compiled
def _choose(
    transitions: Rows,
    rewards: Vector,
    discount: float,
    values: Vector,
    policy: Indices,
    turn: int,
) -> float:
    """Back each state up with its best action; return the greatest change."""
    size, count = rewards.shape
    change = 0.0
    for place in range(size):
        state = place if turn % 2 else size - 1 - place
        best, chosen = 0.0, -1
        for action in range(count):
            row = transitions.first[action] + state
            total, rest = 0.0, 1.0
            for at in range(transitions.starts[row], transitions.starts[row + 1]):
                weight = discount * transitions.values[at]
                if transitions.columns[at] == state:
                    rest -= weight
                else:
                    total += weight * values[transitions.columns[at]]
            value = rewards[state, action] + total
            if rest != 1.0:
                value /= rest
            if chosen < 0 or value > best:
                best, chosen = value, action
        change = max(change, abs(best - values[state]))
        values[state] = best
        policy[state] = chosen
    return change


@compiled
def _copy(
    transitions: Rows,
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
    for state in range(len(rewards)):
        row = transitions.first[policy[state]] + state
        rest = 1.0
        for at in range(transitions.starts[row], transitions.starts[row + 1]):
            if transitions.columns[at] == state:
                rest -= discount * transitions.values[at]
        earned[state] = rewards[state, policy[state]] / rest
        end = firsts[state]
        for at in range(transitions.starts[row], transitions.starts[row + 1]):
            if transitions.columns[at] != state:
                weights[end] = discount * transitions.values[at] / rest
                after[end] = transitions.columns[at]
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
        value = earned[state]
        for at in range(firsts[state], ends[state]):
            value += weights[at] * values[after[at]]
        values[state] = value


@compiled
def prioritised_sweeps(
    transitions: Rows,
    rewards: Vector,
    discount: float,
    values: Vector,
    priorities: Vector,
    before: Rows,
    threshold: float,
    floor: float,
    most: int,
) -> None:
    """Back up the states whose priority is above a threshold, in place, and halve it whenever there are none.

    Args:
        transitions: T.
        rewards: See above.
        discount: See above.
        values: The values of the states.
        priorities: The error that each state's value may have.
        before: The predecessors of each state, with the probabilities of the transitions.
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
                row = transitions.first[action] + state
                total = 0.0
                for at in range(transitions.starts[row], transitions.starts[row + 1]):
                    total += transitions.values[at] * values[transitions.columns[at]]
                value = rewards[state, action] + discount * total
                if chosen < 0 or value > best:
                    best, chosen = value, action
            change = abs(best - values[state])
            values[state] = best
            priorities[state] = 0.0
            for at in range(before.starts[state], before.starts[state + 1]):
                raised = discount * before.values[at] * change
                priorities[before.columns[at]] = max(priorities[before.columns[at]], raised)
        if not found:
            threshold /= 2


# -- The fast informed bound -------------------------------------------------------------------------------------------


class Scratch(NamedTuple):
    """Room for one state and action; the possible observations stand first in ``found``, with its sums.

    Attributes:
        place: The place of each observation in ``found``; -1 all over between uses.
        found: Observations.
        sums: For each of these and each next action the sum over s' of P(s', o | s, a) alpha(s').
    """

    place: npt.NDArray[np.int64]
    found: npt.NDArray[np.int64]
    sums: npt.NDArray[np.float64]


def scratch(num_observations: int, num_actions: int) -> Scratch:
    """Return room for a model of these sizes, where something may be left to no observation."""
    count = num_observations + 1
    return Scratch(np.full(count, -1), np.zeros(count, dtype=np.int64), np.zeros((count, num_actions)))


@compiled
def informed_sweep(
    transitions: Rows,
    observations: Rows,
    by_transition: bool,
    rewards: Vector,
    discount: float,
    table: Vector,
    room: Scratch,
) -> float:
    """Lower upper bounds, S x A, in place, each by the newest of the others; return by how much at most."""
    size, num_actions = table.shape
    greatest = 0.0
    for action in range(num_actions):
        first = transitions.first[action]
        shift = observations.first[action] - np.int64(transitions.starts[first])
        for state in range(size):
            count = 0
            for entry in range(transitions.starts[first + state], transitions.starts[first + state + 1]):
                after, chance = transitions.columns[entry], transitions.values[entry]
                seen = shift + np.int64(entry) if by_transition else observations.first[action] + np.int64(after)
                for at in range(observations.starts[seen], observations.starts[seen + 1]):
                    observation = observations.columns[at]
                    place = room.place[observation]
                    if place < 0:
                        place = count
                        room.place[observation], room.found[place] = place, observation
                        room.sums[place] = 0.0
                        count += 1
                    weight = chance * observations.values[at]
                    for other in range(num_actions):
                        room.sums[place, other] += weight * table[after, other]
            total = 0.0
            for place in range(count):
                total += room.sums[place].max()
                room.place[room.found[place]] = -1
            value = rewards[state, action] + discount * total
            if value < table[state, action]:
                greatest = max(greatest, table[state, action] - value)
                table[state, action] = value
    return greatest
