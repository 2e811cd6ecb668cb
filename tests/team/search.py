"""All that can happen to agents that agree on steps, visited breadth first: ``python -m team.search [NAME…]``.

A state is where each agent stands, the messages under way, the cut between sides, the faults that are still to come,
and what was applied so far. Links are independent, and keep their order unless a message overtakes. Time is left out: a
timer that is set may fire at any time, but nothing is said again before what its agent said has arrived or was lost. A
cut loses what is under way across it, a crash what is under way to the agent. What an agent makes of an event depends
on itself alone, so that it is worked out once and looked up afterwards.
"""

from __future__ import annotations

import copy
import gc
import sys
import time
from typing import NamedTuple

import msgspec
from team import invariants
from team.copies import Copy, Violation, Witness, component
from team.spaces import SPACES

from mdm.team.agreement import Agreement, Position, decode, encode

TERMS = 9
"""The highest number of a term; states beyond it are counted as cut off."""


CRASHES, RESTARTS, PARTITIONS, LOSSES, DUPLICATES, OVERTAKINGS, IMPATIENCE, COMMANDS = range(8)


class State(NamedTuple):
    """Everything, but for what the numbers stand for."""

    agents: tuple  # the number of each agent's own state, -1 where it has crashed
    lives: tuple  # which life each of them is in, 0 where it has crashed
    line: tuple  # messages under way, by number, of each link
    cut: int  # the agent that a partition cuts off, or -1
    left: tuple  # crashes, restarts, partitions, losses, duplicates, overtakings, impatience, commands
    entries: frozenset  # what was applied, by number
    bases: frozenset  # where terms began, by number
    asked: tuple = ()  # the term in which each command was asked for, in the order of asking
    stopped: tuple = ()  # of each agent, which of them was the last stop that it has taken; 0 where it acts, or may
    kept: tuple = ()  # of each agent that has crashed, the stop that outlives its process


def clone(machine):
    """Return an agent like this one, with nothing in common that changes."""
    made = object.__new__(type(machine))
    made.__dict__.update(machine.__dict__)
    made.reports, made._out = [], []
    for name in ("state", "log", "proposals", "hold", "replica"):
        setattr(made, name, copy.copy(getattr(machine, name)))
    for name in ("live", "components", "commands", "applied", "doubts", "timers"):
        setattr(made.state, name, dict(getattr(made.state, name)))
    made.log.commits = list(made.log.commits)
    made.proposals.components = made.proposals.components.copy()
    made.proposals.commands = made.proposals.commands.copy()
    made.proposals.void = []
    if made.state.ballot is not None:
        made.state.ballot = copy.copy(made.state.ballot)
        made.state.ballot.joined = dict(made.state.ballot.joined)
    return made


def describe(machine):
    """Return everything that decides what an agent does next, as bytes."""
    state, log, proposals, hold = machine.state, machine.log, machine.proposals, machine.hold
    ballot = state.ballot
    return msgspec.msgpack.encode([
        machine.agent, machine.incarnation, state.term, state.begun, state.highest, state.live,
        state.released, state.quorate, state.sound, state.fetching, state.members, state.overdue,
        ballot and [ballot.invited, sorted(ballot.joined.items()), ballot.patient],
        log.lineage, log.side, log.commits,
        list(proposals.components), list(proposals.commands), proposals.offered, proposals.commanded,
        sorted(state.components.items()), list(state.commands.items()), sorted(state.applied.items()),
        sorted(state.doubts.items()), sorted(state.timers), machine.replica.position, machine.replica.value,
        hold.held.name, hold.last, hold.at, machine.replica.running, machine.replica.started,
    ])  # fmt: skip


class Numbers:
    """Things by number, and back."""

    def __init__(self):
        self.numbers, self.things = {}, []

    def __call__(self, key, thing=None):
        number = self.numbers.get(key)
        if number is None:
            number = self.numbers[key] = len(self.things)
            self.things.append(key if thing is None else thing)
        return number


class Search:
    """One search through a space."""

    def __init__(self, space, machine=Agreement):
        self.space = space
        self.names = [chr(ord("a") + index) for index in range(space.agents)]
        self.majority = space.agents // 2 + 1 if space.mode == "majority" else 1
        self.kind = machine
        self.machines, self.messages, self.entries, self.bases = Numbers(), Numbers(), Numbers(), Numbers()
        self.witness = Witness(event_driven=space.event_driven)
        self.memory, self.views, self.seen = {}, {}, {}
        self.cut_off = 0

    # -- One agent -----------------------------------------------------------------------------------------------

    def new(self, name, life, standstill=None):
        machine = self.kind(
            name,
            self.names,
            Copy(name, self.witness),
            incarnation=life,
            mode=self.space.mode,
            event_driven=self.space.event_driven,
            deadline_ns=30,
            retry_ns=10,
        )
        if standstill is not None:
            machine.hold.recall(standstill)
        return self.number(machine)

    def number(self, machine):
        """Return the number of where an agent stands."""
        return self.machines(describe(machine), machine)

    def event(self, number, what, *args):
        """Return what an agent makes of an event: where it stands, what it sends, applied, and which term it began."""
        key = (number, what, *args)
        found = self.memory.get(key)
        if found is None:
            found = self.memory[key] = self.work_out(clone(self.machines.things[number]), what, *args)
        return found

    def work_out(self, machine, what, *args):
        witness = self.witness
        witness.applied, witness.machine = [], machine
        begun, term = machine.state.begun, machine.term
        if what == "receive":
            sender, life, body = self.messages.things[args[0]]
            sends = machine.receive(sender, life, decode(body), 0)
        elif what == "members":
            sends = machine.members(dict(args[0]), 0)
        elif what == "propose":
            sends = machine.propose(component(machine.agent, machine.term, machine.step + 1), 0)
        elif what == "command":
            sends = machine.propose(None, 0, *args)
        else:
            machine.fire(what, 0)
            sends = machine._flush()
        if machine.term < term:
            raise Violation(f"{machine.agent} goes back from {term} to {machine.term}")
        if self.kind is Agreement:  # a fault that is planted is to be found by what it does
            invariants.check(machine)
        if any(kind == "digest" for kind, _ in machine.reports):
            raise Violation(machine.reports[-1][1])
        began = None
        if machine.state.role == "leading" and (not begun or machine.term != term):
            at = machine.log.position
            first = next((commit for commit, *_ in witness.applied if commit.term == machine.term), None)
            if first is not None:
                at = Position(first.previous, first.step - 1)
            began = self.bases((machine.term, at))
            if len(machine.state.ballot.joined) < self.majority:
                raise Violation(f"{machine.agent} begins {machine.term} without a majority")
        applied = tuple(self.entry(machine, *each) for each in witness.applied)
        commands = tuple((one.command, one.token, one.term) for one, *_ in witness.applied if one.command is not None)
        sent = tuple(
            (self.names.index(target), self.messages((machine.agent, machine.incarnation, encode(send.message))))
            for send in sends
            for target in (self.names if send.to is None else (send.to,))
            if target != machine.agent
        )
        if machine.term.number > TERMS:
            return None
        return self.number(machine), sent, applied, began, commands

    def entry(self, machine, commit, body, value, older):
        """Return the number of a step that was applied, the newer term it was applied in, and if its leader did."""
        here, before = Position(commit.term, commit.step), Position(commit.previous, commit.step - 1)
        leads = commit.term == machine.term and machine.state.ballot is not None
        return self.entries((here, before, body, value)), older, leads

    # -- All of them ---------------------------------------------------------------------------------------------

    def start(self):
        numbers = tuple(self.new(name, life) for life, name in enumerate(self.names, 1))
        space = self.space
        line = ((),) * space.agents**2
        left, lives = space[4:12], tuple(range(1, space.agents + 1))
        nothing = (None,) * space.agents
        first = State(numbers, lives, line, -1, left, frozenset(), frozenset(), (), (0,) * space.agents, nothing)
        return self.calmed(first) if space.settled else first

    def after(self, state, index, *event):
        """Return the state after an event at one agent; None where a term goes beyond its bound."""
        found = self.event(state.agents[index], *event)
        if found is None:
            self.cut_off += 1
            return None
        number, sent, applied, began, commands = found
        agents = (*state.agents[:index], number, *state.agents[index + 1 :])
        entries, bases = state.entries, state.bases
        if applied or began is not None:
            places = [self.place(number) for number in state.agents]
            entries, bases = self.check(entries, bases, index, applied, began, places)
        line = state.line
        if sent:
            links = list(line)
            for target, message in sent:
                link = index * len(agents) + target
                if agents[target] >= 0 and self.linked(state, index, target) and message not in links[link]:
                    links[link] += (message,)
            line = tuple(links)
        after = state._replace(agents=agents, line=line, entries=entries, bases=bases)
        if event[0] == "command" or commands or any(state.stopped):
            after = self.check_commands(after, index, event, commands)
        return after

    def check_commands(self, state, index, event, commands):
        """Return the state with what an agent was asked for, or took, in an event after which it stands there."""
        machine = self.machines.things[state.agents[index]]
        acts = machine.replica.started if machine.replica.running and not machine.hold.still else ""
        asked, stopped = self.check_order(state.asked, state.stopped, index, event, machine.term, commands, acts)
        return state._replace(asked=asked, stopped=stopped)

    def check_order(self, asked, stops, index, event, term, commands, acts):
        """Return what was asked for, and who was stopped by what, after an event at one agent.

        Args:
            asked: The terms in which commands were asked for.
            stops: Of each agent the last stop that it has taken.
            index: The agent.
            event: Of a command the word, and which.
            term: The agent's, in which that was asked for.
            commands: The commands that it applied.
            acts: The start on which it acts afterwards, if it does.
        """
        stopped = stops[index]
        if event[0] == "command":
            asked += (term,)
            stopped = len(asked) if event[1] == "stop" else stopped
        for command, token, within in commands:
            number = int(token)
            if command == "stop":
                stopped = max(stopped, number)
            if command != "hold" and asked[number - 1] != within:
                raise Violation(f"what was asked for in {asked[number - 1]} is a step of {within}")
        if acts:
            if int(acts) < stopped:
                raise Violation(f"{self.names[index]} was stopped, and acts on a start that was asked for before")
            stopped = 0
        return asked, (*stops[:index], stopped, *stops[index + 1 :])

    def place(self, number):
        """Return where an agent's copy stands, and whether it was restarted; None where it has crashed."""
        if number < 0:
            return None
        machine = self.machines.things[number]
        return machine.replica.position, machine.incarnation > len(self.names)

    def check(self, entries, bases, index, applied, began, places):
        """Return what was applied and begun after an event at one agent; where all stood before it is given."""
        if began is not None and began not in bases:
            bases |= {began}
            if self.majority > 1 and not any(place is not None and place[1] for place in places):
                self.check_begun(entries, *self.bases.things[began])
        for entry, older, leads in applied:
            if entry not in entries:
                entries = self.check_applied(entries, entry)
            if older is not None:
                self.check_older(bases, entries, entry, older)
            if leads and self.majority > 1:
                self.check_majority(index, entries, entry, places)
        return entries, bases

    def check_applied(self, entries, entry):
        things = self.entries.things
        position = things[entry][0]
        if any(things[other][0] == position for other in entries):
            raise Violation(f"two agents apply different steps at {position}, or to different copies")
        return entries | {entry}

    def chain(self, entries, position):
        """Return all positions of a history."""
        before = {self.entries.things[entry][0]: self.entries.things[entry][1] for entry in entries}
        found = {position}
        while position in before:
            position = before[position]
            found.add(position)
        return found

    def check_older(self, bases, entries, entry, term):
        base = next(at for began, at in (self.bases.things[number] for number in bases) if began == term)
        if self.entries.things[entry][0] not in self.chain(entries, base):
            raise Violation(f"a step of an older term than {term} is applied")

    def check_majority(self, index, entries, entry, places):
        before = self.entries.things[entry][1]
        held = sum(
            place is None or other == index or place[1] or before in self.chain(entries, place[0])
            for other, place in enumerate(places)
        )
        if held < self.majority:
            raise Violation(f"{self.names[index]} goes on from {before}, which no majority has")

    def check_begun(self, entries, term, at):
        chain = self.chain(entries, at)
        for entry in entries:
            position, before = self.entries.things[entry][:2]
            if position.term < term and before not in chain:
                raise Violation(f"{term} begins at {at}, without {before}")

    def linked(self, state, one, other):
        return state.cut < 0 or (one == state.cut) == (other == state.cut)

    def view(self, state, index):
        """Return whom an agent would see by now."""
        key = (state.lives, state.cut, index)
        found = self.views.get(key)
        if found is None:
            found = self.views[key] = tuple(
                (name, life)
                for place, (name, life) in enumerate(zip(self.names, state.lives, strict=True))
                if life and self.linked(state, index, place)
            )
        return found

    def sees(self, number):
        """Return whom an agent sees."""
        found = self.seen.get(number)
        if found is None:
            found = self.seen[number] = tuple(self.machines.things[number].state.live.items())
        return found

    def following(self, state):
        """Yield all states that may come next."""
        count = len(self.names)
        crashes, restarts, partitions, losses, duplicates, overtakings, impatience, commands = state.left
        for link, queue in enumerate(state.line):
            if not queue:
                continue
            target = link % count
            rest = self.replaced(state, link, queue[1:])
            yield self.after(rest, target, "receive", queue[0])
            if losses:
                yield self.spent(rest, LOSSES)
            if duplicates:
                yield self.after(self.spent(state, DUPLICATES), target, "receive", queue[0])
            if overtakings:
                for place in range(1, len(queue)):
                    others = self.replaced(self.spent(state, OVERTAKINGS), link, queue[:place] + queue[place + 1 :])
                    yield self.after(others, target, "receive", queue[place])
        for index, number in enumerate(state.agents):
            if number < 0:
                if restarts:
                    life = count + 1 + self.space.restarts - restarts
                    again = self.new(self.names[index], life, state.kept[index])
                    yield self.spent(self.placed(state, index, again, life), RESTARTS)
                continue
            machine = self.machines.things[number]
            view = self.view(state, index)
            if view != self.sees(number):
                yield self.after(state, index, "members", view)
            if machine.state.begun and machine.step < self.space.steps and not machine.proposals.components:
                yield self.after(state, index, "propose")
            for command in ("start", "stop") if commands else ():
                yield self.after(self.spent(state, COMMANDS), index, "command", command, str(len(state.asked) + 1))
            for timer in machine.state.timers:
                if timer in {"retry", "invite"}:
                    if not any(state.line[index * count : (index + 1) * count]):
                        yield self.after(state, index, timer)
                elif timer == "close":
                    yield self.after(state, index, timer)
                elif impatience and timer in {"patience", "call"}:
                    yield self.after(self.spent(state, IMPATIENCE), index, timer)
            if crashes:
                crashed = self.spent(self.placed(state, index, -1, 0), CRASHES)
                yield self.emptied(crashed, lambda one, other, index=index: other == index)
            if partitions and state.cut < 0:
                cut = self.spent(state._replace(cut=index), PARTITIONS)
                yield self.emptied(cut, lambda one, other, index=index: (one == index) != (other == index))
        if state.cut >= 0:
            yield state._replace(cut=-1)

    def spent(self, state, fault):
        left = state.left
        return state._replace(left=(*left[:fault], left[fault] - 1, *left[fault + 1 :]))

    def placed(self, state, index, number, life):
        agents = (*state.agents[:index], number, *state.agents[index + 1 :])
        lives = (*state.lives[:index], life, *state.lives[index + 1 :])
        before = state.agents[index]
        state = state._replace(agents=agents, lives=lives)
        if not self.space.keeps:
            return state._replace(stopped=(*state.stopped[:index], 0, *state.stopped[index + 1 :]))
        left = None if number >= 0 else self.machines.things[before].hold.standstill
        return state._replace(kept=(*state.kept[:index], left, *state.kept[index + 1 :]))

    def replaced(self, state, link, queue):
        return state._replace(line=(*state.line[:link], queue, *state.line[link + 1 :]))

    def emptied(self, state, lost):
        count = len(self.names)
        line = tuple(() if lost(*divmod(link, count)) else queue for link, queue in enumerate(state.line))
        return state._replace(line=line)

    def run(self, *, limit=None, settle_every=0, seconds=None, say=None):
        """Visit all states, or so many, and return their number."""
        first = self.start()
        seen, frontier, count, began = {hash(first)}, [first], 1, time.monotonic()
        depth = 0
        while frontier:
            depth += 1
            following = []
            for state in frontier:
                for after in self.following(state):
                    if after is None:
                        continue
                    key = hash(after)
                    if key not in seen:
                        seen.add(key)
                        count += 1
                        following.append(after)
                        if settle_every and count % settle_every == 0:
                            self.settle(after)
                        if limit is not None and count >= limit:
                            return count
                if seconds is not None and time.monotonic() - began > seconds:
                    return count
            frontier = following
            if say is not None:
                say(f"depth {depth}: {count:,} states, {len(self.machines.things):,} of one agent")
        return count

    def settle(self, state):
        """Let no more faults come, and see that all who are connected and enough become equal in bounded time."""
        state = self.calmed(state)
        machines = [self.machines.things[number] for number in state.agents if number >= 0]
        if len(machines) >= self.majority:
            ends = {(each.state.begun, each.term, each.log.position, each.replica.value) for each in machines}
            if len(ends) != 1 or not machines[0].state.begun:
                raise Violation(f"the agents do not become equal: {sorted(map(str, ends))}")

    def calmed(self, state):
        """Return where all come to if no more faults come."""
        state = state._replace(cut=-1)
        for around in range(16):
            for index, number in enumerate(state.agents):
                if number >= 0 and (view := self.view(state, index)) != self.sees(number):
                    state = self.after(state, index, "members", view) or state
            for _ in range(24):
                links = [link for link, queue in enumerate(state.line) if queue]
                for link in links:
                    queue = state.line[link]
                    state = self.replaced(state, link, queue[1:])
                    state = self.after(state, link % len(self.names), "receive", queue[0]) or state
                if not links:
                    break
            for index, number in enumerate(state.agents):
                if number < 0:
                    continue
                for timer in sorted(self.machines.things[number].state.timers):
                    allowed = {"patience": 3, "call": 6 + index}.get(timer, 0) <= around
                    if allowed and timer in self.machines.things[state.agents[index]].state.timers:
                        state = self.after(state, index, timer) or state
        return state


def main(*names):
    """Search the spaces of these names, or all, and return the exit status."""
    gc.disable()  # nothing is given back before the end
    for name in names or SPACES:
        search = Search(SPACES[name])
        began = time.monotonic()
        count = search.run(say=lambda text: print(text, flush=True), settle_every=20)
        print(f"{name}: {count:,} states, {search.cut_off} cut off, {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
