"""Random schedules of agents that agree on steps: ``python -m team.schedules COUNT [FIRST]``.

Everything is drawn from the seed: how many agents, the mode, the drive, what the network does to messages, clocks, and
who crashes, hangs, returns or is cut off when. Time is virtual. At the end all is healed, and all must be equal.
"""

from __future__ import annotations

import heapq
import multiprocessing
import sys
import time
from random import Random

from team.copies import Copy, Oracle, Violation

from mdm.team.agreement import Agreement
from mdm.team.agreement.messages import START, decode, encode

MILLISECOND = 1_000_000

CALM = 400 * MILLISECOND
"""When nothing goes wrong any more, and everybody sees something at each time."""

SHOWN = 10
"""Seeds with violations that are printed."""


class Node:
    """One agent: its process, its clock and its links."""

    def __init__(self, name, index, random):
        self.name, self.index = name, index
        self.life = 0
        self.machine = None
        self.standstill = None
        self.paused = False
        self.waiting = []
        self.timer = None
        self.term, self.step = START.term, 0
        self.offset, self.rate = random.randrange(10**12), random.choice([1.0, 1.0, 0.9, 1.1])

    def clock(self, now):
        return self.offset + int(now * self.rate)

    def when(self, local):
        return int((local - self.offset) / self.rate) + 1


class Schedule:
    """One run, drawn from a seed."""

    def __init__(self, seed, machine=Agreement, **fixed):
        self.random = random = Random(seed)
        draw = {
            "agents": random.choice([2, 2, 3, 3, 3, 4, 5]),
            "mode": random.choice(["majority", "majority", "continue"]),
            "event_driven": random.random() < 0.5,
            "loss": random.choice([0, 0, 0.05, 0.3]),
            "duplication": random.choice([0, 0.1]),
            "delay": random.choice([1, 5, 20]),
            "faults": random.randrange(5),
            "restarts": True,
            "encoded": random.random() < 0.02,
            "divided": random.random() < 0.25,
            "commands": random.choice([0.02, 0.02, 0.3]),
            "log_size": random.choice([1, 4, 256]),
            "keeps": seed % 4 > 0,  # whether a stop outlives the process of an agent
        } | fixed
        self.__dict__.update(draw)
        self.kind = machine
        self.names = [f"r{number}" for number in range(self.agents)]
        self.oracle = Oracle(self.names, self.agents // 2 + 1 if self.mode == "majority" else None)
        self.nodes = {name: Node(name, index, random) for index, name in enumerate(self.names)}
        self.blocked = set()
        self.unseen = set()
        self.queue, self.serial = [], 0
        self.now = 0
        self.period, self.lease = 20 * MILLISECOND, random.choice([5, 50, 100]) * MILLISECOND
        self.lives = 0
        self.proposing = True
        self.alone = {}
        self.joins = 0

    # -- Time and messages ---------------------------------------------------------------------------------------

    def after(self, delay, do, *args):
        self.serial += 1
        heapq.heappush(self.queue, (self.now + delay, self.serial, do, args))

    def until(self, end):
        queue = self.queue
        while queue and queue[0][0] <= end:
            self.now, _, do, args = heapq.heappop(queue)
            do(*args)
        self.now = end

    def took(self, node, sends):
        """Carry what an agent says to an event, and look at it."""
        machine = node.machine
        for send in sends:
            self.oracle.hears(node.name, send.message)
            message = encode(send.message) if self.encoded else send.message
            for target in self.names if send.to is None else (send.to,):
                if target != node.name:
                    self.carry(node, target, message)
        if machine.term < node.term:
            raise Violation(f"{node.name} goes back from {node.term} to {machine.term}")
        self.oracle.looks(machine)
        self.oracle.acts(machine)
        if machine.state.role == "leading" and machine.step > node.step and self.oracle.majority:
            self.count_alone(node)
        node.term, node.step = machine.term, machine.step
        due = machine.next_time
        if due is not None and due != node.timer:
            node.timer = due
            self.after(max(0, node.when(due) - self.now), self.fire, node, machine, due)

    def carry(self, node, target, message):
        random = self.random
        for _ in range(2 if random.random() < self.duplication else 1):
            if (node.name, target) not in self.blocked and random.random() >= self.loss:
                delay = random.randrange(1, self.delay * MILLISECOND)
                self.after(delay, self.deliver, node.name, node.life, target, message)

    def deliver(self, sender, life, target, message):
        node = self.nodes[target]
        if node.paused:
            node.waiting.append((sender, life, target, message))
        elif node.machine is not None and (sender, target) not in self.blocked:
            message = decode(message) if self.encoded else message
            self.took(node, node.machine.receive(sender, life, message, node.clock(self.now)))

    def fire(self, node, machine, due):
        if node.machine is machine and node.timer == due:
            node.timer = None
            if node.paused:
                node.waiting.append(None)
            else:
                self.took(node, node.machine.tick(node.clock(self.now)))

    def propose(self, node, machine):
        if node.machine is not machine or not self.proposing:
            return
        random = self.random
        if not node.paused:
            command = random.choice(["start", "stop", "reset"]) if random.random() < self.commands else None
            self.serial += 1
            body = None if random.random() < 0.1 and self.now < CALM else b"%d" % self.serial
            token = None if command is None else self.oracle.asked(machine, command)
            self.took(node, machine.propose(body, node.clock(self.now), command, token))
        wait = random.randrange(1, 4 * self.period) if self.event_driven else int(self.period / node.rate)
        self.after(wait, self.propose, node, machine)

    # -- Who sees whom -------------------------------------------------------------------------------------------

    def connected(self, one, other):
        if one == other:
            return True
        a, b = self.nodes[one], self.nodes[other]
        hidden = self.blocked | self.unseen
        return (
            a.machine is not None
            and b.machine is not None
            and not a.paused
            and not b.paused
            and (one, other) not in hidden
            and (other, one) not in hidden
        )

    def look(self, node):
        if node.machine is not None and not node.paused:
            live = {name: self.nodes[name].life for name in self.names if self.connected(node.name, name)}
            if live != node.machine.state.live:
                self.took(node, node.machine.members(live, node.clock(self.now)))

    def change(self, *, joins=False):
        """Have everybody see sooner or later what has changed."""
        self.joins += joins
        for node in self.nodes.values():
            self.after(self.random.randrange(self.lease), self.look, node)

    def count_alone(self, node):
        side = sum(self.connected(node.name, name) for name in self.names)
        if side < self.oracle.majority:
            key = node.name, node.life, self.joins
            self.alone[key] = self.alone.get(key, 0) + 1
            if self.alone[key] > 1 and not self.unseen:
                raise Violation(f"{node.name} goes on without a majority")

    # -- What goes wrong -----------------------------------------------------------------------------------------

    def start(self, name):
        node = self.nodes[name]
        if node.machine is not None:
            return
        self.lives += 1
        node.life, node.timer, node.paused, node.waiting = self.lives, None, False, []
        node.term, node.step = START.term, 0
        node.machine = self.kind(
            name,
            self.names,
            Copy(name, self.oracle),
            incarnation=node.life,
            mode=self.mode,
            event_driven=self.event_driven,
            deadline_ns=3 * self.delay * MILLISECOND,
            retry_ns=2 * self.delay * MILLISECOND + MILLISECOND,
            log_size=self.log_size,
        )
        if node.standstill is not None:
            node.machine.hold.recall(node.standstill)
        self.oracle.machines[name] = node.machine
        self.after(self.random.randrange(self.period), self.propose, node, node.machine)
        self.change(joins=True)

    def crash(self, name):
        node = self.nodes[name]
        if node.machine is not None and self.restarts:
            node.standstill = node.machine.hold.standstill if self.keeps else None
            node.machine, node.paused = None, False
            if not self.keeps:
                self.oracle.stopped.pop(name, None)  # a process that ends forgets
            self.oracle.forgetful = True
            self.change()

    def pause(self, name):
        self.nodes[name].paused = self.nodes[name].machine is not None
        self.change()

    def resume(self, name):
        node = self.nodes[name]
        if node.paused:
            node.paused = False
            for held in node.waiting:
                if held is None:
                    self.took(node, node.machine.tick(node.clock(self.now)))
                else:
                    self.deliver(*held)
            node.waiting = []
            self.change(joins=True)

    def block(self, pairs):
        self.blocked |= pairs
        self.change()

    def unblock(self, pairs):
        self.blocked -= pairs
        self.change(joins=True)

    def hide(self, pairs):
        self.unseen |= pairs
        self.change()

    def show(self, pairs):
        self.unseen -= pairs
        self.change(joins=True)

    def fault(self):
        """Draw something that goes wrong, and when it ends."""
        random = self.random
        begin, end = random.randrange(250) * MILLISECOND, random.randrange(1, 200) * MILLISECOND
        kind = random.choice(["crash", "crash", "pause", "partition", "partition", "link", "one way", "flap"])
        name, other = random.sample(self.names, 2)
        side = set(random.sample(self.names, random.randrange(1, self.agents)))
        if kind == "crash":
            pair = (self.crash, self.start, name)
        elif kind == "pause":
            pair = (self.pause, self.resume, name)
        elif kind == "partition":
            cut = {(a, b) for a in self.names for b in self.names if (a in side) != (b in side)}
            pair = (self.block, self.unblock, cut)
        elif kind == "flap":
            pair = (self.hide, self.show, {(name, other)})
        else:
            pair = (self.block, self.unblock, {(name, other)} | ({(other, name)} if kind == "link" else set()))
        self.after(begin, pair[0], pair[2])
        self.after(begin + end, pair[1], pair[2])

    # -- The run -------------------------------------------------------------------------------------------------

    def run(self):
        """Run to the end, and raise what is violated."""
        for name in self.names:
            self.after(self.random.randrange(50) * MILLISECOND, self.start, name)
        for _ in range(self.faults):
            self.fault()
        self.until(CALM)
        self.heal()
        if self.divided:
            side = set(self.random.sample(self.names, self.random.randrange(1, self.agents)))
            cut = {(a, b) for a in self.names for b in self.names if (a in side) != (b in side)}
            self.block(cut)
            self.settle(
                [name for name in self.names if name in side], [name for name in self.names if name not in side]
            )
            self.unblock(cut)
        self.settle(self.names)
        return self

    def settle(self, *sides):
        """Let nothing happen but steps, and see that each side has come to one history, or waits."""
        machines = {name: self.nodes[name].machine for name in self.names}
        first = machines[self.names[0]]
        self.proposing = False
        self.until(self.now + 2 * self.lease + (self.agents + 3) * first.patience)
        steps = {name: machine.step for name, machine in machines.items()}
        self.proposing = True
        for node in self.nodes.values():
            self.after(self.random.randrange(self.period), self.propose, node, node.machine)
        self.until(self.now + 4 * self.period + 8 * first.deadline)
        self.proposing = False
        self.until(self.now + 40 * first.retry)
        for side in sides:
            self.check(side, {name: machines[name] for name in side}, steps)

    def check(self, side, machines, steps):
        roles = [machine.role for machine in machines.values()]
        places = {(machine.term, machine.log.position, machine.replica.digest()) for machine in machines.values()}
        moved = {machine.step > steps[name] for name, machine in machines.items()}
        if self.oracle.majority and len(side) < self.oracle.majority:
            if {*roles} != {"waiting"} or moved != {False}:
                raise Violation(f"{side}, too few, are {roles} at {places}")
        elif {*roles} - {"leading", "following"} or roles.count("leading") != 1:
            raise Violation(f"{side} are {roles}")
        elif len(places) != 1:
            raise Violation(f"{side} are at {places}")
        elif moved != {True}:
            raise Violation(f"{side} stay where they are: {steps}")

    def heal(self):
        self.blocked, self.unseen, self.loss = set(), set(), 0
        faults = {self.crash, self.start, self.pause, self.resume, self.block, self.unblock, self.hide, self.show}
        self.queue = [event for event in self.queue if event[2] not in faults]
        heapq.heapify(self.queue)
        for name in self.names:
            self.start(name)
            self.resume(name)
        self.change()


def violation(seed, **options):
    """Return the seed, and what is violated with it."""
    try:
        Schedule(seed, **options).run()
    except Violation as found:
        return seed, str(found)
    return seed, None


def main(count, first=0):
    """Run the schedules of so many seeds in two processes, and return the exit status."""
    found, began = 0, time.monotonic()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for done, (seed, wrong) in enumerate(pool.imap_unordered(violation, range(first, first + count), 100), 1):
            if wrong is not None:
                found += 1
                if found <= SHOWN:
                    print(f"seed {seed}: {wrong}", flush=True)
            if done % 5000 == 0 or done == count:
                print(f"{done:,} schedules, {found:,} violate: {time.monotonic() - began:.0f} s", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
