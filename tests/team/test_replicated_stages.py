"""The stages of a replica: all orders of what may happen to one, visited breadth first beside the flags they stand for.

Each stage is the name of one combination of two flags: whether the end of the turn is due, and whether the
acknowledgement of the last step is.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from mdm.runtime.observing import Choices
from mdm.team.agreement import Send, Term
from mdm.team.agreement.messages import Applied, Commit, Component
from mdm.team.replicated import ReplicatedLayer, Stage

FLAGS = {
    Stage.IDLE: (False, False),
    Stage.ENDING: (True, False),
    Stage.ACKNOWLEDGING: (False, True),
    Stage.OVERLAPPING: (True, True),
}
TERM = Term(1, "a", 1)
SENDS = {
    "nothing": [],
    "an acknowledgement": [Send("a", Applied(TERM, 1))],
    "a proposal": [Send("a", Component(TERM, 2, b""))],
    "a commit": [Send(None, Commit(TERM, 2, TERM, {}, (), None, "", ""))],
}
EVENTS = [*SENDS, "a turn", "a round of the loop", "the turn behind", "a stop"]


class Flags:
    """A replica as two flags."""

    def __init__(self):
        self.turn_ends = self.acknowledges = False
        self.acknowledgement = False

    def process(self):
        begins, self.turn_ends = not self.turn_ends, True
        return begins

    def send(self, sends):
        for send in sends:
            if isinstance(send.message, Applied | Component):
                self.acknowledgement = isinstance(send.message, Applied)

    def end_turn(self, again):
        if not self.turn_ends:
            return False
        self.turn_ends = False
        if again:
            self.process()
        due = self.acknowledgement and not self.acknowledges
        self.acknowledges = self.acknowledges or due
        return due

    def acknowledge(self):
        self.acknowledges = self.acknowledgement = False

    def stop(self):
        self.turn_ends = self.acknowledges = self.acknowledgement = False


class Dispatcher:
    """Turns that are due: the next ones, and those behind them."""

    observed, choices, time = False, Choices(), 0

    def __init__(self):
        self.next, self.behind = [], []

    def deliver(self, subscription, message):
        self.next.append((subscription, message))

    def deliver_behind(self, subscription, message):
        self.behind.append((subscription, message))


def replica(again):
    """Return a replica on nothing, whose first turns end with one more step so often, and what it sends."""
    layer = object.__new__(ReplicatedLayer)
    layer.stage, layer._role, layer._acknowledgement, layer._hears = Stage.IDLE, "leading", None, ()
    layer._dispatcher = Dispatcher()
    layer._unsent, layer._keys = 0, {"a": "", None: ""}
    layer._sending, layer._ending_turn, layer._acknowledging = "send", "end", "acknowledge"
    proposals = SimpleNamespace(void=[])
    layer.agreement = SimpleNamespace(reports=[], state=SimpleNamespace(role="leading"), proposals=proposals)
    layer.process = SimpleNamespace(catching_up=False)
    layer.copy = SimpleNamespace(digest=str, snapshot=bytes)
    sent = []
    layer.link = SimpleNamespace(drop=lambda heard: None, send=lambda key, body, priority: sent.append(body))
    layer.again = again

    def follow_up(now):
        if layer.again:
            layer.again -= 1
            layer._process([], now)

    layer._follow_up = follow_up
    return layer, sent


class Search:
    """All that may happen, to a replica and to the flags."""

    def __init__(self, monkeypatch, *, again):
        self.again = again
        self.rounds = []
        loop = SimpleNamespace(call_soon=lambda deliver, *args: self.rounds.append((deliver, args)))
        monkeypatch.setattr("mdm.team.replicated.get_running_loop", lambda: loop)

    def play(self, events):
        """Return the state after some events; None where one of them cannot be."""
        layer, sent = replica(self.again)
        flags, dispatcher = Flags(), layer._dispatcher
        self.rounds.clear()
        for event in events:
            if event in SENDS:
                ends = len(dispatcher.behind)
                layer._process(SENDS[event], 0)
                assert (len(dispatcher.behind) > ends) == flags.process()
            elif event == "a stop":
                layer.on_stop()
                flags.stop()
            elif event == "a round of the loop":
                if not self.rounds:
                    return None
                deliver, args = self.rounds.pop(0)
                deliver(*args)
            else:
                queue = dispatcher.next if event == "a turn" else dispatcher.behind
                if not queue or (event == "the turn behind" and dispatcher.next):
                    return None
                self.turn(layer, flags, sent, *queue.pop(0))
            assert FLAGS[layer.stage] == (flags.turn_ends, flags.acknowledges)
            assert (layer._acknowledgement is not None) == flags.acknowledgement
        queues = tuple(tuple((kind, str(message)) for kind, message in queue) for queue in vars(dispatcher).values())
        return layer.stage, layer.again, layer._acknowledgement is not None, queues, len(self.rounds)

    def turn(self, layer, flags, sent, kind, message):
        count = len(sent)
        if kind == "send":
            layer._send_all(message)
            flags.send(message)
        elif kind == "end":
            rounds, again = len(self.rounds), layer.again
            layer._end_turn(None)
            assert (len(self.rounds) > rounds) == flags.end_turn(again > layer.again)
        else:
            word = flags.acknowledgement
            layer._acknowledge(None)
            flags.acknowledge()
            assert len(sent) == count + word


@pytest.mark.parametrize("again", [0, 1])
def test_each_stage_stands_for_one_combination_of_flags(again, monkeypatch):
    search, seen, frontier = Search(monkeypatch, again=again), set(), [()]
    for _ in range(6):
        following = []
        for events in frontier:
            for event in EVENTS:
                state = search.play((*events, event))
                if state is not None and state not in seen:
                    seen.add(state)
                    following.append((*events, event))
        frontier = following
    assert {state[0] for state in seen} == set(Stage)
    assert len(seen) > 200
