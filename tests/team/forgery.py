"""Forged messages: what agents of a team really send, changed at random and sent in their name, on every key.

Questions, answers and signs of life are forged as well. ``python -m team.forgery COUNT [SEED]`` sends so many to teams
of each mode, and prints what they did to them.
"""

from __future__ import annotations

import asyncio
import random
import struct
import sys
from bisect import bisect_right
from collections import Counter
from operator import itemgetter

import msgspec
from team_robots import Robot, over_beliefs, over_states
from teams import team as random_team

import mdm
from mdm.team.team import Team
from mdm.team.transport.network import Network, _Inquiry
from mdm.team.transport.router import Packer
from mdm.testing import run_virtual

MODES = ("replicated", "centralised", "communicating")
KINDS = ("observations", "states", "events")
LEASE = 1.0
OFTEN = 0.05
OLDEST = 10
STORM = 20_000
"""Messages in a second that agents never send, but where they answer each other without an end."""
TOGETHER = 400
"""Forged messages of one team, in a minute and more of its time."""

NUMBERS = (-(2**63), -1, 0, 1, 2, 3, 64, 2**31, 2**62, 2**63 - 1, 2**64 - 1)
TEXTS = ("", "a", "b", "c", "start", "stop", "hold", "reset", "resume", "begin", "x" * 300, "\x00", "mallory")
DEEP = b"\x91" * 5000 + b"\xc0"
"""Arrays within arrays."""
HEAD = struct.Struct("<2sH?QB")
TAIL = struct.Struct("<Qq")


class Tapped(Network):
    """A network whose messages a forger hears."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.heard = {}

        self.since = self.count = 0
        self.forge = None
        """Changes answers, while there is a forger."""

    def send(self, sender, receiver, deliver):
        now = self.clock.now()
        self.since, self.count = (self.since, self.count + 1) if now - self.since < 10**9 else (now, 1)
        if self.count > STORM:
            raise AssertionError(f"the agents send {STORM:,} messages in a second")
        function = getattr(deliver, "func", None)
        if function == receiver.arrive:
            key, data = deliver.args
            self.heard.setdefault(key, []).append(data)
            del self.heard[key][OLDEST : -5 * OLDEST]
        elif getattr(function, "__func__", None) is _Inquiry._receive and self.forge is not None:
            deliver = self.forge(sender, deliver)
        super().send(sender, receiver, deliver)


class Forger:
    """Sends changed messages.

    Args:
        network: A tapped one, on which the agents are.
        seed: Of its chances.
        names: In whose name it sends: of all agents, or with certificates of the one whose certificate it has.
    """

    def __init__(self, network, seed, names):
        self.network = network
        self.names = names
        self.random = random.Random(seed)
        self.asker = Packer("asker", 1, network.clock.now)

    def send(self):
        """Send one more, of any key and in any form, to one agent or to all."""
        kind = self.random.random()
        if kind < 0.85:
            self.put()
        elif kind < 0.97:
            self.ask()
        else:
            self.appear()

    def answer(self, sender, deliver):
        """Return in place of an answer on its way another one, at times."""
        if self.random.random() < 0.8 or sender not in self.names:
            return deliver
        key, data = deliver.args
        return type(deliver)(deliver.func, key, self.flip(data) if self.random.random() < 0.3 else self.reword(data))

    def ask(self):
        """Ask an agent what it answers, as whoever asks or as one of the team."""
        chance = self.random
        other = chance.choice(self.network.others(""))
        key = chance.choice(sorted(other.served()))
        question = self.asker.seal(
            chance.choice([b"", b"token", chance.randbytes(70), b"\x80", DEEP, b"\x93\x90\x90" + DEEP])
        )
        other.answer(key, self.flip(question) if chance.random() < 0.3 else question)

    def appear(self):
        """Have an agent see lives of others that there are not, for a moment."""
        chance, clock = self.random, self.network.clock
        receiver = chance.choice(self.network.others(""))
        false = {chance.choice([*self.names, "d"]): chance.choice([0, 1, 2, 2**62, 2**64 - 1])}
        receiver.see({**receiver.live, **false, receiver.agent: receiver.incarnation})
        clock.call_at(clock.now() + 10**8, receiver.look)

    def reword(self, data):
        """Return a message whose body was changed, as its owner would send it next."""
        start = HEAD.size + HEAD.unpack_from(data)[-1] + TAIL.size
        return data[:start] + self.change_body(data[start:])

    def put(self):
        """Put a message as an agent."""
        chance = self.random
        key = chance.choice(sorted(key for key in self.network.heard if key.split("/")[2] in self.names))
        data = chance.choice(self.network.heard[key])
        owner = key.split("/")[2]
        receivers = self.network.others(owner)
        if chance.random() < 0.5:
            receivers = [chance.choice(receivers)]
        for receiver in receivers:
            receiver.arrive(key, self.forge(key, data, receiver))

    def forge(self, key, data, receiver):
        """Return a message that was changed."""
        chance = self.random
        kind = chance.random()
        if kind < 0.1:
            return self.flip(data)
        if kind < 0.15:
            return data[: chance.randrange(len(data))] + chance.randbytes(chance.choice([0, 1, 8, 2000]))
        magic, version, step, life, length = HEAD.unpack_from(data)
        start = HEAD.size + length
        owner = data[HEAD.size : start]
        number, time = TAIL.unpack_from(data, start)
        body = data[start + TAIL.size :]
        last = receiver.unpacker._last.get(key)
        number = number if last is None else min(max(last.number, 0) + 1, 2**64 - 6)  # which is taken for the next
        if kind < 0.25:
            life = chance.choice([life, life + 1, 1, 0, 2**64 - 1])
            number = chance.choice([number, number + 5, 2**63, 2**64 - 1])
            time = chance.choice([time, *NUMBERS[:-1]])
        elif kind < 0.27 and body and 0x90 <= body[0] < 0x9F:
            body = bytes([body[0] + 1]) + body[1:] + DEEP
        elif kind < 0.28:
            body = DEEP
        elif kind < 0.4:
            body = self.splice(body, chance.choice(self.network.heard[key])[start + TAIL.size :])
        elif kind < 0.45:
            other = chance.choice(sorted(self.network.heard))
            body = chance.choice(self.network.heard[other])[start + TAIL.size :]
        else:
            body = self.change_body(body)
        return HEAD.pack(magic, version, step, life, length) + owner + TAIL.pack(number, time) + body

    def splice(self, one, other):
        """Return a body of which a field is that of another message under the same key, or all are: an old one."""
        try:
            one, other = msgspec.msgpack.decode(one), msgspec.msgpack.decode(other)
        except (msgspec.MsgspecError, ValueError):
            return other
        if isinstance(one, list) and isinstance(other, list) and one and len(one) == len(other):
            place = self.random.randrange(len(one))
            other = self.random.choice([other, [*one[:place], other[place], *one[place + 1 :]]])
        return msgspec.msgpack.encode(other)

    def flip(self, data):
        changed = bytearray(data)
        for _ in range(self.random.choice([1, 1, 2, 8])):
            changed[self.random.randrange(len(changed))] ^= 1 << self.random.randrange(8)
        return bytes(changed)

    def change_body(self, body):
        try:
            value = msgspec.msgpack.decode(body)
        except (msgspec.MsgspecError, ValueError):
            return self.flip(body) if body else b"\x00"
        for _ in range(self.random.choice([1, 1, 1, 2, 4])):
            value = self.change(value)
        try:
            return msgspec.msgpack.encode(value)
        except (msgspec.MsgspecError, OverflowError, TypeError, ValueError):
            return body

    def change(self, value):
        """Change one leaf of a value, or its form."""
        chance = self.random
        if isinstance(value, list) and value and chance.random() < 0.9:
            place = chance.randrange(len(value))
            return [*value[:place], self.change(value[place]), *value[place + 1 :]]
        if isinstance(value, dict) and value and chance.random() < 0.9:
            key = chance.choice(list(value))
            if chance.random() < 0.2:
                return {(self.change(k) if k == key else k): v for k, v in value.items() if not isinstance(k, list)}
            return {k: self.change(v) if k == key else v for k, v in value.items()}
        if isinstance(value, bool):
            return not value
        if isinstance(value, int):
            return chance.choice([*NUMBERS, value + 1, value - 1, value + 100, value + 2**20, value ^ 1])
        if isinstance(value, str):
            return chance.choice(TEXTS)
        if isinstance(value, bytes):
            return self.change_body(value) if chance.random() < 0.7 else self.flip(value) if value else b"\xff"
        if isinstance(value, list):
            return chance.choice([[], value * 2, value * 200, None])
        return chance.choice([None, 0, -1, "", [], {}, b"", 1.5, float("nan"), 1e308])


class Watched(Robot):
    """A robot that keeps when it began its actions."""

    def __init__(self, *args, **options):
        self.began = []
        super().__init__(*args, **options)

    def act(self, name):
        begin = super().act(name)

        def act():
            self.began.append((self.runtime.clock.now(), name))
            begin()

        return act


def undecided(robots, deciding):
    """Return in sentences the actions that were begun without being what any of those who decide had decided last."""
    told = [[(commit.time, commit.action.split()) for commit in robot.commits if commit.action] for robot in deciding]
    wrong = []
    for place, robot in enumerate(robots):
        for time, name in robot.began:
            until = [bisect_right(steps, time, key=itemgetter(0)) for steps in told]
            last = [step for steps, end in zip(told, until, strict=True) for step in steps[max(end - 2, 0) : end]]
            if all(action[place] != name for _, action in last):
                wrong.append(f"{robot.name} began {name!r} at {time / 1e9:.3f} s, which nobody had decided")
    return wrong


def with_predicates(robot, agent, **options):
    """A robot of `rooms` that also uses a predicate of the other one."""
    ensemble = over_states(robot, agent, **options)
    ensemble.predicates.define("Alone", ~mdm.P(f"{'ba'[agent]}/InLab"))
    return ensemble


def attacked(mode, seed, count=TOGETHER):
    """Have a team be sent so many; return what is wrong afterwards, in sentences, and what its agents dropped.

    Every other team has certificates: what is forged is then of one of its agents alone.
    """
    kind = "observations" if mode == "communicating" else KINDS[seed // 3 % 3]
    names = ("a", "b") if kind == "states" else ("a", "b", "c")
    liar = names[seed // 18 % len(names)] if seed // 9 % 2 else None
    wrong, dropped = [], Counter()

    async def main(runtime):
        network = Tapped(runtime.clock, seed=seed)
        team = Team("team", names, mode=mode, period=None if kind == "events" else OFTEN, lease=LEASE)
        build = with_predicates if kind == "states" else over_beliefs(random_team(seed % 1000, agents=3))
        robots = [Watched(team, name, network, build, member=lambda name: shares(name, names)) for name in names]
        for robot in robots:
            await robot.start(runtime)
        living = asyncio.create_task(live(robots, kind, random.Random(seed)))
        await asyncio.sleep(2 * LEASE + 1)
        if not all(robot.did for robot in robots):
            wrong.append("something is wrong before")
        forger = Forger(network, seed, names if liar is None else [liar])
        network.forge = forger.answer
        for _ in range(count):
            forger.send()
            await asyncio.sleep(forger.random.choice([0, 0, 0.001, 0.01, 0.1]))
        network.forge = None
        await asyncio.sleep(2 * LEASE)
        wrong.extend(await standing(robots, "two leases later"))
        for robot in robots:
            dropped.update(robot.transport.statistics().dropped)
            if robot.ensemble.mode == "stopped":  # somebody has said in an agent's name that it stops
                robot.ensemble.start()
        await asyncio.sleep(2 * LEASE)
        wrong.extend(await standing(robots, "two leases after a start", started=True))
        others = mode == "centralised" and liar not in {None, "a"}
        wrong.extend(undecided(robots, robots[:1] if others else robots))
        living.cancel()

    try:
        run_virtual(main)
    except Exception as error:  # the whole runtime has ended
        wrong.append(f"an agent has ended: {error!r}")
    return wrong, dropped


async def live(robots, kind, chance):
    """Have robots see something all the time."""
    while True:
        robot = chance.choice(robots)
        if kind == "states":
            robot.lab.set(chance.random() < 0.5)
        else:
            seen = [None] * len(robots)
            seen[robots.index(robot)] = chance.randrange(2)
            robot.observe(*seen)
        await asyncio.sleep(0.02)


async def standing(robots, when, *, started=False):
    """Return in sentences who has ended, or takes no steps in half a lease; a stopped one need not before a start."""
    before = [(len(robot.did), len(robot.commits)) for robot in robots]
    await asyncio.sleep(LEASE / 2)
    wrong = []
    for robot, (done, steps) in zip(robots, before, strict=True):
        stands = f"{robot.ensemble.mode} {[*map(str, robot.ensemble.causes)]}, {robot.replica.statistics()}"
        if robot.member.life != "running":
            wrong.append(f"{robot.name} has ended: {robot.faults[-1]}")
        elif robot.ensemble.mode == "stopped" and not started:
            continue
        elif len(robot.commits) == steps:
            wrong.append(f"{when} {robot.name} takes no steps: {stands}")
        elif len(robot.did) == done:
            wrong.append(f"{when} {robot.name} does nothing: {stands}")
    return wrong


def shares(name, names):
    """What each agent exports, and imports of the others."""
    channel = "belief" if len(names) == 3 else "action"
    return {
        "exports": [f"joint/{channel}"],
        "imports": [f"{other}/joint/{channel}" for other in names if other != name],
    }


def main(count, first=0):
    """Attack team after team, and return how many were harmed."""
    harmed = 0
    for number, seed in enumerate(range(first, first + -(-count // TOGETHER))):
        mode = MODES[seed % 3]
        wrong, _ = attacked(mode, seed)
        if wrong:
            harmed += 1
            print(f"seed {seed}, {mode}:", *wrong, sep="\n  ", flush=True)
        if (number + 1) % 25 == 0:
            print(f"{(number + 1) * TOGETHER:,} messages, {harmed} of {number + 1} teams harmed", flush=True)
    return harmed


if __name__ == "__main__":
    sys.exit(1 if main(*map(int, sys.argv[1:])) else 0)
