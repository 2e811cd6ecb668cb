"""A team that agrees on steps, driven by hand: messages wait in lines until a test delivers or loses them."""

from __future__ import annotations

from collections import deque

from team.copies import Copy, Oracle

from mdm.team.agreement import Agreement, decode, encode

RETRY, DEADLINE, PATIENCE = 10, 30, 100


class Lockstep:
    """Agents ``a``, ``b``, … and the messages between them, in a time that only tests move."""

    def __init__(self, count, machine=Agreement, *, start=True, **options):
        self.names = [chr(ord("a") + index) for index in range(count)]
        self.options = {"mode": "majority", "event_driven": False, "log_size": 256} | options
        self.oracle = Oracle(self.names, count // 2 + 1 if self.options["mode"] == "majority" else None)
        self.kind = machine
        self.machines, self.line, self.now, self.lives = {}, deque(), 0, 0
        self.cut = set()
        self.watched = True
        if start:
            for name in self.names:
                self.start(name)
            self.see()
            self.deliver()

    def __getitem__(self, name):
        return self.machines[name]

    def start(self, name):
        """Start an agent, in a new life."""
        self.lives += 1
        self.machines[name] = self.oracle.machines[name] = self.kind(
            name,
            self.names,
            Copy(name, self.oracle),
            incarnation=self.lives,
            deadline_ns=DEADLINE,
            retry_ns=RETRY,
            patience_ns=PATIENCE,
            **self.options,
        )

    def crash(self, name):
        del self.machines[name]

    def see(self, *views):
        """Have each agent see those of its view, or all."""
        for name, machine in self.machines.items():
            seen = next((view for view in views if name in view), self.names if not views else None)
            if seen is not None:
                live = {other: self[other].incarnation for other in seen if other in self.machines}
                self.took(name, machine.members(live, self.now))

    def took(self, name, sends):
        for send in sends:
            self.oracle.hears(name, send.message)
            for target in self.names if send.to is None else (send.to,):
                if target != name:
                    self.line.append((name, self[name].incarnation, target, encode(send.message)))

        if self.watched:
            self.oracle.looks(self[name])

    def propose(self, name, component=None, command=None):
        self.took(name, self[name].propose(component, self.now, command))

    def deliver(self, *, losing=lambda sender, target, message: False):
        """Deliver all that waits, and what that brings about."""
        while self.line:
            self.one(losing)

    def one(self, losing=lambda sender, target, message: False):
        sender, life, target, body = self.line.popleft()
        message = decode(body)
        if target in self.machines and (sender, target) not in self.cut and not losing(sender, target, message):
            self.took(target, self[target].receive(sender, life, message, self.now))

    def wait(self, time, **options):
        """Let time pass, with all that it brings about."""
        end = self.now + time
        while True:
            self.deliver(**options)
            due = [machine.next_time for machine in self.machines.values() if machine.next_time is not None]
            if not due or min(due) > end:
                break
            self.now = max(self.now, min(due))
            for name, machine in list(self.machines.items()):
                self.took(name, machine.tick(self.now))
        self.now = end

    def divide(self, *sides):
        """Cut the links between sides, and have everyone see it."""
        self.cut = {(one, other) for side in sides for one in side for other in self.names if other not in side}
        self.see(*sides)

    def heal(self):
        self.cut = set()
        self.see()

    def step(self, **components):
        """Have agents propose components, and deliver what follows."""
        for name, component in components.items():
            self.propose(name, component)
        self.deliver()

    @property
    def steps(self):
        return [machine.step for machine in self.machines.values()]

    @property
    def roles(self):
        return [machine.role for machine in self.machines.values()]

    @property
    def equal(self):
        return len({machine.replica.digest() for machine in self.machines.values()}) == 1
