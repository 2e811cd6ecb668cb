"""Random schedules of what may happen to a robot of ROS: it ends safe, says why, and the safe action reaches it.

A robot drives while a topic says go. Topics fall silent, its server is killed, held, or aborts, and at the end the
system gets a signal in one of the states of a goal. ``python -m ros2.schedules 500`` plays so many, a third
of a minute each; a second number is the first seed.
"""

from __future__ import annotations

import asyncio
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from ros2.environment import Watched, interpreter, programs, where_possible

SYSTEM = """
[ros2]
node = "driver"

[predicates]
Go = { topic = "/go", type = "std_msgs/msg/Bool", when = "data", max_age = 0.6 }
Near = { topic = "/scan", type = "sensor_msgs/msg/LaserScan", when = "ranges[0] < 1.0", max_age = 0.6 }

[ensembles.driver]
policy = [0, 1, 0, 0]
safe_action = { publish = "/cmd_vel", type = "geometry_msgs/msg/Twist", rate = 20.0, until = 0.2 }

[ensembles.driver.states]
near = { yes = "Near" }
go = { yes = "Go" }

[ensembles.driver.actions]
0 = "standing:stand"
1 = { action = "/drive", type = "test_msgs/action/Fibonacci", goal = { order = 1 }, silence = 0.6, grace = 5.0 }
"""

STANDING = "def stand():\n    pass\n"
DRIVE = {"act": "/drive", "type": "test_msgs/action/Fibonacci", "beat": 20}
GO = {"publish": "/go", "type": "std_msgs/msg/Bool", "rate": 20}
SCAN = {"publish": "/scan", "type": "sensor_msgs/msg/LaserScan", "message": {"ranges": [3.0]}, "rate": 20}

DISTURBANCES = (
    *("go silent", "scan silent", "sensors killed", "robot killed", "robot killed while cancelling", "robot held"),
    *("aborted", "server removed"),
)
STATES = ("no server", "unanswered", "pursued", "cancelling", "reached", "held", "killed")
"""Of a goal, when the system gets its signal."""


class Schedule:
    """What happens in one run, by a seed."""

    def __init__(self, seed):
        drawn = random.Random(seed)
        self.seed = seed
        self.disturbances = drawn.choices(DISTURBANCES, k=drawn.choice([0, 1, 1, 2]))
        self.state = drawn.choice(STATES)
        self.pause = drawn.choice([0.0, 0.01, 0.1])

    def __str__(self):
        return f"seed {self.seed}: {', '.join([*self.disturbances, f'a signal while {self.state}'])}"


class Run:
    """The programs of one schedule."""

    def __init__(self, here, schedule):
        self.here, self.schedule = here, schedule
        self.delays = []  # seconds from a disturbance to the first message of the safe action that the base hears
        self.live = []
        self.driver = None

    async def play(self):
        state = self.schedule.state
        if state == "no server":
            await self.begin(server=False)
            self.sense(go=True)
            await self.driver.says("life", where=lambda event: event["status"] == "running")
        else:
            await self.begin()
            await self.stand()
            await self.drive()
            for what in self.schedule.disturbances:
                await self.disturb(what)
        await self.end(state)
        self.check()

    async def begin(self, *, server=True):
        """Start all, the server too, unless there is none."""
        (self.here.folder / "standing.py").write_text(STANDING)
        self.base, self.sensors, self.robot = await asyncio.gather(*map(self.peer, ("base", "sensors", "robot")))
        self.base.tell(echo="/cmd_vel", type="geometry_msgs/msg/Twist")
        if server:
            self.robot.tell(**DRIVE)
        self.sense(go=False)
        self.driver = Watched(await self.here.system(SYSTEM))
        self.base.tell(matched="/cmd_vel")
        await self.base.says("matched")

    async def peer(self, name):
        return Watched(await self.here.peer(name))

    def sense(self, *, go):
        self.sensors.tell(**SCAN)
        self.sensors.tell(**GO, message={"data": go})

    async def safe(self, disturb, *why):
        """Disturb it; the safe action reaches the base, and a cause says why."""
        heard, told, begin = len(self.base.said), len(self.driver.said), time.monotonic()
        disturb()
        await self.base.says("heard", since=heard)
        self.delays.append(time.monotonic() - begin)

        def explained(event):
            return event["mode"] == "safe" and any(each in str(event["causes"]) for each in why)

        await self.driver.says("mode", since=told, where=explained)

    async def disturb(self, what):
        """Let something happen while the robot drives, and have all as before."""
        match what:
            case "go silent":
                await self.safe(lambda: self.sensors.tell(**{**GO, "rate": 0}), "Go")
            case "scan silent":
                await self.safe(lambda: self.sensors.tell(**{**SCAN, "rate": 0}), "Near")
            case "sensors killed":
                await self.safe(lambda: self.sensors.program.signal(signal.SIGKILL), "Go", "Near")
                self.sensors = await self.peer("sensors")
            case "robot killed" | "robot killed while cancelling":
                if what != "robot killed":
                    goals = len(self.robot.said)
                    await self.set(brake=None)
                    self.sense(go=False)
                    await self.robot.says("cancel", since=goals)
                await self.safe(lambda: self.robot.program.signal(signal.SIGKILL), "drive")
                self.live += self.robot.said
                self.robot = await self.peer("robot")
                self.robot.tell(**DRIVE)
            case "robot held":
                goals = len(self.robot.said)
                await self.safe(lambda: self.robot.program.signal(signal.SIGSTOP), "drive")
                self.robot.program.signal(signal.SIGCONT)
                await self.robot.says("ended", since=goals)  # of the old goal, which was cancelled meanwhile
            case "aborted":
                await self.safe(lambda: self.robot.tell(finish=6), "drive")
            case "server removed":
                await self.safe(lambda: self.robot.tell(remove="/drive"), "drive")
                self.robot.tell(**DRIVE)
        await self.stand()
        await self.drive()

    async def stand(self):
        """Have it decide to stand, and its goals end."""
        self.sense(go=False)
        last = lambda name: (self.driver.last(name) or {}).get(name)
        await self.driver.until(lambda: last("mode") != "safe" and last("decision") == "0")
        while True:
            told = len(self.robot.said)
            self.robot.tell(live=True)
            if (await self.robot.says("lives", since=told))["lives"] == 0:
                break

    async def set(self, **options):
        """Change what the server does from now on."""
        said = len(self.robot.said)
        self.robot.tell(options=options)
        self.robot.tell(echoed=said)
        await self.robot.says("echoed", since=said)

    async def drive(self):
        """Have the robot drive; where its server was not met in time, from the beginning."""
        while True:
            goals, told = len(self.robot.said), len(self.driver.said)
            self.sense(go=True)
            accepted = asyncio.ensure_future(self.robot.says("accepted", since=goals))
            safe = asyncio.ensure_future(
                self.driver.says("mode", since=told, where=lambda event: event["mode"] == "safe")
            )
            await asyncio.wait([accepted, safe], return_when=asyncio.FIRST_COMPLETED)
            for each in (accepted, safe):
                each.cancel()
            if accepted.done() and not accepted.cancelled():
                return accepted.result()
            await self.stand()

    async def end(self, state):
        """End the system in a state of the goal; the safe action reaches the base, and no goal goes on."""
        robot, since = self.robot, len(self.robot.said)
        match state:
            case "unanswered":
                await self.stand()
                await self.set(answer=None)
                since = len(robot.said)  # goals of a server that was not heard may have come until now
                self.sense(go=True)
                await robot.says("goal", since=since)
            case "cancelling":
                await self.set(brake=None)
                self.sense(go=False)
                await robot.says("cancel", since=since)
            case "reached":
                robot.tell(finish=4)
                await robot.says("ended", since=since)
            case "held":
                robot.program.signal(signal.SIGSTOP)
            case "killed":
                robot.program.signal(signal.SIGKILL)
        await asyncio.sleep(self.schedule.pause)
        since, heard, begin = len(robot.said), len(self.base.said), time.monotonic()
        self.driver.program.signal(signal.SIGTERM)
        match state:
            case "unanswered":
                robot.tell(answer=True)
            case "cancelling":
                robot.tell(finish=5)
        await self.base.says("heard", since=heard)
        self.delays.append(time.monotonic() - begin)
        status = await self.driver.ended()
        assert status == 128 + signal.SIGTERM, f"it ended with status {status}"
        assert "Traceback" not in self.driver.program.said.read_text()
        assert "ended" in self.driver.said[-1]
        if state == "held":
            robot.program.signal(signal.SIGCONT)
        if state in {"unanswered", "pursued", "cancelling"}:
            await robot.says("ended", since=since, where=lambda event: event["status"] == 5)

    def check(self):
        """Raise where two goals were live at once, unless a server was silent, and the safe action has run since."""
        live = [event["live"] for event in (*self.live, *self.robot.said) if "accepted" in event]
        silences = sum("told nothing" in event.get("detail", "") for event in self.driver.said if "fault" in event)
        assert max(live, default=0) <= 1 + bool(silences), live


async def play(python, folder, seed):
    """Play a schedule; return the seconds that the safe action took to reach the base, each time."""
    schedule = Schedule(seed)
    async with programs(python, folder) as here:
        here.leave_shared_memory()
        run = Run(here, schedule)
        try:
            await run.play()
        except AssertionError as error:
            raise AssertionError(f"{schedule}: {error}; the driver: {run.driver}") from error
    return run.delays


def main():
    schedules = int(sys.argv[1])
    first = int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(10**6)
    failed, delays = 0, []
    with tempfile.TemporaryDirectory() as name:
        python = interpreter(Path(name))
        for seed in range(first, first + schedules):
            folder = Path(name) / str(seed)
            folder.mkdir()
            try:
                delays += asyncio.run(play(python, folder, seed))
            except Exception as error:
                failed += 1
                print(f"{type(error).__name__}: {error}")
    print(f"{schedules} schedules from seed {first}: {failed} failed; {len(delays)} times safe, after at most", end=" ")
    print(f"{max(delays, default=0):.2f} s")
    sys.exit(bool(failed))


if __name__ == "__main__":
    where_possible(main)
