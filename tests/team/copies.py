"""What agreement promises, checked from outside: copies that steps are applied to, and an oracle that sees them all."""

from __future__ import annotations

from zlib import crc32

from mdm.team.agreement.messages import START, Component, Position, encode


class Violation(AssertionError):
    """A promise that was not kept."""


class Copy:
    """A replica whose value is a hash of all steps that were applied to it."""

    def __init__(self, agent, oracle):
        self.agent, self.oracle = agent, oracle
        self.position, self.value = START, 0
        self.running, self.started = False, ""

    def apply(self, commit):
        body = encode(commit)
        self.oracle.applies(self, commit, body)
        self.position = Position(commit.term, commit.step)
        self.value = crc32(body, self.value)
        if commit.command in {"start", "stop"}:
            self.running, self.started = commit.command == "start", commit.token

    def digest(self):
        return str(self.value)

    def snapshot(self):
        term, step = self.position.term, self.position.step
        return repr((term.number, term.leader, term.incarnation, self.running, self.started, step, self.value)).encode()

    def restore(self, snapshot):
        *term, self.running, self.started, step, value = eval(snapshot)
        self.position = Position(type(START.term)(*term), step)
        self.value = value
        self.oracle.restores(self)


class Oracle:
    """Sees every step at every agent.

    Args:
        agents: All agents.
        majority: How many must have applied a step before the next; None: any.
    """

    def __init__(self, agents, majority):
        self.agents, self.majority = agents, majority
        self.machines = {}
        self.bodies = {}  # what each (term, step) is
        self.previous = {}  # the position before each
        self.values = {START: 0}  # the value of a copy there
        self.holders = {START: frozenset(agents)}  # who has ever been there
        self.bases = {}  # where each term began
        self.forgetful = False  # whether an agent has been restarted
        self.said = {}  # the components that agents sent for each (term, step)
        self.terms = []  # the term in which each command was asked for, in the order of asking
        self.stopped = {}  # by agent, which of them was the last stop that it has taken, until it may act
        self.settled = frozenset()  # positions that were followed by another step, and its term

    def applies(self, copy, commit, body):
        position, machine = Position(commit.term, commit.step), self.machines[copy.agent]
        before = Position(commit.previous, commit.step - 1)
        if before != copy.position:
            raise Violation(f"{copy.agent} applies {commit.term}:{commit.step} at {copy.position}")
        if self.bodies.setdefault(position, body) != body:
            raise Violation(f"{copy.agent} applies another {position} than another agent")
        self.previous[position] = before
        if commit.term > machine.term:
            raise Violation(f"{copy.agent} applies a step of {commit.term} in {machine.term}")
        if machine.state.begun and commit.term < machine.term and not self.on_history(machine.term, position):
            raise Violation(f"{copy.agent} applies a step of {commit.term} in {machine.term}")
        if self.majority and commit.term.leader == copy.agent and position not in self.holders:
            if len(self.holders.get(before, ())) < self.majority:
                raise Violation(f"{copy.agent} goes on from {before}, which no majority has")
            self.settled |= {(before, commit.term)}
        for agent, component in commit.inputs.items():
            if agent != commit.term.leader and component not in self.said.get((position, agent), ()):
                raise Violation(f"{position} has a component of {agent} that was not for it")
        if commit.command is not None:
            self.applies_command(copy, commit)
        value = crc32(body, copy.value)
        if self.values.setdefault(position, value) != value:
            raise Violation(f"{copy.agent} has another copy at {position}")
        self.holders[position] = self.holders.get(position, frozenset()) | {copy.agent}

    def asked(self, machine, command):
        """Take note of what is asked of an agent; return the token, which is the place in the order of asking."""
        self.terms.append(machine.term)
        if command == "stop":
            self.stopped[machine.agent] = len(self.terms)
        return str(len(self.terms))

    def applies_command(self, copy, commit):
        if not commit.token.isdigit():
            return
        number = int(commit.token)
        if commit.command == "stop":
            self.stopped[copy.agent] = max(self.stopped.get(copy.agent, 0), number)
        if commit.command != "hold" and self.terms[number - 1] != commit.term:
            raise Violation(f"what was asked for in {self.terms[number - 1]} is a step of {commit.term}")

    def acts(self, machine):
        """See that an agent which acts does so on a start that was asked for after the last stop that it has taken."""
        stopped = self.stopped.get(machine.agent)
        if stopped is not None and machine.replica.running and not machine.hold.still:
            if int(machine.replica.started) < stopped:
                raise Violation(f"{machine.agent} was stopped, and acts on a start that was asked for before")
            del self.stopped[machine.agent]

    def restores(self, copy):
        self.holders[copy.position] = self.holders.get(copy.position, frozenset()) | {copy.agent}

    def on_history(self, term, position):
        """Return whether a position is in the history that a term went on from."""
        at = self.bases.get(term, START)
        while at.step > position.step:
            at = self.previous[at]
        return at == position

    def hears(self, agent, message):
        """Take note of what an agent sends."""
        if type(message) is Component:
            key = Position(message.term, message.step), agent
            self.said[key] = self.said.get(key, frozenset()) | {message.body}

    def looks(self, machine):
        """Look at an agent after an event."""
        for kind, text in machine.reports:
            if kind == "digest":
                raise Violation(text)
        if machine.state.role == "leading" and machine.term not in self.bases:
            self.begins(machine)

    def begins(self, machine):
        at = machine.log.position
        while at.term == machine.term:
            at = self.previous[at]
        self.bases[machine.term] = at
        if self.majority and len(machine.state.ballot.joined) < self.majority:
            raise Violation(f"{machine.agent} begins {machine.term} without a majority")
        if self.majority and not self.forgetful:
            for position, term in self.settled:
                if term < machine.term and not self.on_history(machine.term, position):
                    raise Violation(f"{machine.agent} begins {machine.term} at {at}, without {position}")


def component(agent, term, step):
    """Return what an agent says to a step."""
    return f"{agent}{term.number}.{step}".encode()


class Witness:
    """Writes down what one agent applies within one event.

    Args:
        event_driven: Whether an event that a step went without counts for a later one.
    """

    def __init__(self, *, event_driven):
        self.event_driven = event_driven
        self.applied = []
        self.machine = None

    def applies(self, copy, commit, encoded):
        if Position(commit.previous, commit.step - 1) != copy.position:
            raise Violation(f"{copy.agent} applies {commit.term}:{commit.step} at {copy.position}")
        if commit.term > self.machine.term:
            raise Violation(f"{copy.agent} applies a step of {commit.term} in {self.machine.term}")
        for agent, body in commit.inputs.items():
            if not self.event_driven and body != component(agent, commit.term, commit.step):
                raise Violation(f"step {commit.term}:{commit.step} has {body}, which was not for it")
        older = self.machine.term if self.machine.state.begun and commit.term < self.machine.term else None
        self.applied.append((commit, encoded, copy.value, older))

    def restores(self, copy):
        pass
