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

HOST = ["stop it", "stop it", "start it", "start it", "break off its start", "exit"]
"""What the program may do, between turns."""

PAUSES = [0.0, 0.01, 0.2, 0.7, 2.0, 4.0]
"""Seconds between two steps."""


class Script:
    """What happens.

    Args:
        random: Draws it.
        system: To what.
        journal: Is told of it.
    """

    def __init__(self, random, system, journal):
        self._random, self._system, self._journal = random, system, journal

    def open(self):
        """Take the runtime that has begun."""
        runtime = self._journal.runtime
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
            if draw.random() < host:
                await self._act(draw.choice(HOST), draw.choice(self._system.tops))
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

    # -- What the program does -----------------------------------------------------------------------------------

    async def _act(self, what, top):
        runtime = self._journal.runtime
        if what == "exit":
            if self._random.random() < 0.3:
                text = self._journal.text(leaving=True)
                crash(self._random.choice(list(self._journal.robots.values())), SystemExit(text))
        elif what == "stop it":
            if top.life == "running" and not runtime.ending:
                ending = self._journal.ends(self._names(top.name))
                await runtime.stop(top)
                ending.over = self._journal.order
        elif top.parent is None and top.life in {"stopped", "failed"}:
            start = asyncio.create_task(self._start(top))
            if what != "start it":
                for _ in range(self._random.randint(0, 12)):
                    await asyncio.sleep(0)
                start.cancel()
            await asyncio.wait([start])

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
        if robot.life != "running":
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
