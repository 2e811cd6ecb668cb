"""The traffic of a team that was replayed: the messages that each agent sent, by number, and which each received.

Where the agents are replayed once more with another configuration, the message of a number stands in place of the one
that had it, as long as it is sent under the same key at the same time: see `mdm.replay.otherwise`. Once an agent sends
otherwise, nothing says when its teammates would receive that, and what they would send then. `Traffic.limits` tells up
to when each of them cannot have received any of it.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

from mdm.stimuli import Received

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mdm.stimuli import Stimulus

__all__ = ["Life", "Limit", "Sent", "Side", "Traffic", "life_of"]

Life = tuple[str, int]
"""An agent, and the number of its life."""


class Sent(NamedTuple):
    """A message that was sent.

    Attributes:
        time: When, by the clock of the sender's record.
        key: Under which key.
        body: Its content.
        answer: Whether it is the answer to a request.
    """

    time: int
    key: str
    body: bytes
    answer: bool = False


class Side(NamedTuple):
    """One record of several that are replayed together.

    Attributes:
        stimuli: Those of the record.
        lives: The agents in it.
        until: When its run began to end.
    """

    stimuli: Sequence[Stimulus]
    lives: tuple[Life, ...]
    until: int


class Limit(NamedTuple):
    """From when on nothing can be told of a replay.

    Attributes:
        time: By the clock of the record, in nanoseconds.
        reason: Why, in words: what an agent would not have sent so, behind which the others may have received it.
    """

    time: int
    reason: str


class Traffic:
    """The messages of a replay in which everything came as it was recorded.

    Args:
        sides: The records by their names.
        sent: What each agent sent until its run began to end, in its order.
    """

    def __init__(self, sides: Mapping[str, Side], sent: Mapping[Life, Sequence[Sent]]) -> None:
        self.sides, self.sent = sides, sent
        self.side_of = {life: name for name, side in sides.items() for life in side.lives}
        self._places: dict[Life, dict[tuple[str, bytes], list[int]]] = {}
        for life, messages in sent.items():
            places = self._places[life] = defaultdict(list)
            for number, message in enumerate(messages):
                if not message.answer:
                    places[message.key, message.body].append(number)

    def number(self, received: Received) -> int | None:
        """Return which of its sender's messages was received; None where the replay has not sent it.

        Of several that are the same it is the last that was sent by then.
        """
        life = life_of(received)
        places = self._places.get(life, {}).get((received.key, bytes(received.body)))
        if not places:
            return None
        sent = self.sent[life]
        return places[max(bisect_right(places, received.sent, key=lambda place: sent[place].time) - 1, 0)]

    def limits(self, known: Mapping[str, Limit]) -> dict[str, Limit]:
        """Return from when on nothing can be told of each record, where that is so.

        Of an agent whose messages are not known from some time on, another one received the last that is known; the
        next one, which is not known, may have come at any time behind it, for messages keep their order.

        Args:
            known: From when on an agent sends otherwise, or receives messages that are not known, by the record.
        """
        heard = {name: self._heard(side) for name, side in self.sides.items()}
        limits: dict[str, Limit] = {}
        for name, limit in known.items():
            for other, each in self._following(name, limit, heard).items():
                if other not in limits or each.time < limits[other].time:
                    limits[other] = each
        return limits

    def _following(
        self, first: str, limit: Limit, heard: Mapping[str, Mapping[Life, list[tuple[int, int]]]]
    ) -> dict[str, Limit]:
        """Return the limits of all records that follow from one; before that, nothing comes back to its own agents."""
        limits = {first: limit}
        changed = True
        while changed:
            changed = False
            for name, side in self.sides.items():
                for life, received in heard[name].items():
                    other = self.side_of[life]
                    if name in {first, other} or other not in limits:
                        continue
                    sent = bisect_left(self.sent[life], limits[other].time, key=lambda message: message.time)
                    last = None
                    for place, number in received:
                        if number >= sent:
                            break
                        last = place
                    time = side.stimuli[0].time if last is None else _behind(side.stimuli, last)
                    if name not in limits or time < limits[name].time:
                        limits[name] = Limit(time, limit.reason)
                        changed = True
        return limits

    def _heard(self, side: Side) -> dict[Life, list[tuple[int, int]]]:
        """Return by sender the places of received messages among the stimuli, with their numbers."""
        found: dict[Life, list[tuple[int, int]]] = defaultdict(list)
        for place, stimulus in enumerate(side.stimuli):
            if isinstance(stimulus, Received) and life_of(stimulus) in self.side_of:
                number = self.number(stimulus)
                if number is not None:
                    found[life_of(stimulus)].append((place, number))
        return found


def life_of(received: Received) -> Life:
    """Return whose message it is."""
    return received.owner, received.incarnation


def _behind(stimuli: Sequence[Stimulus], place: int) -> int:
    """Return the time behind a stimulus; its own where the next one has that, too."""
    time = stimuli[place].time
    return time if place + 1 < len(stimuli) and stimuli[place + 1].time == time else time + 1
