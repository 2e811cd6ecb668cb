"""Random systems, from a seed, that are built twice: to run and be recorded, and to be replayed.

The same seed draws the same structure. What functions of a run do is drawn while it runs, by another generator: a
replay has to know it from the record. Those of a system that is built for a replay note that they were called, which
none of them may be.
"""

from __future__ import annotations

import asyncio
import random
import threading
import time

import numpy as np
from rows_of_rooms import row_of_rooms

import mdm
from mdm.maps import Places
from mdm.testing import crash

ROOMS = ("Hall", "Kitchen", "Office")
PLAIN = ["nothing", "nothing", "set", "set", "batch", "raise", "command", "generator", "slow"]
LASTING = ["sleep", "sleep", "set", "fail", "swallow", "endless", "clean", "gather", "thread", "finished", "cancelled"]
TEXT = "as it was meant to be"


class Meddler(mdm.Actor):
    """A user's own actor, which says something when it is told something.

    Args:
        system: Whose.
        points: Channels that it hears.
    """

    def __init__(self, system, points):
        super().__init__("meddler", supervision="stop")
        self._system, self._points = system, points

    def on_start(self):
        for name, kind in self._points:
            self.subscribe(self.runtime.channel(name, kind), self._meddle)
        self.call_later(0.05, self._later)

    def _meddle(self, _):
        if self._system.chance(0.25):
            self._system.say()

    def _later(self):
        self._system.say()
        self.call_later(self._system.behaviour.uniform(0.005, 0.05), self._later)


class System:
    """A random system.

    Args:
        seed: Of its structure.
        behaviour: Of what its functions do; None where none may be called.
    """

    def __init__(self, seed, behaviour=None):
        self.draw = random.Random(seed)
        self.behaviour = None if behaviour is None else random.Random(behaviour)
        self.called = []
        self.sensors, self.events, self.ensembles = [], [], []
        self.told, self.observing, self.beliefs, self.grounded = [], [], [], []
        self.tops, self.places, self.runtime, self.threads = [], None, None, []
        draw = self.draw
        restart = mdm.Restart(limit=50, within=60.0, backoff=draw.choice([0.01, 0.03]))
        self.crashes = draw.random() < 0.25
        self.supervision = restart if self.crashes else "escalate"
        self.manager = mdm.PredicateManager("predicates", supervision=self.supervision)
        self.tops.append(self._over_states("top", draw.choice([1, 2, 2])))
        if draw.random() < 0.5:
            self.tops.append(self._over_beliefs("tiger"))
        if draw.random() < 0.2:
            self.tops.append(self._over_states("other", 1))
        if draw.random() < 0.3:
            self._add_places()
        if draw.random() < 0.3:
            self.tops.insert(0, self.manager)
        self.meddles = draw.random() < 0.35
        if seed % 2:
            self.tops.append(self._over_ends("ferry"))
        # Nobody commands it or has it fail: each run has a decision, whatever the others wait for.
        policy, stay = mdm.policies.DeterministicPolicy([0], 1), self._function("stay", "nothing")
        self.steady = mdm.Ensemble("steady", policy=policy, actions={"stay": stay})
        self.tops.append(self.steady)

    # -- Structure ---------------------------------------------------------------------------------------------------

    def _over_states(self, name, levels):
        draw, manager = self.draw, self.manager
        actions = draw.randint(2, 4)
        names = [f"{name}_{kind}" for kind in range(actions)]
        states, factors = 1, []
        if draw.random() < 0.8:
            rooms = [f"{name}{index}" for index in range(draw.randint(2, 3))]
            for index, room in enumerate(rooms):
                self._sensor(room, initial=draw.choice([index == 0, index == 0, None]))
            factors.append(mdm.StateFactor(f"{name}room", rooms, draw.choice([None, None, "hold"])))
            states *= len(rooms)
            self._sensor(f"{name}A", initial=draw.choice([False, None]))
            manager.define(f"{name}Held", f"{name}A", held_for=draw.choice([0.004, 0.01, 0.02]))
            factors.append(mdm.StateFactor(f"{name}held", [f"{name}Held"]))
            states *= 2
            if draw.random() < 0.6:
                end = draw.choice(["succeeded", "failed", "preempted", "timed_out"])
                manager.latch(f"{name}Done", set=f"{draw.choice(names)}.{end}", reset=f"{rooms[1]} or {name}Again")
                self._event(f"{name}Again")
                factors.append(mdm.StateFactor(f"{name}done", [f"{name}Done"]))
                states *= 2
            if draw.random() < 0.3:
                self._sensor(f"{name}G", grounded=True, initial=False)
                factors.append(mdm.StateFactor(f"{name}g", [f"{name}G"]))
                states *= 2
        else:
            states = 4
            self.told.append((name, states))
        return self._ensemble(name, names, levels, states=factors, policy=self._policy(states, actions))

    def _over_ends(self, name):
        """Return an ensemble whose state follows from the ends of its own actions."""
        draw = self.draw
        actions = draw.randint(2, 3)
        names = [f"{name}_{kind}" for kind in range(actions)]
        ends = ["succeeded", "succeeded", "succeeded", "failed", "timed_out", "preempted"]
        factors = []
        for number in range(draw.randint(1, 2)):
            begin, end = draw.sample(names, 2)
            set_by = f"{begin}.{draw.choice(ends)}"
            reset = f"{end}.{draw.choice(ends)} or {end}.failed"
            self.manager.latch(f"{name}At{number}", set=set_by, reset=reset, initial=draw.random() < 0.5)
            factors.append(mdm.StateFactor(f"{name}at{number}", [f"{name}At{number}"]))
        options = {"states": factors, "policy": self._policy(2 ** len(factors), actions)}
        bound = {}
        for action in names:
            act = self._function(action, draw.choice(["ferry", "ferry", "ferry", "fail"]), lasting=True)
            then = draw.choice(["wait", "decide"])
            bound[action] = mdm.bind(act, timeout=draw.choice([None, 0.015]), then=then, pause=0.003)
        ensemble = mdm.Ensemble(name, predicates=self.manager, actions=bound, supervision=self.supervision, **options)
        self.ensembles.append(ensemble)
        return ensemble

    def _policy(self, states, actions):
        draw = self.draw
        if draw.random() < 0.3:
            rows = np.array([[draw.random() for _ in range(states)] for _ in range(actions)])
            return mdm.policies.StochasticPolicy(rows / rows.sum(0), seed=draw.randrange(1000))
        return mdm.policies.DeterministicPolicy([draw.randrange(actions) for _ in range(states)], actions)

    def _over_beliefs(self, name):
        draw = self.draw
        actions = [f"{name}_{kind}" for kind in range(3)]
        model = mdm.models.POMDP(
            [np.array([[0.7, 0.3], [0.2, 0.8]])] * 3,
            [np.array([[0.8, 0.2, 0.0], [0.3, 0.7, 0.0]])] * 3,
            np.array([[0.1, 0.5, -1.0], [0.3, -0.4, 2.0]]),
            discount=0.9,
            actions=actions,
        )
        vectors = [[1.0, 0.0], [0.6, 0.6], [0.0, 1.0]]
        options = {
            "policy": mdm.policies.AlphaVectors(np.array(vectors), [0, 1, 2], 3),
            "model": model,
            "on_impossible": draw.choice(["predict", "keep", "reset", "safe_action"]),
            "after_safe": draw.choice(["reset", "keep"]),
            "horizon": draw.choice([None, None, 5]),
        }
        self.beliefs.append(name)
        if draw.random() < 0.5:
            events = [f"{name}{symbol}" for symbol in range(3)]
            for event in events:
                self._event(event)
            options["observations"] = [mdm.ObservationFactor(f"{name}heard", events)]
        else:
            self.observing.append((name, 3))
        return self._ensemble(name, actions, 1, **options)

    def _ensemble(self, name, names, levels, **options):
        draw = self.draw
        grouped = draw.random() < 0.3
        actions = {}
        for index, action in enumerate(names):
            if levels > 1 and index == 0:
                actions[action] = mdm.bind(self._over_states(f"{name}low", levels - 1), resume=draw.random() < 0.5)
            else:
                actions[action] = self._bound(name, action, grouped=grouped)
        safe = None
        if draw.random() < 0.6 or options.get("on_impossible") == "safe_action":
            safe = draw.choice([self._function("safe", "nothing"), self._function("safe", "sleep")])
        if safe is not None:
            options["safe_timeout"] = draw.choice([0.02, 1.0])
            options["on_failed_action"] = draw.choice(["safe", "continue", "decide"])
            options["on_lost_input"] = draw.choice(["safe", "safe", "continue"])
        if "horizon" not in options and draw.random() < 0.2:
            options["horizon"] = 7
        ensemble = mdm.Ensemble(
            name,
            predicates=self.manager,
            actions=actions,
            safe_action=safe,
            drive=draw.choice(["event", "event", "event", 100.0, 50.0, 30.0]),
            deadline=draw.choice([None, None, None, 0.0004, 0.003, 1.0]),
            supervision=self.supervision,
            idle_after=draw.choice([None, None, 0.05]),
            **options,
        )
        self.ensembles.append(ensemble)
        return ensemble

    def _bound(self, name, action, *, grouped):
        draw = self.draw
        lasting = draw.random() < 0.6
        concurrent = lasting and draw.random() < 0.15
        repeat = draw.choice(["continue", "restart"]) if lasting else "continue"
        options = {}
        if draw.random() < 0.3:
            options = {
                "then": draw.choice(["decide", "wait"]),
                "pause": draw.choice([0.003, 0.02]),
                "attempts": draw.choice([None, 3]),
            }
        return mdm.bind(
            self._function(action, draw.choice(LASTING if lasting else PLAIN), lasting=lasting),
            timeout=draw.choice([None, 0.015, 0.05]) if lasting else None,
            grace=draw.choice([0.01, 0.05]),
            concurrent=concurrent,
            on_repeat=repeat,
            goes_on=self._goes_on(action) if repeat == "restart" and draw.random() < 0.6 else None,
            group=name if lasting and grouped and not concurrent else None,
            **options,
        )

    def _sensor(self, name, *, grounded=False, **options):
        age = self.draw.choice([None, None, None, 0.02, 0.05])
        if grounded:
            self.grounded.append(f"readings/{name}")
            self.manager.sensor(name, (f"readings/{name}", int), self._when(name), max_age=age, **options)
        else:
            self.sensors.append(self.manager.sensor(name, max_age=age, **options))

    def _event(self, name):
        self.events.append(self.manager.event(name))

    def _add_places(self):
        self.places = Places(row_of_rooms(*ROOMS), self.manager, max_age=self.draw.choice([0.05, 1.0]))
        names = [f"rooms_{kind}" for kind in range(2)]
        factor = mdm.StateFactor("where", list(ROOMS))
        self.tops.append(self.places)
        policy = self._policy(len(ROOMS), 2)
        self.tops.append(self._ensemble("rooms", names, 1, states=[factor], policy=policy))

    # -- Functions, which no replay calls ----------------------------------------------------------------------------

    def _calls(self, name):
        if self.behaviour is None:
            self.called.append(name)
        return self.behaviour is None

    def chance(self, chance):
        return self.behaviour.random() < chance

    def _when(self, name):
        def when(reading):
            if self._calls(f"when of {name}"):
                return None
            if self.chance(0.05):
                raise ValueError(TEXT)
            return None if reading < 0 else reading % 2 == 0

        return when

    def _goes_on(self, action):
        def goes_on():
            return not self._calls(f"goes_on of {action}") and self.chance(0.5)

        return goes_on

    def _function(self, action, kind, *, lasting=None):
        lasting = kind in LASTING and kind not in PLAIN if lasting is None else lasting
        if lasting:

            async def act():
                if not self._calls(action):
                    await self._last(kind)

            return act

        def call():
            return None if self._calls(action) else self._call(kind)

        return call

    def _call(self, kind):
        draw = self.behaviour
        if kind == "set":
            self.set_any()
        elif kind == "batch":
            self.set_many()
        elif kind == "raise" and draw.random() < 0.3:
            self.set_any()
            raise ValueError(TEXT)
        elif kind == "command" and draw.random() < 0.3:
            self.command()
        elif kind == "generator" and draw.random() < 0.3:
            return (None for _ in ())
        elif kind == "slow" and draw.random() < 0.3:
            time.sleep(draw.uniform(0, 0.004))
        return None

    async def _last(self, kind):
        draw = self.behaviour
        if draw.random() < 0.2:
            self.set_any()
        pause = draw.choice([0.0, 0.001, 0.005, 0.03])
        if kind == "finished":
            return
        try:
            await asyncio.sleep(pause)
            if kind == "ferry":
                await asyncio.sleep(draw.choice([0.001, 0.004, 0.02]))
            elif kind == "set":
                for _ in range(draw.randint(1, 5)):
                    self.say()
                    await asyncio.sleep(draw.choice([0, 0.002]))
            elif kind == "fail" and draw.random() < 0.7:
                raise ValueError(TEXT)
            elif kind == "endless":
                await asyncio.sleep(60)
            elif kind == "gather":
                await asyncio.gather(self._aside(), self._aside())
            elif kind == "thread":
                await self._in_thread(self._sleep_and_set)
            elif kind == "cancelled" and draw.random() < 0.3:
                raise asyncio.CancelledError
        except asyncio.CancelledError:
            if kind == "swallow":
                await asyncio.sleep(draw.choice([0, 0.003, 0.03]))
                if draw.random() < 0.5:
                    self.set_any()
                return
            if kind == "clean":
                await asyncio.sleep(0.002)
                self.set_any()
            raise

    async def _aside(self):
        await asyncio.sleep(0.001)
        self.say()

    async def _in_thread(self, function):
        """Call a function in a thread; in virtual time the loop waits, or it would matter who is quicker."""
        if not isinstance(asyncio.get_running_loop(), mdm.VirtualEventLoop):
            return await asyncio.to_thread(function)
        thread = threading.Thread(target=function)
        thread.start()
        thread.join()
        return await asyncio.sleep(0)

    def _sleep_and_set(self):
        time.sleep(0.002)
        self.set_any()

    # -- What is said ------------------------------------------------------------------------------------------------

    def set_any(self):
        draw = self.behaviour
        if self.sensors:
            draw.choice(self.sensors).set(draw.choice([True, True, False, False, None]))

    def set_room(self):
        """Leave one room of a group for another, in one update."""
        rooms = [sensor for sensor in self.sensors if sensor.name[-1].isdigit()]
        if rooms:
            chosen = self.behaviour.choice(rooms)
            with self.manager.batch():
                for sensor in rooms:
                    if sensor.name[:-1] == chosen.name[:-1]:
                        sensor.set(sensor is chosen)

    def set_many(self):
        with self.manager.batch():
            for _ in range(self.behaviour.randint(0, 3)):
                self.set_any()
            if self.behaviour.random() < 0.3:
                self.fire()

    def fire(self):
        if self.events:
            self.behaviour.choice(self.events).fire()

    def say(self):
        """Say something, from anywhere in the event loop's thread."""
        draw = self.behaviour
        kinds = ["set", "set", "room", "room", "many", "fire"]
        kinds += ["state"] * 3 * len(self.told) + ["observation"] * 3 * len(self.observing)
        kinds += ["belief", "initial"] * len(self.beliefs) + ["reading"] * len(self.grounded)
        kind = draw.choice(kinds)
        if kind == "set":
            self.set_any()
        elif kind == "room":
            self.set_room()
        elif kind == "many":
            self.set_many()
        elif kind == "fire":
            self.fire()
        elif kind == "reading":
            self.runtime.channel(draw.choice(self.grounded), int).publish(draw.choice([-1, 0, 1, 2, 3]))
        else:
            self._publish(kind)

    def _publish(self, kind):
        draw = self.behaviour
        if kind == "state":
            name, size = draw.choice(self.told)
            self._known(name).publish_state(draw.randrange(size))
        elif kind == "observation":
            name, size = draw.choice(self.observing)
            self._known(name).publish_observation(draw.choice([0, 0, 0, 1, 1, 1, size - 1]))
        else:
            weight = draw.random()
            known = self._known(draw.choice(self.beliefs))
            publish = known.publish_belief if kind == "belief" else known.publish_initial_belief
            publish([weight, 1 - weight])

    def _known(self, name):
        return next(ensemble for ensemble in self.ensembles if ensemble.name == name)

    def command(self):
        """Command an ensemble."""
        draw = self.behaviour
        ensemble = draw.choice(self.ensembles)
        command = draw.choice(["reset", "release", "release", "stop", "start", "start", "resume"])
        if command == "resume":
            ensemble.start(resume=True)
        else:
            getattr(ensemble, command)()

    # -- The run -----------------------------------------------------------------------------------------------------

    async def run(self, runtime, seconds):
        """Start everything, and let things happen for so many seconds."""
        draw = self.behaviour
        self.runtime = runtime
        if draw.random() < 0.3:
            self.set_any()
        for top in self.tops:
            await runtime.start(top)
        self.steady.publish_state(0)
        if self.meddles:
            points = [("top/state", mdm.messages.State), ("predicates/updates", mdm.messages.PredicateUpdate)]
            points += [("top/action", mdm.messages.Action), ("lives", mdm.messages.StateChange)]
            await runtime.start(Meddler(self, draw.sample(points, 2)))
        loop = asyncio.get_running_loop()
        feeder = random.Random(draw.random())
        virtual, ending = isinstance(loop, mdm.VirtualEventLoop), threading.Event()
        thread = threading.Thread(target=self._feed, args=(feeder, ending))
        tasks = [asyncio.create_task(self._walk())]
        if virtual:
            tasks.append(asyncio.create_task(self._feed_virtually(feeder)))
        else:
            thread.start()
        until = loop.time() + seconds
        while loop.time() < until:
            await asyncio.sleep(draw.choice([0, 0, 0.001, 0.004, 0.01]))
            self._happen()
        ending.set()
        for task in tasks:
            task.cancel()
        if not virtual:
            await asyncio.to_thread(thread.join)
        if draw.random() < 0.5:
            self._hold()

    def _hold(self):
        """Hold the event loop, as just before the end, behind what is said at last."""
        for _ in range(self.behaviour.randint(0, 2)):
            self.say()
        time.sleep(self.behaviour.choice([0.002, 0.01, 0.04]))

    def _happen(self):
        draw = self.behaviour
        chance = draw.random()
        if chance < 0.04:
            time.sleep(draw.uniform(0, 0.02))
        elif chance < 0.09:
            self.command()
        elif chance < 0.1 and self.crashes:
            crash(draw.choice([*self.ensembles, self.manager]), ValueError(TEXT))
        else:
            self.say()

    def _feed(self, draw, ending):
        """Set sensors, in a thread, about 100 times a second."""
        while not ending.wait(draw.uniform(0.0, 0.02)):
            self._feed_once(draw)

    async def _feed_virtually(self, draw):
        """Set sensors, in threads, about 100 times a second of virtual time."""
        while True:
            await asyncio.sleep(draw.uniform(0.0, 0.02))
            await self._in_thread(lambda: self._feed_once(draw))

    def _feed_once(self, draw):
        sensors = draw.sample(self.sensors, min(2, len(self.sensors)))
        if draw.random() < 0.3:
            with self.manager.batch():
                for sensor in sensors:
                    sensor.set(draw.choice([True, False]))
        else:
            for sensor in sensors:
                sensor.set(draw.choice([True, False]))
        if self.events and draw.random() < 0.2:
            draw.choice(self.events).fire()

    async def _walk(self):
        x = 1.0
        while self.places is not None:
            x = min(max(x + self.behaviour.gauss(0, 0.8), 0.5), 11.5)
            self.places.see(mdm.maps.Pose(x, 2.0))
            await asyncio.sleep(self.behaviour.uniform(0, 0.02))
