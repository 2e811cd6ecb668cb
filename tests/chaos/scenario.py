"""Random systems with random faults, from a seed, run in virtual time and held against oracles.

A scenario is a tree of ensembles with actions of every kind (plain, async, stubborn, deaf, failing, or an ensemble
below), sensors that grow old, drives of both kinds, and a script of stimuli and faults. `Scenario.run` carries it out
and returns what the oracles find wrong.
"""

from __future__ import annotations

import asyncio
import logging
import random

import mdm
from mdm.testing import crash, probe

END = 120.0
"""Seconds of virtual time in which everything is over once the runtime is left."""


class Panic(BaseException):
    """What native code may raise."""


STIMULI = ["set"] * 8 + ["unknown", "reset", "release"]
"""What may still happen while a runtime stops."""

COMMANDS = [*STIMULI, "stop", "start", "crash"]
"""What may happen before."""

ANYTHING = (ValueError, asyncio.CancelledError, Panic, SystemExit)
"""What may be raised where a failure is expected."""


class Faulty(mdm.Actor):
    """An actor that may raise something at any point of its life.

    Args:
        name: Its name.
        throw: Raises, now and then.
    """

    def __init__(self, name, throw):
        super().__init__(name)
        self._throw = throw

    def on_start(self):
        self._throw()

    def on_running(self):
        self._throw()
        self.spawn(self._work(), name="work")
        self.call_later(3.0, self._throw)

    async def _work(self):
        try:
            await asyncio.sleep(7.0)
        finally:
            self._throw((ValueError, Panic, SystemExit))

    async def on_stopping(self):
        await asyncio.sleep(0.1)
        self._throw()

    def on_stop(self):
        self._throw()


class Run:
    """One run of an action: who, which, and when it entered and left, in the order of all events."""

    def __init__(self, robot, action, entered, time, *, safe):
        self.robot, self.action, self.entered, self.time, self.safe = robot, action, entered, time, safe
        self.left = None


class Scenario:
    """A system and its script, drawn from a seed.

    Args:
        seed: The same seed makes the same scenario.
    """

    def __init__(self, seed):
        self.seed = seed
        self.random = random.Random(seed)
        self.predicates = mdm.PredicateManager()
        self.robots, self.parents, self.runs, self.wrong = {}, {}, [], []
        self.limits = {}
        self.told, self.order, self.raised = [], 0, []
        self.lives, self.faults, self.modes, self.exits = [], [], [], []
        self.top = self._robot("r", self.random.randint(1, 3))

    # -- The system ----------------------------------------------------------------------------------------------

    def _robot(self, name, levels):
        draw, states = self.random, self.random.randint(2, 3)
        for state in range(states):
            self.predicates.sensor(f"{name}{state}", max_age=draw.choice([None, None, 3.0]))
        count = draw.randint(2, 3)
        actions = {}
        for index in range(count):
            if levels > 1 and index == 0:
                below = self._robot(f"{name}{'abc'[index]}", levels - 1)
                self.parents[below.name] = name
                actions[f"{name}_go{index}"] = below
            else:
                kind = draw.choice(["plain", "quick", "long", "long", "stubborn", "deaf", "failing", "spiteful"])
                target = getattr(self, f"_{kind}")(name, f"go{index}")
                limit = draw.choice([None, None, 5.0])
                if kind in {"long", "stubborn", "spiteful"}:
                    self.limits[name, f"go{index}"] = limit
                actions[f"{name}_go{index}"] = mdm.bind(target, grace=draw.choice([0.5, 2.0]), timeout=limit)
        safe = getattr(self, draw.choice(["_plain", "_quick", "_quick", "_failing"]))(name, "safe", safe=True)
        supervision = draw.choice(["escalate", mdm.Restart(limit=3, within=60.0, backoff=0.5)])
        robot = mdm.Ensemble(
            name,
            policy=mdm.policies.DeterministicPolicy([draw.randrange(count) for _ in range(states)], count),
            predicates=self.predicates,
            states=[mdm.StateFactor(f"{name}state", [f"{name}{state}" for state in range(states)])],
            actions=actions,
            safe_action=safe,
            safe_timeout=3.0,
            supervision=supervision,
            drive=draw.choice(["event", "event", 2.0]),
            on_failed_action=draw.choice(["safe", "continue"]),
        )
        if draw.random() < 0.2:
            robot.add(Faulty("faulty", self._now_and_then))
        self.robots[name] = robot
        return robot

    def _enter(self, name, action, *, safe):
        self.order += 1
        run = Run(name, action, self.order, self.clock.now(), safe=safe)
        above = name
        while not safe and above is not None:
            if self.robots[above].mode == "safe":
                self.wrong.append(f"{above} is safe, but {action} of {name} starts")
            above = self.parents.get(above)
        for other in self.runs:
            if other.robot == name and other.left is None:
                self.told.append((other, run))  # allowed where the other one has been abandoned
        self.runs.append(run)
        return run

    def _leave(self, run):
        self.order += 1
        run.left = self.order
        limit = self.limits.get((run.robot, run.action))
        if limit is not None and self.clock.now() - run.time > (limit + 0.5) * 1e9:
            self.wrong.append(f"{run.action} of {run.robot} lasts longer than {limit} s")

    def _throw(self, kinds=ANYTHING):
        kind = self.random.choice(kinds)
        text = self._text()
        if kind is SystemExit:
            self.exits.append(text)
        else:
            self.raised.append(text)
        raise kind(text)

    def _text(self):
        return f"injected #{len(self.raised) + len(self.exits)}#"

    def _now_and_then(self, kinds=ANYTHING):
        if self.random.random() < 0.04:
            self._throw(kinds)

    def _plain(self, name, action, *, safe=False):
        def run():
            self._leave(self._enter(name, action, safe=safe))

        return run

    def _failing(self, name, action, *, safe=False):
        def run():
            entered = self._enter(name, action, safe=safe)
            try:
                if self.random.random() < 0.5:
                    self._throw([ValueError] if safe else ANYTHING)
            finally:
                self._leave(entered)

        return run

    def _coroutine(self, name, action, seconds, rest, *, safe=False, spiteful=False):
        async def run():
            entered = self._enter(name, action, safe=safe)
            try:
                await asyncio.sleep(seconds)
            except asyncio.CancelledError:
                await self._linger(rest)
                if spiteful:
                    self._throw([ValueError, Panic, SystemExit])
                raise
            finally:
                self._leave(entered)

        return run

    async def _linger(self, rest):
        while rest > 0:
            began = asyncio.get_running_loop().time()
            try:
                await asyncio.sleep(rest)
            except asyncio.CancelledError:
                rest -= asyncio.get_running_loop().time() - began
            else:
                return

    def _quick(self, name, action, *, safe=False):
        return self._coroutine(name, action, 0.3, 0.0, safe=safe)

    def _long(self, name, action):
        return self._coroutine(name, action, 50.0, 0.0)

    def _stubborn(self, name, action):
        return self._coroutine(name, action, 50.0, 0.4)

    def _spiteful(self, name, action):
        return self._coroutine(name, action, 50.0, 0.2, spiteful=True)

    def _deaf(self, name, action):
        return self._coroutine(name, action, 50.0, 10.0)

    # -- The script ----------------------------------------------------------------------------------------------

    async def _script(self, steps, stimuli):
        for _ in range(steps):
            await asyncio.sleep(self.random.choice([0.0, 0.01, 0.2, 0.7, 2.0, 4.0]))
            name = self.random.choice(list(self.robots))
            if self.robots[name].life == "running":
                # Several in one turn, so that one of them finds what another has decided still on its way.
                self.turn.publish(
                    [(name, self.random.choice(stimuli)) for _ in range(self.random.choice([1, 1, 2, 3]))]
                )

    def _disturb_in_a_turn(self, disturbances):
        for name, stimulus in disturbances:
            self._disturb(name, stimulus)

    def _disturb(self, name, stimulus):
        draw, robot = self.random, self.robots[name]
        match stimulus:
            case "set":
                states = sum(known.startswith(name) and known[len(name) :].isdigit() for known in self.predicates.names)
                chosen = draw.randrange(states)
                with self.predicates.batch():
                    for state in range(states):
                        self.predicates.sense(f"{name}{state}", state == chosen)
            case "unknown":
                self.predicates.sense(f"{name}0", None)
            case "crash":
                text = self._text()
                self.raised.append(text)
                crash(draw.choice([robot.control, robot.action, robot.state]), mdm.Error(text))
            case command:
                getattr(robot, command)()

    async def _main(self):
        afterwards = None
        try:
            async with mdm.Runtime(log=None) as runtime:
                self.clock = runtime.clock
                self.faults = probe(runtime.faults)
                runtime.modes.subscribe(self.modes.append)
                self.turn = runtime.channel("turn", list)
                self.turn.subscribe(self._disturb_in_a_turn)
                for robot in self.robots.values():
                    self.lives.append(
                        probe(runtime.channel(f"{self._path(robot.name)}/lives", mdm.messages.ActionLife))
                    )
                await runtime.start(self.top)
                await self._script(self.random.randint(8, 25), COMMANDS)
                self._note_deciding()
                afterwards = asyncio.create_task(self._script(self.random.randint(0, 10), STIMULI))
        except BaseException as error:
            self.ended_by = error
        if afterwards is not None:
            await afterwards
        await asyncio.sleep(END)
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            self.wrong.append(f"tasks are left: {others}")

    def _path(self, name):
        parent = self.parents.get(name)
        return name if parent is None else f"{self._path(parent)}/{name}"

    def _note_deciding(self):
        self.order += 1
        self.last = self.order
        self.deciding = {name for name, robot in self.robots.items() if robot.mode == "deciding"}

    def run(self):
        """Carry the scenario out, and return what is wrong, each in a sentence."""
        self.ended_by, self.last, self.deciding = None, None, set()
        mdm.run(self._main, virtual=True)
        self._judge()
        return self.wrong

    # -- The oracles ---------------------------------------------------------------------------------------------

    def _judge(self):
        lives = [life for messages in self.lives for life in messages]
        self._one_life_each(lives)
        abandoned = {life.ensemble.rpartition("/")[2] for life in lives if life.status == "abandoned"}
        for before, after in self.told:
            if before.robot not in abandoned:
                self.wrong.append(f"{before.robot}: {after.action} starts while {before.action} lives")
        for text in self.raised:
            words = [fault.detail for fault in self.faults] + [str(self.ended_by), *self._causes(self.ended_by)]
            if not any(text in word for word in words):
                self.wrong.append(f"{text!r} was never told")
        if any(run.left is None for run in self.runs):
            self.wrong.append("an action never ended")
        if self.exits and self.ended_by is None:
            self.wrong.append(f"{self.exits} did not end the runtime")
        self._safe_in_the_end()
        if self.ended_by is None:
            self._outermost_last()

    def _causes(self, error):
        while error is not None:
            yield str(error)
            if isinstance(error, BaseExceptionGroup):
                for inner in error.exceptions:
                    yield from self._causes(inner)
            error = error.__cause__ or error.__context__

    def _one_life_each(self, lives):
        ends = {}
        for life in lives:
            ends.setdefault((life.ensemble, life.life), []).append(life.status)
        for key, statuses in ends.items():
            if statuses[0] != "running" or len(statuses) != 2:
                self.wrong.append(f"life {key} goes {statuses}")

    def _safe_in_the_end(self):
        """Hold that whatever began to decide, and was not told to stop, has run its safe action since."""
        for name, robot in self.robots.items():
            told = [mode for mode in self.modes if mode.ensemble == self._path(name)]
            if not told or told[-1].mode == "stopped":
                continue
            if told[-1].mode == "deciding":
                self.wrong.append(f"{name} was deciding in the end")
                continue
            began = max(mode.since for mode in told if mode.mode == "deciding")
            if not any(run.robot == name and run.safe and run.time >= began for run in self.runs):
                self.wrong.append(f"{name} is {robot.mode} in the end, but has not run its safe action")
            last = [run for run in self.runs if run.robot == name][-1]
            if not last.safe:
                self.wrong.append(f"{name} is {robot.mode} in the end, and its last action is {last.action}")

    def _went_on(self, name):
        """Whether something above has chosen another action since, as at a tick of the same moment."""
        above = self.parents.get(name)
        while above is not None:
            if any(run.robot == above and not run.safe and run.entered > self.last for run in self.runs):
                return True
            above = self.parents.get(above)
        return False

    def _outermost_last(self):
        last = {}
        for name in self.deciding:
            runs = [run for run in self.runs if run.robot == name and run.safe and run.entered > self.last]
            if not runs and not self._went_on(name):
                self.wrong.append(f"{name} was deciding, and did not run its safe action at the end")
            elif runs:
                last[name] = runs[-1]
        for name, parent in self.parents.items():
            if name in last and parent in last and last[parent].entered < (last[name].left or 0):
                self.wrong.append(f"the safe action of {parent} has not the last word over {name}")


def violations(seed):
    """Return a seed, and what is wrong with its scenario."""
    logging.disable()  # asyncio tells of what is raised where nobody waits, as is meant here
    return seed, Scenario(seed).run()
