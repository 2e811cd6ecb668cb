"""Forged messages: what agents of a team really send, changed at random and sent in their name, on every key.

``python -m team.forgery COUNT [SEED]`` sends so many to teams of each mode, and prints what they did to them.
"""

from __future__ import annotations

import asyncio
import random
import struct
import sys
from collections import Counter

import msgspec
from team_robots import over_beliefs, started
from teams import team as random_team

from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

NAMES = ("a", "b", "c")
MODES = ("replicated", "centralised", "communicating")
LEASE = 1.0
OFTEN = 0.05
TOGETHER = 400
"""Forged messages of one team, in a minute and more of its time."""

NUMBERS = (-(2**63), -1, 0, 1, 2, 3, 64, 2**31, 2**62, 2**63 - 1, 2**64 - 1)
TEXTS = ("", "a", "b", "c", "start", "stop", "x" * 300, "\x00", "mallory")
HEAD = struct.Struct("<2sH?QB")
TAIL = struct.Struct("<Qq")


class Tapped(Network):
    """A network whose messages a forger hears."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.heard = {}

    def send(self, sender, receiver, deliver):
        if getattr(deliver, "func", None) == receiver.arrive:
            key, data = deliver.args
            self.heard.setdefault(key, []).append(data)
            del self.heard[key][:-50]
        super().send(sender, receiver, deliver)


class Forger:
    """Sends changed messages.

    Args:
        network: A tapped one, on which the agents are.
        seed: Of its chances.
    """

    def __init__(self, network, seed):
        self.network = network
        self.random = random.Random(seed)
        self.sent = 0

    def send(self):
        """Send one more, of any key and in any form, to one agent or to all."""
        chance = self.random
        key = chance.choice(sorted(self.network.heard))
        data = chance.choice(self.network.heard[key])
        owner = key.split("/")[2]
        receivers = self.network.others(owner)
        if chance.random() < 0.5:
            receivers = [chance.choice(receivers)]
        for receiver in receivers:
            receiver.arrive(key, self.forge(key, data, receiver))
        self.sent += 1

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
        last = receiver.router.unpacker._last.get(key)
        number = number if last is None else min(max(last.number, 0) + 1, 2**64 - 6)  # which is taken for the next
        if kind < 0.25:
            life = chance.choice([life, life + 1, 1, 0, 2**64 - 1])
            number = chance.choice([number, number + 5, 2**63, 2**64 - 1])
            time = chance.choice([time, *NUMBERS[:-1]])
        elif kind < 0.3:
            other = chance.choice(sorted(self.network.heard))
            body = chance.choice(self.network.heard[other])[start + TAIL.size :]
        else:
            body = self.change_body(body)
        return HEAD.pack(magic, version, step, life, length) + owner + TAIL.pack(number, time) + body

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


def attacked(mode, seed, count=TOGETHER):
    """Have a team be sent so many; return what is wrong afterwards, in sentences, and what its agents dropped."""
    wrong, dropped = [], Counter()

    async def main(runtime):
        network = Tapped(runtime.clock, seed=seed)
        team = Team("team", NAMES, mode=mode, period=OFTEN, lease=LEASE)
        build = over_beliefs(random_team(seed % 1000, agents=3))
        robots = await started(runtime, team, network, build, member=shares)
        await asyncio.sleep(2 * LEASE + 1)
        if not all(robot.did for robot in robots):
            wrong.append("something is wrong before")
        forger = Forger(network, seed)
        for _ in range(count):
            forger.send()
            await asyncio.sleep(forger.random.choice([0, 0, 0.001, 0.01, 0.1]))
        await asyncio.sleep(2 * LEASE)
        for robot in robots:
            dropped.update(robot.transport.statistics().dropped)
            if robot.ensemble.mode == "stopped" or robot.replica.still:
                robot.ensemble.start()  # somebody has said in an agent's name that it stops
        await asyncio.sleep(2 * LEASE)
        before = [len(robot.did) for robot in robots]
        await asyncio.sleep(2 * LEASE)
        for robot, had in zip(robots, before, strict=True):
            if robot.member.life != "running":
                wrong.append(f"{robot.name} has ended: {robot.faults[-1]}")
            elif len(robot.did) == had:
                causes = [str(cause) for cause in robot.ensemble.causes]
                wrong.append(f"{robot.name} does nothing more: {robot.ensemble.mode} {causes} {robot.faults[-1]}")

    try:
        run_virtual(main)
    except Exception as error:  # the whole runtime has ended
        wrong.append(f"an agent has ended: {error!r}")
    return wrong, dropped


def shares(name):
    """What each agent exports, and imports of the others."""
    return {"exports": ["joint/belief"], "imports": [f"{other}/joint/belief" for other in NAMES if other != name]}


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
