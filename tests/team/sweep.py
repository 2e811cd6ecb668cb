"""The search of `team.search` for large spaces: ``python -m team.sweep [NAME…]``, with ``tests`` in ``PYTHONPATH``.

The same states and the same events, but in numbers alone: a state is a row of what `team.search` has numbered (agents,
lines of messages, what was applied), and compiled code looks up what an event makes of it. What no table knows yet is
asked of the search, which runs the agreement itself. A state that was visited is kept as a hash of 64 bits.

Fewer states are visited than there are. Each of these leaves out states for which another one stands:

- **More faults to come.** Whatever can happen with some faults left can happen with more of them left. So a state is
  left out where the same was visited with all the faults that this one has, and perhaps others. Whether an agent has
  crashed or returned is seen from the state itself; the other faults are a set, and each state has the sets that it was
  visited with.
- **What an agent never looks at again.** A number stands for all states of an agent that differ in nothing that it will
  ever read: `Sweep.number` says in what they may differ.
- **What is said again, is said again at any time.** Whether the timers for that are set is no part of the state: they
  may fire whenever nothing that the agent said is under way. That is more than can happen, never less.
- **Messages that are dead.** A message that its receiver drops from now on, changing and answering nothing, is taken
  away at once: `Sweep.dead` says which. To deliver it later, to lose or to repeat it makes the same states, with no
  more faults left. Nobody is kept from anything by that: who waits until what it said has arrived could have had it
  arrive first.
- **Two agents are divided in one way.** To cut off the one is to cut off the other.

``tests/team/test_sweep.py`` compares what agents come to with and without these.
"""

from __future__ import annotations

import copy
import gc
import sys
import time
from itertools import product
from types import SimpleNamespace

import numpy as np
from team.rows import (
    AGAIN,
    ASKED,
    COMMANDS,
    CRASHED,
    CUT_OFF,
    EVENTS,
    FIRST,
    INVITE,
    LARGEST,
    MESSAGES,
    RETRY,
    VIEWS,
    Table,
    Tables,
    expand,
    grown,
    link,
    put,
    rebuilt,
)
from team.search import Numbers, Search, State, describe
from team.spaces import SPACES

from mdm.team.agreement import Agreement
from mdm.team.agreement.messages import Ended, Entries, Fetch, Joined, Snapshot, Stale, decode

FAULTS = ("partitions", "losses", "duplicates", "impatience")
"""Faults of which a state has one left, or none; crashes and restarts are seen from the state itself."""

AGAIN_SAID = frozenset({"retry", "invite"})
"""Timers of what is said again."""

TOGETHER = 1 << 18
"""Rows that are expanded together."""

KINDS = ("events", "appends", "living", "ledgers")
"""Tables, by the kind of what is asked."""


def table(size):
    """Return an empty table."""
    return Table(np.full(size, -1, np.int64), np.zeros(size, np.int32))


class Sweep(Search):
    """One search of a large space.

    Args:
        reduced: Whether states are left out for which others stand.
    """

    def __init__(self, space, machine=Agreement, *, reduced=True):
        super().__init__(space, machine)
        self.reduced = reduced
        self.outcomes, self.lines, self.bursts, self.effects = Numbers(), Numbers(), Numbers(), Numbers()
        self.ledgers, self.sights, self.places, self.hearings = Numbers(), Numbers(), Numbers(), Numbers()
        self.lines(()), self.bursts(()), self.effects(()), self.places(None)
        self.said = {}
        self.described = self.lined = 0
        self.used = [0] * len(KINDS)
        count, self.width = space.agents, space.agents**2 + 2
        self.faults = [fault for fault in FAULTS if getattr(space, fault)]
        bits = [1 << self.faults.index(fault) if fault in self.faults else 0 for fault in FAULTS]
        self.bits = np.array([*bits, space.crashes, space.commands], np.int64)
        assert not (space.commands and space.restarts)  # who has taken which stop is not forgotten with a life here
        sets = range(1 << len(self.faults))
        subsets = [sum(1 << one for one in sets if one == of or (reduced and one & of == one)) for of in sets]
        self.kind_of_sets = np.uint8 if len(self.faults) <= 3 else np.uint16
        named = {name: np.zeros(1 << 10, np.int32) for name in Tables._fields} | {
            "sent": np.zeros((1 << 10, count), np.int32),
            "sight": np.zeros((3**count * (count + 1), count), np.int32),
            "subsets": np.array(subsets, self.kind_of_sets),
            "renewed": np.zeros(count, np.uint32),
        }
        self.tables = Tables(**named | {name: table(1 << 14) for name in KINDS})

    # -- One agent -----------------------------------------------------------------------------------------------

    def number(self, machine):
        """Return the number of where an agent stands, the same for all that differ in what it never reads again.

        What members said, and who takes part in the steps, is read by a leader alone, and forgotten at each new term;
        and of those who lag behind by more than a step, a leader only says where the term begins. What was told by
        those who joined, and its patience with them, counts until the term has begun. A reading is dropped where an
        agent takes part in a new term. The timers for what is said again are set at any time.
        """
        if not self.reduced:
            return super().number(machine)
        held = dict(machine.__dict__)
        state = machine.state = copy.copy(machine.state)
        if state.role != "leading":
            state.members, state.overdue = (), False
            state.applied = state.components = state.commands = {}
        else:
            state.applied = {agent: step for agent, step in state.applied.items() if step >= machine.step - 1}
            joined = dict.fromkeys(state.ballot.joined)
            state.ballot = SimpleNamespace(invited=state.ballot.invited, joined=joined, patient=False)
        if not state.begun and not machine.event_driven:
            commands = machine.proposals.commands
            machine.proposals = SimpleNamespace(components=(), commands=commands, offered=None, commanded=None)
        state.timers = [timer for timer in state.timers if timer not in AGAIN_SAID]
        described = describe(machine)
        machine.__dict__.update(held)
        return self.machines(described, machine)

    def event(self, number, what, *args):
        if what in AGAIN_SAID:
            self.machines.things[number].state.timers.setdefault(what, 0)
        return super().event(number, what, *args)

    # -- What compiled code asks for -----------------------------------------------------------------------------

    def widen(self, name, wanted):
        """Make room for a number."""
        array = getattr(self.tables, name)
        if wanted >= len(array):
            larger = np.zeros((2 * wanted, *array.shape[1:]), array.dtype)
            larger[: len(array)] = array
            self.tables = self.tables._replace(**{name: larger})

    def describe_agents(self):
        """Write down what is asked of agents; their numbers are those of the search, and one."""
        things, count = self.machines.things, len(self.names)
        for name in ("life", "may", "sees", "place", "hearing"):
            self.widen(name, len(things) + 1)
        tables = self.tables
        for number in range(self.described, len(things)):
            machine = things[number]
            may = [machine.state.begun and machine.step < self.space.steps and not machine.proposals.components]
            may += [timer in machine.state.timers for timer in EVENTS[1:]]
            if self.reduced:
                may[RETRY], may[INVITE] = True, machine.state.ballot is not None
            again = machine.incarnation > count
            tables.life[number + 1] = AGAIN if again else FIRST
            tables.may[number + 1] = sum(1 << bit for bit, possible in enumerate(may) if possible)
            tables.sees[number + 1] = self.sights(self.sees(number))
            tables.place[number + 1] = self.places((machine.replica.position, again))
            tables.hearing[number + 1] = self.hearings(self.heeds(machine))
        self.described = len(things)
        assert max(len(self.places.things), len(self.hearings.things) >> 12) < 1 << 8  # they fit into keys

    def line(self, messages):
        """Return the number of a line of messages."""
        number = self.lines(messages)
        if messages and number >= self.lined:
            rest = self.line(messages[1:])
            self.widen("first", number + 1)
            self.widen("rest", number + 1)
            self.tables.first[number], self.tables.rest[number] = messages[0], rest
            self.lined = max(self.lined, number)
        return number

    def answer(self, kind, key):
        """Return the answer to a question of compiled code."""
        if kind == 0:
            return self.answer_event(key >> 24, key & 0xFFFFFF)
        if kind == 1:
            line = self.lines.things[key >> 24]
            for message in self.bursts.things[key & 0xFFFFFF]:
                if message not in line:
                    line = (*line, message)
            return self.line(line)
        if kind == 2:
            line, hearing = self.lines.things[key >> 22], self.hearings.things[(key >> 2) & 0xFFFFF]
            if not self.reduced:
                return self.line(line)
            return self.line(tuple(message for message in line if not self.dead(hearing, message, key & 3)))
        count = len(self.names)
        places = [key >> 8 * (count - 1 - index) & 0xFF for index in range(count)]
        key >>= 8 * count
        return self.answer_ledger(key >> 18, key & 0x3FFFF, [self.places.things[place] for place in places])

    def answer_event(self, agent, event):
        if event < COMMANDS:
            what = (EVENTS[event],)
        elif event < VIEWS:
            place, verb = divmod(event - COMMANDS, 2)
            what = ("command", ("start", "stop")[verb], str(place + 1))
        elif event < MESSAGES:
            what = ("members", self.sights.things[event - VIEWS])
        else:
            what = ("receive", event - MESSAGES)
        found = self.event(agent - 1, *what)
        if found is None:
            return CUT_OFF
        number, sent, applied, began, commands = found
        index = self.names.index(self.machines.things[number].agent)
        bursts = [()] * len(self.names)
        for target, message in sent:
            bursts[target] += (message,)
        before, after = self.acting(agent - 1), self.acting(number)
        effect = ()
        if applied or began is not None or what[0] == "command" or (after and after != before):
            term = self.machines.things[number].term
            effect = (index, applied, began, (what[0], what[1] if what[0] == "command" else "", term), commands, after)
        outcome = self.outcomes((number, tuple(map(self.bursts, bursts)), self.effects(effect)))
        self.describe_agents()
        for name in ("agent", "sent", "effect"):
            self.widen(name, outcome)
        tables = self.tables
        tables.agent[outcome] = number + 1
        tables.sent[outcome] = self.outcomes.things[outcome][1]
        tables.effect[outcome] = self.outcomes.things[outcome][2]
        return outcome

    def acting(self, number):
        """Return the start on which an agent acts; empty where it does not."""
        machine = self.machines.things[number]
        return machine.replica.started if machine.replica.running and not machine.hold.still else ""

    def answer_ledger(self, ledger, effect, places):
        entries, bases, asked, stopped = self.ledgers.things[ledger]
        index, applied, began, event, commands, acts = self.effects.things[effect]
        entries, bases = self.check(entries, bases, index, applied, began, places)
        name, command, term = event
        asked, stopped = self.check_order(asked, stopped, index, (name, command), term, commands, acts)
        return self.ledger((entries, bases, asked, stopped))

    def ledger(self, ledger):
        """Return the number of a ledger."""
        number = self.ledgers(ledger)
        assert number < 1 << 45 - 8 * len(self.names)  # it fits into keys
        self.widen("asked", number)
        self.tables.asked[number] = len(ledger[2])
        return number

    # -- Dead messages -------------------------------------------------------------------------------------------

    def heeds(self, machine):
        """Return what decides which messages an agent drops for ever."""
        joined = None if machine.state.ballot is None else tuple(sorted(machine.state.ballot.joined))
        return machine.term, joined, tuple(machine.state.live.items())

    def dead(self, hearing, number, sender_life):
        """Return whether a message is dropped by its receiver from now on, whatever happens.

        An agent's term never goes back. Of older ones some messages are dropped without an answer, and a word of a term
        with a lower number changes nothing. In its own term, an agent that does not lead, and so never will, needs
        nobody to join, and one that leads needs each but once. And nobody is ever seen again in a life that has ended.
        """
        if number not in self.said:
            sender, life, body = self.messages.things[number]
            self.said[number] = sender, life, decode(body)
        sender, life, message = self.said[number]
        term, joined, live = hearing
        if isinstance(message, Joined | Fetch | Entries | Snapshot | Ended) and message.term < term:
            return True
        if isinstance(message, Stale) and message.term.number < term.number:
            return True
        if isinstance(message, Joined) and message.term == term and (joined is None or sender in joined):
            return True
        ended = sender_life == CRASHED or (sender_life == AGAIN and life <= len(self.names))
        return ended and (sender, life) not in live

    # -- All of them ---------------------------------------------------------------------------------------------

    def state(self, row):
        """Return a state of numbers as the search has it, with no faults left."""
        count = len(self.names)
        agents = tuple(int(number) - 1 for number in row[:count])
        lives = tuple(0 if number < 0 else self.machines.things[number].incarnation for number in agents)
        line = tuple(
            () if one == other else self.lines.things[row[link.py_func(count, one, other)]]
            for one in range(count)
            for other in range(count)
        )
        return State(agents, lives, line, int(row[-1] & 7) - 1, (0,) * 8, *self.ledgers.things[row[-2]])

    def first(self):
        """Return the first state as a row, with all that can be written down before."""
        state, count = self.start(), len(self.names)
        if self.space.restarts:
            self.tables.renewed[:] = [self.new(name, count + 1) + 1 for name in self.names]
        self.describe_agents()
        for cut in range(count + 1):
            for number, ends in enumerate(product((CRASHED, FIRST, AGAIN), repeat=count)):
                lives = tuple((0, index + 1, count + 1)[life] for index, life in enumerate(ends))
                seen = State((), lives, (), cut - 1, (), None, None)
                for index in range(count):
                    self.tables.sight[cut * 3**count + number, index] = self.sights(self.view(seen, index))
        row = np.zeros((1, self.width), np.uint32)
        row[0, :count] = [number + 1 for number in state.agents]
        assert not any(state.line)
        row[0, -2] = self.ledger((state.entries, state.bases, state.asked, state.stopped))
        row[0, -1] = (1 << len(self.faults)) - 1 << 3
        return row

    def enlarge(self):
        """Make room in the tables."""
        for kind, name in enumerate(KINDS):
            old = getattr(self.tables, name)
            if 2 * (self.used[kind] + ASKED) > len(old.keys):
                larger = table(2 * len(old.keys))
                rebuilt(old, larger)
                self.tables = self.tables._replace(**{name: larger})

    def expanded(self, rows, seen, sets):
        """Return what follows rows and is new, and how many states are."""
        found, asked = [], np.empty((ASKED, 2), np.int64)
        out, again = np.empty((1 << 17, self.width), np.uint32), np.empty(len(rows), np.int64)
        total = 0
        while len(rows):
            begin, waiting = 0, []
            while begin < len(rows):
                self.enlarge()
                count = np.zeros(5, np.int64)
                begin = expand(
                    self.tables, len(self.names), self.bits, rows, begin, seen, sets, out, again, asked, count
                )
                for kind, key in asked[: count[0]].tolist():
                    put(getattr(self.tables, KINDS[kind]), key, self.answer(kind, key))
                    self.used[kind] += 1
                self.cut_off += int(count[1])
                total += int(count[3])
                found.append(out[: count[2]].copy())
                waiting.append(rows[again[: count[4]]])
            rows = np.concatenate(waiting)
        return np.concatenate(found), total

    def run(self, *, limit=None, settle_every=0, seconds=None, say=None):
        """Visit all states, or about so many, and return their number: with other faults left they are the same."""
        began, depth, total, followed, settled = time.monotonic(), 0, 0, 0, 0
        frontier = [self.first()]
        seen, sets = np.zeros(1 << 20, np.uint64), np.zeros(1 << 20, self.kind_of_sets)
        while frontier:
            depth, following = depth + 1, []
            for rows in frontier:
                room = total + LARGEST * len(rows)
                if 5 * room > 4 * len(seen):
                    larger = np.zeros(2 * room, np.uint64), np.zeros(2 * room, self.kind_of_sets)
                    grown(seen, sets, *larger)
                    seen, sets = larger
                found, new = self.expanded(rows, seen, sets)
                if settle_every:
                    for row in found[-followed % settle_every :: settle_every]:
                        self.settle(self.state(row))
                        settled += 1
                total, followed = total + new, followed + len(found)
                following += np.array_split(found, len(found) // TOGETHER + 1) if len(found) else []
                if (limit is not None and total >= limit) or (seconds and time.monotonic() - began > seconds):
                    return total
            frontier = following
            if say is not None:
                alone, time_taken = len(self.machines.things), time.monotonic() - began
                say(f"depth {depth}: {total:,} states, {alone:,} of one agent, {settled:,} settled, {time_taken:.0f} s")
        return total


def main(*names):
    """Search the spaces of these names, and return the exit status."""
    gc.disable()  # nothing is given back before the end
    for name in names:
        search = Sweep(SPACES[name])
        began = time.monotonic()
        count = search.run(say=lambda text: print(text, flush=True), settle_every=20_000)
        print(f"{name}: {count:,} states, {search.cut_off} cut off, {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
