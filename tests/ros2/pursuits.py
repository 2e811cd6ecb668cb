"""Random goals and pre-emptions against a real server of an action: never two are live, and each end is told rightly.

A robot decides by a topic which of three goals it pursues, or none. The server answers late, rejects, brakes for long,
aborts, and succeeds in the middle of a cancellation, all by a seed. ``python -m ros2.pursuits 1000`` pursues so many.
"""

from __future__ import annotations

import asyncio
import random
import sys
import tempfile
from pathlib import Path

from ros2.environment import interpreter, programs, where_possible

SYSTEM = """
[ros2]
node = "mover"

[predicates]
Rest = { topic = "/wanted", type = "std_msgs/msg/Int32", when = "data == 0" }
A = { topic = "/wanted", type = "std_msgs/msg/Int32", when = "data == 1" }
B = { topic = "/wanted", type = "std_msgs/msg/Int32", when = "data == 2" }
C = { topic = "/wanted", type = "std_msgs/msg/Int32", when = "data == 3" }

[ensembles.mover]
policy = [0, 1, 2, 3]
states.wanted = { predicates = { rest = "Rest", a = "A", b = "B", c = "C" }, on_violation = "hold" }

[ensembles.mover.actions]
0 = "moves:rest"
1 = { action = "/move", type = "test_msgs/action/Fibonacci", goal = "moves:goal" }
2 = { action = "/move", type = "test_msgs/action/Fibonacci", goal = "moves:goal" }
3 = { action = "/move", type = "test_msgs/action/Fibonacci", goal = "moves:goal" }
"""

MOVES = """
import json

made = 0


def rest():
    pass


def goal(action):
    global made
    made += 1
    print(json.dumps({"made": made}), flush=True)
    return {"order": made}
"""

WANTED = {"publish": "/wanted", "type": "std_msgs/msg/Int32", "rate": 50}
TOLD = {4: {"succeeded"}, 5: {"preempted"}, 6: {"failed"}, None: {"failed", "preempted"}}
"""What a life is told to be, by the status that its goal had at the server; None for one that it rejected."""


class Pursuits:
    """What the server and the system have said."""

    def __init__(self):
        self.accepted = 0
        self.most = 0  # goals that were live at once
        self.orders = {}  # of each number at the server
        self.statuses = {}  # of each number at the server
        self.running = None
        self.made = {}  # of each goal, the number of the life that made it
        self.ends = {}  # of each life
        self.faults = []
        self.wrong = []

    def note(self, event):
        match event:
            case {"goal": number, "fields": fields}:
                self.orders[number] = fields["order"]
            case {"accepted": _, "live": live}:
                self.accepted += 1
                self.most = max(self.most, live)
            case {"ended": int(number), "status": status}:
                self.statuses[number] = status
            case {"life": action, "number": number, "status": "running"} if action != "0":
                if self.running is not None:
                    self.wrong.append(f"life {number} begins while {self.running} runs")
                self.running = number
            case {"life": action, "number": number, "status": status, "detail": detail} if action != "0":
                if number in self.ends:
                    self.wrong.append(f"life {number} ends twice")
                self.ends[number] = status, detail
                self.running = None
            case {"made": made}:
                self.made[made] = self.running
            case {"fault": _}:
                self.faults.append(event)

    def violations(self):
        """Return what is wrong, a line each."""
        found = list(self.wrong)
        if self.most > 1:
            found.append(f"{self.most} goals were live at once")
        for number, order in self.orders.items():
            status = self.statuses.get(number)
            told, detail = self.ends.get(self.made[order], ("never", ""))
            if told not in TOLD[status]:
                found.append(f"goal {number} ended with status {status}, and its life is told as {told}: {detail}")
        return found

    def __str__(self):
        counts = {}
        for status, _ in self.ends.values():
            counts[status] = counts.get(status, 0) + 1
        ends = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
        late = sum(1 for number, status in self.statuses.items() if status == 4 and number in self.orders)
        return (
            f"{self.accepted} of {len(self.orders)} goals accepted, at most {self.most} live ({ends}; {late} reached)"
        )


async def run(python, folder, goals, seed):
    """Have so many goals accepted; return what was seen."""
    drawn, seen = random.Random(seed), Pursuits()
    (folder / "moves.py").write_text(MOVES)
    async with programs(python, folder) as here:
        robot = await here.peer()
        robot.tell(act="/move", type="test_msgs/action/Fibonacci")
        mover = await here.system(SYSTEM)

        async def listen(program):
            async for event in program.lines():
                seen.note(event)

        listening = [asyncio.create_task(listen(program)) for program in (robot, mover)]
        wanted = 0
        while seen.accepted < goals:
            await step(robot, drawn, wanted := drawn.choice([each for each in range(4) if each != wanted]))
            if any(each.done() for each in listening):
                raise AssertionError(f"a program has ended: {robot.said.read_text()} {mover.said.read_text()}")
        robot.tell(options={"answer": True, "brake": 0.0})
        robot.tell(**WANTED, message={"data": 0})
        mover.tell(end=True)
        await listening[1]
        robot.process.stdin.close()
        await listening[0]
    return seen


async def step(robot, drawn, wanted):
    """Want another goal, of a server that does something else; then let some time pass."""
    answer = drawn.choices([True, False, None], [0.9, 0.05, 0.05])[0]
    robot.tell(answer=True)
    robot.tell(options={"answer": answer, "brake": drawn.choice([0.0, 0.0, 0.005, 0.02, None])})
    robot.tell(**WANTED, message={"data": wanted})
    await asyncio.sleep(drawn.choice([0.0, 0.002, 0.01, 0.03]))
    if answer is None:
        robot.tell(answer=drawn.random() < 0.7)
    for _ in range(drawn.choice([0, 1, 1, 2])):
        robot.tell(finish=drawn.choice([4, 4, 5, 6]))
        await asyncio.sleep(drawn.choice([0.0, 0.005]))


def main():
    goals = int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(10**6)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seen = asyncio.run(run(interpreter(folder), folder, goals, seed))
    print(f"seed {seed}: {seen}")
    for violation in seen.violations():
        print(violation)
    sys.exit(bool(seen.violations()))


if __name__ == "__main__":
    where_possible(main)
