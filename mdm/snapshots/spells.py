"""Spells: from when to when something looked odd in a record, by the rules by which a running system is judged.

Each rule can change its mind at few times alone: at a decision, at the end of an action, at an observation, and where
its own threshold is passed. So nothing is sampled, and the cost is of the order of the events of the record.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from mdm.snapshots.oddities import KEPT, MOVED, OFTEN, SEEN, SHORT, WINDOW, Seen, lasting, lasts_long, repeated, unmoved

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    from mdm.snapshots.tracks import EnsembleTracks

__all__ = ["Spell", "joined", "spells"]

_WINDOW = round(WINDOW * 1e9)
_SHORT = round(SHORT * 1e9)


class Spell(NamedTuple):
    """A time over which something looked odd.

    Attributes:
        begin: In nanoseconds of the record's clock.
        end: Behind it, it looked odd no more.
        rule: ``repeated``, ``lasting`` or ``unmoved``.
        of: The action that it is of; empty for a belief.
        text: What looked odd when it began, in words.
    """

    begin: int
    end: int
    rule: str
    of: str
    text: str


def spells(
    tracks: EnsembleTracks,
    end: int,
    composed: Collection[str],
    observation: Callable[[object], str],
    state: Callable[[int], str],
) -> list[Spell]:
    """Return when something looked odd of an ensemble while it decided, each rule's spells apart, by their beginning.

    Args:
        tracks: What happened to it.
        end: The record's last time.
        composed: Actions that are ensembles, which last as long as they are chosen.
        observation: Names an observation.
        state: Names a state.
    """
    found = [
        *_repeated(tracks, end),
        *_lasting(tracks, end, composed),
        *_unmoved(tracks, end, observation, state),
    ]
    modes = zip(tracks.modes.times, tracks.modes.entries, strict=True)
    deciding = [
        (since, until)
        for (since, mode), (until, _) in pairwise([*modes, (end + 1, None)])
        if mode.mode == "deciding" and since < until
    ]
    cut = [
        spell._replace(begin=max(spell.begin, since), end=min(spell.end, until))
        for spell in found
        for since, until in _meeting(deciding, spell)
    ]
    return sorted(joined(cut, 0))


def _meeting(times: Sequence[tuple[int, int]], spell: Spell) -> Sequence[tuple[int, int]]:
    """Return those of times, one behind the other, that a spell meets."""
    first = bisect_right(times, spell.begin, key=lambda each: each[1])
    return times[first : bisect_left(times, spell.end, key=lambda each: each[0])]


def joined(found: Sequence[Spell], gap: int) -> list[Spell]:
    """Return spells with those of one rule as one where no more than a gap in nanoseconds lies between."""
    last: dict[tuple[str, str], Spell] = {}
    done = []
    for spell in sorted(found):
        key = spell.rule, spell.of
        before = last.get(key)
        if before is not None and spell.begin - before.end <= gap:
            last[key] = before._replace(end=max(before.end, spell.end))
            continue
        if before is not None:
            done.append(before)
        last[key] = spell
    return sorted([*done, *last.values()])


def _repeated(tracks: EnsembleTracks, end: int) -> Iterator[Spell]:
    times: defaultdict[str, list[int]] = defaultdict(list)
    for time, action in zip(tracks.repeats.times, tracks.repeats.entries, strict=True):
        times[action].append(time)
    if all(len(each) < OFTEN for each in times.values()):
        return
    decided = zip(tracks.decisions.times, tracks.decisions.entries, strict=True)
    for (time, decision), (until, _) in pairwise([*decided, (end + 1, None)]):
        of = times.get(decision.action_name, [])
        last = bisect_right(of, time)
        count = last - bisect_right(of, time - _WINDOW)
        if count >= OFTEN and time < until:
            over = min(until, of[last - OFTEN] + _WINDOW)
            yield Spell(time, over, "repeated", decision.action_name, repeated(decision.action_name, count))


def _lasting(tracks: EnsembleTracks, end: int, composed: Collection[str]) -> Iterator[Spell]:
    ends = tracks.ends
    for action, begun, until in tracks.lived(end + 1):
        if action in composed or until - begun < _SHORT:
            continue
        others = sorted({begun, *ends.times[bisect_right(ends.times, begun) : bisect_left(ends.times, until)], until})
        for since, later in pairwise(others):  # what is usual changes where another action ends
            ended = ends.entries[ends.last(since, KEPT)]
            odd = max(since, begun + lasts_long(action, ended))
            if odd < later:
                odd = round(odd)
                yield Spell(odd, later, "lasting", action, lasting(action, (odd - begun) / 1e9, ended))


def _unmoved(
    tracks: EnsembleTracks, end: int, observation: Callable[[object], str], state: Callable[[int], str]
) -> Iterator[Spell]:
    seen = [Seen(time / 1e9, *entry) for time, entry in zip(tracks.seen.times, tracks.seen.entries, strict=True)]
    still = 0  # how many of the last ones may have stood still, which is told cheaply
    for place, (time, until) in enumerate(pairwise([*tracks.seen.times, end + 1])):
        last, before = seen[place], seen[place - 1]
        moved = place > 0 and (last.state != before.state or abs(last.chance - before.chance) >= MOVED)
        still = 1 if moved else still + 1
        if still < min(place + 1, SEEN) or time == until:
            continue
        text = unmoved(seen[max(0, place + 1 - SEEN) : place + 1], observation, state)
        if text:
            yield Spell(time, min(until, time + _WINDOW), "unmoved", "", text)
