"""The loops of `team.sweep`: rows of numbers, what may happen to each, and what has become of it then.

A row is a state: the agents, the line of messages of each link, the ledger of what was applied, and in its last column
whom a partition cuts off (counted from 1) with the faults that are left, as bits above. Nothing here knows what the
numbers stand for; tables say what follows from what, and what they do not say is noted and asked for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

PARTITIONS, LOSSES, DUPLICATES, IMPATIENCE, CRASHES, MOST = range(6)
"""Faults, by place in ``bits``; the last is how many commands may be asked for."""

PROPOSE, RETRY, INVITE, CLOSE, PATIENCE, CALL = range(6)
EVENTS = ("propose", "retry", "invite", "close", "patience", "call")
COMMANDS = 8  # the first event that is a command: of each place in the order of asking, a start and a stop
VIEWS = 16  # the first event that is a view
MESSAGES = 4096  # the first event that is a message

LOST, CRASH, RETURN, CUT, HEAL = range(-5, 0)
"""What happens to no agent's own state, or does away with it."""

ASKED, LARGEST = 1 << 12, 64
"""How much may be asked for at once, and how much can happen in one state at most."""

PENDING, CUT_OFF = -1, -2
"""Of an outcome: it has still to be asked for; it has a term beyond the bound."""

CRASHED, FIRST, AGAIN = range(3)
"""The life that an agent is in."""


class Table(NamedTuple):
    """Answers by key, in open addressing; -1 is no key."""

    keys: np.ndarray
    values: np.ndarray


class Tables(NamedTuple):
    """All that compiled code looks up."""

    events: Table  # of an agent and an event: the outcome
    appends: Table  # of a line and what is sent: the line then
    living: Table  # of a line, its receiver's class and its sender's life: the line without dead messages
    ledgers: Table  # of a ledger, an effect and where all agents stand: the ledger then
    agent: np.ndarray  # by outcome: the agent then
    sent: np.ndarray  # by outcome and target: what is sent, 0 for nothing
    effect: np.ndarray  # by outcome: what is applied and begun, 0 for nothing
    life: np.ndarray  # by agent: the life
    may: np.ndarray  # by agent: the events that are possible, in bits
    sees: np.ndarray  # by agent: the view
    place: np.ndarray  # by agent: where its copy stands
    hearing: np.ndarray  # by agent: the class of agents that drop the same messages
    asked: np.ndarray  # by ledger: how many commands were asked for
    first: np.ndarray  # by line: its first message
    rest: np.ndarray  # by line: the others
    sight: np.ndarray  # by lives, cut and agent: what it would see
    subsets: np.ndarray  # by faults left: all sets of no more
    renewed: np.ndarray  # by index: an agent that starts again


@njit(cache=True, inline="always")
def mixed(key):
    key = np.uint64(key)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@njit(cache=True)
def put(table, key, value):
    last = len(table.keys) - 1
    place = np.int64(mixed(key)) & last
    while table.keys[place] != -1 and table.keys[place] != key:
        place = (place + 1) & last
    table.keys[place] = key
    table.values[place] = value


@njit(cache=True)
def rebuilt(table, larger):
    for place in range(len(table.keys)):
        if table.keys[place] != -1:
            put(larger, table.keys[place], table.values[place])


@njit(cache=True, inline="always")
def look(table, kind, key, asked, count):
    """Return the answer to a key; note that it is to be asked for where there is none."""
    last = len(table.keys) - 1
    place = np.int64(mixed(key)) & last
    while table.keys[place] != -1:
        if table.keys[place] == key:
            return table.values[place]
        place = (place + 1) & last
    table.keys[place] = key
    table.values[place] = PENDING
    asked[count[0], 0], asked[count[0], 1] = kind, key
    count[0] += 1
    return PENDING


@njit(cache=True, inline="always")
def link(agents, one, other):
    """Return the column of the line from one agent to another."""
    return agents + one * (agents - 1) + other - (other > one)


@njit(cache=True, inline="always")
def linked(cut, one, other):
    return cut == 0 or (one == cut - 1) == (other == cut - 1)


@njit(cache=True)
def possible(tables, agents, bits, state, events):
    """Write down all that may happen in a state, and return how much: what, to whom, on which line, by which fault."""
    count, width = 0, agents * agents + 1
    cut, left = np.int64(state[width] & 7), np.int64(state[width] >> 3)
    crashed = False
    lives = np.int64(cut)
    for index in range(agents):
        life = tables.life[state[index]]
        crashed |= life != FIRST
        lives = lives * 3 + life
    for one in range(agents):
        for other in range(agents):
            line = link(agents, one, other)
            if one != other and state[line]:
                event = MESSAGES + tables.first[state[line]]
                events[count] = event, other, line, 0
                count += 1
                if left & bits[LOSSES]:
                    events[count] = LOST, other, line, bits[LOSSES]
                    count += 1
                if left & bits[DUPLICATES]:
                    events[count] = event, other, 0, bits[DUPLICATES]
                    count += 1
    for index in range(agents):
        if not state[index]:
            if tables.renewed[index]:
                events[count] = RETURN, index, 0, 0
                count += 1
            continue
        view = tables.sight[lives, index]
        if view != tables.sees[state[index]]:
            events[count] = VIEWS + view, index, 0, 0
            count += 1
        may = tables.may[state[index]]
        silent = True
        for other in range(agents):
            silent &= other == index or not state[link(agents, index, other)]
        for event in range(6):
            if may >> event & 1 and (silent or event not in {RETRY, INVITE}):
                if event < PATIENCE:
                    events[count] = event, index, 0, 0
                    count += 1
                elif left & bits[IMPATIENCE]:
                    events[count] = event, index, 0, bits[IMPATIENCE]
                    count += 1
        asked = tables.asked[state[agents * agents]]
        if asked < bits[MOST]:
            for verb in range(2):
                events[count] = COMMANDS + 2 * asked + verb, index, 0, 0
                count += 1
        if bits[CRASHES] and not crashed:
            events[count] = CRASH, index, 0, 0
            count += 1
        if left & bits[PARTITIONS] and not cut and (agents > 2 or index == 0):
            events[count] = CUT, index, 0, bits[PARTITIONS]
            count += 1
    if cut:
        events[count] = HEAL, 0, 0, 0
        count += 1
    return count


@njit(cache=True)
def expand(tables, agents, bits, states, begin, seen, sets, out, again, asked, count):
    """Visit what follows states; return how far it came before it had to stop.

    ``count`` holds how many answers are asked for, what was cut off, states put out, new ones, and to be done again.
    """
    width, ledger = agents * agents + 1, agents * agents
    after, events = np.empty(width + 1, np.uint32), np.empty((LARGEST, 4), np.int64)
    event_table, append_table, living_table, ledger_table = tables[:4]
    agent_after, sent_by, effect_of, renewed = tables.agent, tables.sent, tables.effect, tables.renewed
    life, place_of, hearing_of, rest, subsets = tables.life, tables.place, tables.hearing, tables.rest, tables.subsets
    size = np.uint64(len(seen))
    for number in range(begin, len(states)):
        if count[2] + LARGEST > len(out) or count[0] + 8 * LARGEST > ASKED:
            return number
        known = True
        cut = states[number, width] & 7
        for happens in range(possible(tables, agents, bits, states[number], events)):
            event, index, line, spent = events[happens, 0], events[happens, 1], events[happens, 2], events[happens, 3]
            for column in range(width + 1):
                after[column] = states[number, column]
            after[width] -= spent << 3
            if line:
                after[line] = rest[after[line]]
            if event >= 0:
                outcome = look(event_table, 0, (np.int64(after[index]) << 24) | event, asked, count)
                if outcome < 0:
                    count[1] += outcome == CUT_OFF
                    known &= outcome == CUT_OFF
                    continue
                effect = effect_of[outcome]
                if effect:
                    key = (np.int64(after[ledger]) << 18) | effect
                    for other in range(agents):
                        key = (key << 8) | place_of[after[other]]
                    applied = look(ledger_table, 3, key, asked, count)
                    if applied < 0:
                        known = False
                        continue
                    after[ledger] = applied
                after[index] = agent_after[outcome]
                held = True
                for other in range(agents):
                    sent = sent_by[outcome, other]
                    if sent and after[other] and linked(cut, index, other):
                        line = link(agents, index, other)
                        longer = look(append_table, 1, (np.int64(after[line]) << 24) | sent, asked, count)
                        held &= longer >= 0
                        after[line] = longer
                if not held:
                    known = False
                    continue
            elif event == RETURN:
                after[index] = renewed[index]
            elif event == HEAL:
                after[width] -= cut
            elif event != LOST:
                for other in range(agents):
                    if other != index:
                        after[link(agents, other, index)] = 0
                        if event == CUT:
                            after[link(agents, index, other)] = 0
                if event == CRASH:
                    after[index] = 0
                else:
                    after[width] += index + 1
            held = True
            for one in range(agents):
                sender = np.int64(life[after[one]])
                for other in range(agents):
                    line = link(agents, one, other)
                    if one != other and after[line]:
                        hearing = np.int64(hearing_of[after[other]])
                        key = (np.int64(after[line]) << 22) | (hearing << 2) | sender
                        living = look(living_table, 2, key, asked, count)
                        held &= living >= 0
                        after[line] = living
            if not held:
                known = False
                continue
            left = after[width] >> 3
            key = np.uint64(after[width] & 7)
            for column in range(0, width, 2):
                pair = np.uint64(after[column]) << np.uint64(32)
                if column + 1 < width:
                    pair |= np.uint64(after[column + 1])
                key = mixed(key * np.uint64(0x9E3779B97F4A7C15) + pair)
            if key == 0:
                key = np.uint64(1)
            place = np.int64(((key >> np.uint64(32)) * size) >> np.uint64(32))
            while seen[place] != 0 and seen[place] != key:
                place += 1
                if place == len(seen):
                    place = 0
            if seen[place] == 0:
                seen[place] = key
                count[3] += 1
            elif (np.int64(sets[place]) >> left) & 1:
                continue
            sets[place] |= subsets[left]
            for column in range(width + 1):
                out[count[2], column] = after[column]
            count[2] += 1
        if not known:
            again[count[4]] = number
            count[4] += 1
    return len(states)


@njit(cache=True)
def grown(seen, sets, larger, larger_sets):
    size = np.uint64(len(larger))
    for index in range(len(seen)):
        key = seen[index]
        if key:
            place = np.int64(((key >> np.uint64(32)) * size) >> np.uint64(32))
            while larger[place] != 0:
                place += 1
                if place == len(larger):
                    place = 0
            larger[place], larger_sets[place] = key, sets[index]
