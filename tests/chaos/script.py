"""What happens to a system: stimuli and faults, at random times, in turns and between them, from threads."""

from __future__ import annotations

import asyncio
import threading

import mdm
from mdm.messages import Observation, SensorUpdate, State
from mdm.testing import crash

STIMULI = ["set"] * 8 + ["unknown", "reset", "release", "late", "thread"]
"""What may still happen while a runtime stops."""

COMMANDS = [*STIMULI, "stop", "start", "crash", "endanger"]
"""What may happen before, in a turn."""

ENTANGLED = ["set"] * 4 + ["start"] * 3 + ["endanger"] * 2 + ["release", "stop", "unknown", "reset"]
"""What happens to one ensemble and those above and below it within one step of the loop."""

INSIDE = ["set"] * 4 + ["start", "stop", "reset", "release", "endanger", "unknown", "exit"]
"""What an action may do."""

ALWAYS = {"start", "stop", "reset", "release"}
"""What may be asked of an ensemble that starts, or is about to start anew."""

HOST = ["stop it", "stop it", "start it", "start it", "break off its start", "break off its start", "bounce it", "exit"]
"""What the program may do, between turns."""

BREAKS = ["cancel", "cancel", "stop", "crash", "exit"]
"""What may break a start off."""

PAUSES = [0.0, 0.01, 0.2, 0.7, 2.0, 4.0]
"""Seconds between two steps."""


class Script:
    """What happens.

    Args:
        random: Draws it.
        system: To what.
        journal: Is told of it.

    Attributes:
        tasks: What the program does meanwhile.
        meanwhile: What is called at each step.
    """

    def __init__(self, random, system, journal):
        self._random, self._system, self._journal = random, system, journal
        self.tasks, self.meanwhile = [], []

    def open(self):
        """Take the runtime that has begun."""
        runtime = self._journal.runtime
        self._journal.inside = self._meddle
        self._turn = runtime.channel("turn", list)
        self._turn.subscribe(self._disturb_in_a_turn)

    async def go(self, steps, stimuli, host=0.0):
        """Do so many things, some of them as the program that is the host.

        Args:
            steps: How many.
            stimuli: Which.
            host: How often it is the program that does something.
        """
        draw = self._random
        for _ in range(steps):
            await asyncio.sleep(draw.choice(PAUSES))
            self._journal.check_modes()
            self._journal.check_liveness()
            for each in self.meanwhile:
                each()
            if draw.random() < host:
                act = asyncio.create_task(self._act(draw.choice(HOST), draw.choice(self._system.tops)))
                self.tasks.append(act)
                if draw.random() < 0.6:  # else what comes next comes meanwhile
                    await asyncio.wait([act])
                continue
            if stimuli is COMMANDS and draw.random() < 0.2:
                self._entangle()
                continue
            name = draw.choice(list(self._journal.robots))
            if self._journal.robots[name].life == "running":
                # Several in one turn, so that one of them finds what another has decided still on its way.
                names = [name, name, draw.choice(list(self._journal.robots))]
                chosen = [(draw.choice(names), draw.choice(stimuli)) for _ in range(draw.choice([1, 1, 2, 3]))]
                if draw.random() < 0.8:
                    self._turn.publish(chosen)
                else:
                    self._disturb_in_a_turn(chosen)

    async def hurry(self):
        """Start all by hand, and endanger it from the top: much is then under way below when the end comes."""
        draw, names = self._random, list(self._journal.robots)
        tops = [top.name for top in self._system.tops]
        for chosen, stimulus in ((names, "start"), (names, "set"), (draw.choice([tops, tops, names]), "endanger")):
            for name in chosen:
                self._turn.publish([(name, stimulus)])
            await asyncio.sleep(draw.choice(PAUSES[:3]))

    def _entangle(self):
        """Do several things to an ensemble and to those above and below it, all in this step of the loop."""
        draw, journal = self._random, self._journal
        name = draw.choice(list(journal.robots))
        match draw.choice(["any", "any", "change", "nest"]):
            case "any":
                names = self._related(name)
                chosen = [(draw.choice([name, *names]), draw.choice(ENTANGLED)) for _ in range(draw.randint(2, 6))]
            case "change":  # of mind, more than once, and then no more
                last = draw.choice(["endanger", "stop", "set"])
                chosen = [(name, "set") for _ in range(draw.randint(2, 4))] + [(name, last)]
            case "nest":  # one that is safe below one that is safe
                above = draw.choice(journal.above(name))
                chosen = [(name, "start"), (name, "set"), (name, "endanger"), (above, "endanger"), (name, "start")]
                chosen += [(name, "release"), (name, "set")]
                chosen = [each for each in chosen if draw.random() < 0.9]
        if draw.random() < 0.3:
            self._turn.publish(chosen)
        else:
            self._disturb_in_a_turn(chosen)

    def _meddle(self, name):
        """Do what an action does to its ensemble, or to one above or below it."""
        draw = self._random
        stimulus = draw.choice(INSIDE)
        if stimulus != "exit":
            self._disturb(draw.choice([name, *self._related(name)]), stimulus)
        elif draw.random() < 0.3:
            self._exit()

    def _related(self, name):
        """Return the names of an ensemble, and of those above and below it."""
        journal = self._journal
        return [other for other in journal.robots if other in journal.above(name) or name in journal.above(other)]

    # -- What the program does -----------------------------------------------------------------------------------

    async def _act(self, what, top):
        runtime = self._journal.runtime
        if what == "exit":
            if self._random.random() < 0.3:
                self._exit()
        elif what == "stop it":
            if top.parent is not None and not runtime.ending:
                await self._stop(top)
        elif what == "bounce it":
            await self._act("stop it", top)
            await self._act("break off its start", top)
        elif top.parent is None and top.life in {"created", "stopped", "failed"}:
            await self.start(top, broken_off=what != "start it")

    def _exit(self):
        known = [robot for robot in self._journal.robots.values() if robot.life != "created"]
        if known:
            crash(self._random.choice(known), SystemExit(self._journal.text(leaving=True)))

    async def _stop(self, top):
        ending = self._journal.ends(self._names(top.name))
        try:
            await self._journal.runtime.stop(top)
        finally:
            self._journal.ended(ending)

    async def start(self, top, *, broken_off):
        """Start an ensemble at the top; break that off at any step."""
        draw, names = self._random, self._names(top.name)
        start = asyncio.create_task(self._start(top))
        if broken_off:
            for _ in range(draw.randint(0, draw.choice([6, 10, 40, 120]))):
                await asyncio.sleep(0)
                if draw.random() < 0.05:
                    self._disturb(draw.choice(names), draw.choice(["start", "set", "set"]))
            await self._break_off(draw.choice(BREAKS), start, top, names)
        await asyncio.wait([start])

    async def _break_off(self, what, start, top, names):
        journal, robots = self._journal, self._journal.robots
        if start.done():
            return
        if what == "cancel":
            ending = journal.ends(names)
            start.cancel()
            await asyncio.wait([start])
            journal.ended(ending)
        elif what == "stop":
            if top.parent is not None and not journal.runtime.ending:
                await self._stop(top)
        else:
            robot = robots[self._random.choice(names)]
            alive = [actor for actor in (robot, *robot.children) if actor.life in {"starting", "running"}]
            if alive and what == "crash":
                crash(self._random.choice(alive), mdm.Error(journal.text()))
            elif alive:
                crash(self._random.choice(alive), SystemExit(journal.text(leaving=True)))

    async def _start(self, top):
        try:
            await self._journal.runtime.start(top)
        except BaseException as error:
            self._journal.answers.append(error)

    def _names(self, name):
        return [known for known in self._journal.robots if name in self._journal.above(known)]

    # -- Stimuli -------------------------------------------------------------------------------------------------

    def _disturb_in_a_turn(self, disturbances):
        for name, stimulus in disturbances:
            self._disturb(name, stimulus)

    def _disturb(self, name, stimulus):
        robot = self._journal.robots[name]
        asked = stimulus in ALWAYS and robot.life in {"starting", "restarting"}
        if robot.life != "running" and not asked:
            return
        match stimulus:
            case "set":
                self._tell(name, self._random.choice([0, 0, 1, 1, 2]))
            case "unknown":
                self._tell(name, None)
            case "thread":
                value = self._random.choice([0, 1, 2, None])
                thread = threading.Thread(target=self._tell, args=(name, value))
                thread.start()
                thread.join()
            case "late":
                self._tell_late(name, robot)
            case "crash":
                text, manager = self._journal.text(), self._system.managers[name]
                victims = [robot.control, robot.action, robot, robot.state or robot.observation or robot, manager]
                crash(self._random.choice(victims), mdm.Error(text))
            case "endanger":
                robot.safety.endanger("mine", "somebody says so", self._journal.now())
            case command:
                getattr(robot, command)()

    def _tell(self, name, value):
        """Tell an ensemble what is seen; from any thread."""
        states, manager = self._system.states[name], self._system.managers[name]
        if states and value is not None:
            self._journal.blind.pop(name, None)
        if name in self._system.told:
            if value is not None:
                self._journal.robots[name].publish_state(value % states)
        elif not states:
            if value is None:
                return
            if name in self._system.layered:
                manager.occur(f"{name}{value}")
            else:
                self._journal.robots[name].publish_observation(value)
        elif name in self._system.grounded:
            self._journal.runtime.channel(f"{name}/readings", int).publish(-1 if value is None else value % states)
        elif value is None:
            manager.sense(f"{name}0", None)
        else:
            with manager.batch():
                for state in range(states):
                    manager.sense(f"{name}{state}", state == value % states)

    def _tell_late(self, name, robot):
        """Tell it what was seen two seconds ago."""
        time = self._journal.now() - 2_000_000_000
        states, manager = self._system.states[name], self._system.managers[name]
        value = self._random.randrange(max(2, states))
        if robot.life != "running" or manager.life != "running":
            return
        if states:
            self._journal.blind.pop(name, None)
        if not states:
            robot.channel("observation", Observation).publish(Observation(time, value, (value,), (True,)))
        elif name in self._system.told:
            robot.channel("state", State, retain=True).publish(State(time, value, (value,)))
        else:
            readings = tuple((f"{name}{state}", state == value) for state in range(states))
            manager.channel("sensed", SensorUpdate).publish(SensorUpdate(time, readings))
