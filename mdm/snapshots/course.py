"""How an ensemble's belief, expected reward and expected return went over some time of a record.

It is told by a bounded number of decisions, for a record of hours has millions.
Where there are more, each equal part of the time is told by its last decision. Cost: a bisection for each part, and
whatever it costs to read the belief of each decision that is told.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.snapshots.beliefs import chances_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from mdm.messages import Decision

__all__ = ["POINTS", "Course", "course_of", "sampled"]

POINTS = 300
"""Decisions that are told, at most: more are no wider than a line of the chart."""
_STATES = 5
"""States that have a band of their own."""
_KEPT = 64
"""States that are kept of each belief: one that is none of them is less likely than a 64th."""


class Course(msgspec.Struct, frozen=True):
    """How an ensemble's decisions went over some time.

    Attributes:
        times: When each decision that is told was made, in seconds of the record.
        decisions: How many decisions there were in that time; those that are told stand for all.
        states: The names of the states that were likeliest in the sum, the likeliest first.
        beliefs: For each of these states, its probability at each decision; None where there was no belief.
        rewards: The expected reward of each decision; None where it is not known.
        values: The expected return from each decision on, by the policy's own values; None where it is not known.
    """

    times: tuple[float, ...]
    decisions: int
    states: tuple[str, ...]
    beliefs: tuple[tuple[float | None, ...], ...]
    rewards: tuple[float | None, ...]
    values: tuple[float | None, ...]


def sampled(times: Sequence[int], first: int, last: int, most: int = POINTS) -> tuple[list[int], int]:
    """Return the places of the times that stand for all of some time, and how many there are in it.

    The last one before that time is one of them: it says how the time begins.

    Args:
        times: Of all decisions, in their order.
        first: The beginning of the time.
        last: Its end.
        most: How many places at most.
    """
    begin, end = bisect_left(times, first), bisect_right(times, last)
    before = [begin - 1] if begin else []
    if end - begin + len(before) <= most:
        return [*before, *range(begin, end)], end - begin
    parts = most - len(before)
    ends = [first + (last - first) * (part + 1) // parts for part in range(parts)]
    places = {bisect_right(times, each, begin, end) - 1 for each in ends}  # none of an empty part but that before it
    return [*before, *sorted(places - {begin - 1})], end - begin


def course_of(
    decisions: Iterable[Decision],
    count: int,
    seconds: Callable[[int], float],
    belief: Callable[[Decision], Any],
    value: Callable[[Decision, Any], float | None],
    name: Callable[[int], str],
) -> Course:
    """Return how decisions went.

    Args:
        decisions: Those that are told.
        count: How many there were.
        seconds: Of a time in nanoseconds.
        belief: Reads the belief of a decision, None where there was none.
        value: The expected return from a decision on, made on that belief; None where it is not known.
        name: Of a state.
    """
    times, rewards, values = [], [], []
    kept: list[dict[int, float] | None] = []
    sums: Counter[int] = Counter()
    for decision in decisions:
        current = belief(decision)
        times.append(seconds(decision.time))
        rewards.append(decision.reward)
        values.append(value(decision, current))
        chances = _likeliest(current)
        kept.append(chances)
        sums.update(chances or {})
    states = [state for state, _ in sums.most_common(_STATES)]
    beliefs = [tuple([None if each is None else round(each.get(state, 0.0), 4) for each in kept]) for state in states]
    names = tuple([name(state) for state in states])
    return Course(tuple(times), count, names, tuple(beliefs), tuple(rewards), tuple(values))


def _likeliest(current: Any) -> dict[int, float] | None:
    """Return the likeliest states of a belief with their probabilities; None where it is no belief."""
    found = chances_of(current)
    if found is None:
        return None
    states, chances = found
    if len(chances) > _KEPT:
        most = np.argpartition(-chances, _KEPT)[:_KEPT]
        states, chances = states[most], chances[most]
    return dict(zip(states.tolist(), chances.tolist(), strict=True))
