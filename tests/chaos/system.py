"""A random system: trees of ensembles that share predicate managers, actions of every kind, and faulty actors."""

from __future__ import annotations

import asyncio
import random
from functools import cache

import numpy as np
from chaos.actions import ASYNC, HEEDING, KINDS, SAFE_KINDS, WHOLE
from chaos.journal import Panic

import mdm


class Faulty(mdm.Actor):
    """An actor that may raise something at any point of its life.

    Args:
        name: Its name.
        journal: Raises.
        points: Channels at whose messages it may do so, too.
        supervision: What its failure means.
    """

    def __init__(self, name, journal, points, supervision):
        super().__init__(name, supervision=supervision)
        self._journal, self._points = journal, points

    def _throw(self, *kinds):
        self._journal.now_and_then(*kinds, chance=0.04)

    def on_start(self):
        self._throw()
        for point in self._points:
            self.subscribe(self.runtime.channel(point, *POINTS[point]), lambda _: self._throw())

    def on_running(self):
        self._throw()
        self.spawn(self._work(), name="work")
        self.call_later(3.0, self._throw)

    async def _work(self):
        try:
            await asyncio.sleep(7.0)
        finally:
            self._throw((ValueError, Panic, SystemExit))

    def on_failing(self, error):
        self._throw()

    def on_ending(self):
        self._throw()

    async def on_stopping(self):
        await asyncio.sleep(0.1)
        self._throw()

    def on_stop(self):
        self._throw()


class Predicates(mdm.PredicateManager):
    """A predicate manager that knows nothing more once it has failed or ended.

    Args:
        name: Its name.
        journal: Is told so.
        supervision: What its failure means.
    """

    def __init__(self, name, journal, supervision):
        super().__init__(name, supervision=supervision)
        self._journal, self.users = journal, []

    def on_failing(self, error):
        super().on_failing(error)
        self._forget()

    def on_stop(self):
        super().on_stop()
        self._forget()

    def _forget(self):
        """Take what was told as forgotten, but for what is kept for the next start."""
        self._journal.forget(name for name in self.users if f"{name}0" not in self._backlog.values)


class Robot(mdm.Ensemble):
    """An ensemble that forgets the states that it was told once it has ended.

    Args:
        name: Its name.
        journal: Is told so, where its states come from nobody else; else None.
        options: Of an ensemble.
    """

    def __init__(self, name, journal, **options):
        super().__init__(name, **options)
        self._journal = journal

    def on_stop(self):
        super().on_stop()
        if self._journal is not None:
            self._journal.forget([self.name])


POINTS = {"turn": (list,), "modes": (mdm.messages.Mode,), "decisions": (mdm.messages.Decision,)}
"""Channels on which faulty actors fail in the middle of a turn."""


@cache
def model(actions):
    """Return a model whose third observation is impossible."""
    return mdm.models.POMDP(
        [np.array([[0.7, 0.3], [0.2, 0.8]])] * len(actions),
        [np.array([[0.8, 0.2, 0.0], [0.3, 0.7, 0.0]])] * len(actions),
        np.zeros((2, len(actions))),
        discount=0.9,
        actions=actions,
    )


class Lively:
    """Draws what ensembles do after an action's end, of two scenarios in five: the others are as they were before.

    Args:
        seed: The scenario's.
        journal: Is told of it.
    """

    def __init__(self, seed, journal):
        self._random = random.Random(seed)
        self._journal = journal
        self._asked = seed % 5 in {1, 3}

    def reaction(self, other):
        """Return what a failed action means."""
        return "decide" if self._asked and self._random.random() < 0.4 else other

    def patience(self):
        """Return after how many seconds idleness is told."""
        return self._random.choice([None, 2.0]) if self._asked else None

    def sequel(self, action):
        """Return what the end of an action is followed by."""
        if not self._asked:
            return {}
        then = self._journal.then[action] = self._random.choice([None, "wait", "decide", "decide"])
        pause, attempts = self._random.choice([0.5, 2.0]), self._random.choice([None, None, 2])
        if then == "decide" and attempts is None:
            self._journal.again.add(action)
        return {"then": then, "pause": pause, "attempts": attempts}


class System:
    """What runs.

    Args:
        random: Draws it.
        journal: Knows its ensembles.
        actions: Makes their actions.
        lively: Draws what their ends are followed by.

    Attributes:
        tops: The ensembles at the top of the runtime.
        managers: Of each ensemble, by name.
        states: How many states each has; 0 where it decides on observations.
        layered: The ensembles whose observations come from events.
        grounded: The ensembles whose predicates are grounded on a channel.
        told: The ensembles whose states code publishes.
    """

    def __init__(self, random, journal, actions, lively):
        self._random, self._journal, self._actions, self._lively = random, journal, actions, lively
        self.managers, self.states = {}, {}
        self.layered, self.grounded, self.told = set(), set(), set()
        shared, self.tops = self._manager("shared"), []
        for place in range(random.choice([1, 1, 1, 2, 3])):
            name = "rst"[place]
            manager = self._manager(f"{name}m") if random.random() < 0.25 else shared
            self.tops.append(self._robot(name, random.randint(1, 3 if place == 0 else 2), manager))

    def _manager(self, name):
        restart = mdm.Restart(limit=2, within=60.0, backoff=0.5)
        return Predicates(name, self._journal, self._random.choice(["escalate", "escalate", restart]))

    def _robot(self, name, levels, manager):
        draw, count = self._random, self._random.randint(2, 4)
        self.managers[name] = manager
        by_observations = draw.random() < 0.2
        grouped = draw.choice([0.0, 0.0, 0.9])
        options = self._observing(name, manager, count) if by_observations else self._seeing(name, manager, count)
        actions = {}
        for index in range(count):
            action = f"{name}_go{index}"
            if levels > 1 and index == 0:
                below = self._robot(f"{name}{'abc'[index]}", levels - 1, manager)
                self._journal.parents[below.name] = name
                actions[action] = mdm.bind(below, resume=draw.random() < 0.3)
            else:
                actions[action] = self._bound(name, action, grouped)
        safe = f"{name}_go{count - 1}" if draw.random() < 0.25 else None
        if safe is not None:
            function = self._actions.make(draw.choice(SAFE_KINDS), name, safe, both=True)
            actions[safe] = mdm.bind(function, grace=draw.choice([0.5, 2.0]))
            self._journal.limits.pop(safe, None)
            self._journal.beside.discard(safe)
            self._journal.groups.pop(safe, None)
            self._journal.then.pop(safe, None)
            self._journal.whole.discard(safe)
            self._journal.again.discard(safe)
        else:
            safe = self._actions.make(draw.choice(SAFE_KINDS), name, "safe", safe=True)
        robot = Robot(
            name,
            self._journal if name in self.told else None,
            predicates=manager,
            actions=actions,
            safe_action=safe,
            safe_timeout=draw.choice([1.0, 3.0]),
            supervision=draw.choice(["escalate", "escalate", "stop", mdm.Restart(limit=3, within=60.0, backoff=0.5)]),
            drive=draw.choice(["event", "event", 2.0]),
            on_failed_action=self._lively.reaction(draw.choice(["safe", "continue"])),
            idle_after=self._journal.patience.setdefault(name, self._lively.patience()),
            on_lost_input=(lost := draw.choice(["safe", "safe", "continue"])),
            on_unknown=(unknown := draw.choice(["safe", "safe", "continue"])),
            deadline=draw.choice([None, None, 1.0]),
            **options,
        )
        if draw.random() < 0.2:
            supervision = draw.choice(["escalate", "stop", mdm.Restart(limit=2, within=60.0, backoff=0.5)])
            points = draw.sample(list(POINTS), draw.randint(0, 1))
            robot.add(Faulty("faulty", self._journal, points, supervision))
        if lost == unknown == "safe":
            self._journal.cautious.add(name)
        self._journal.robots[name] = robot
        return robot

    def _bound(self, name, action, grouped):
        draw, kind = self._random, self._random.choice(KINDS)
        limit = draw.choice([None, None, 5.0])
        concurrent = draw.random() < 0.1
        if kind in HEEDING:
            self._journal.limits[action] = limit
        if kind in WHOLE:
            self._journal.whole.add(action)
        of_group = kind in ASYNC and not concurrent and draw.random() < grouped
        if concurrent:
            self._journal.beside.add(action)
        if of_group:
            self._journal.groups[action] = name
        elif kind == "scoped":
            self._journal.arriving.add(action)
        return mdm.bind(
            self._actions.make(kind, name, action),
            grace=draw.choice([0.5, 2.0]),
            timeout=limit,
            concurrent=concurrent,
            on_repeat=draw.choice(["continue", "continue", "restart"]),
            group=name if of_group else None,
            may_succeed=kind == "scoped",
            **self._lively.sequel(action),
        )

    def _seeing(self, name, manager, actions):
        """Return what an ensemble over states takes."""
        draw = self._random
        states = self.states[name] = draw.randint(2, 3)
        names = [f"{name}{state}" for state in range(states)]
        policy = mdm.policies.DeterministicPolicy([draw.randrange(actions) for _ in names], actions)
        self._journal.blind[name] = -1
        if draw.random() < 0.2:
            self.told.add(name)
            return {"policy": policy}
        manager.users.append(name)
        initial = draw.random() < 0.1
        if initial:
            del self._journal.blind[name]
        grounded = draw.random() < 0.2
        if grounded:
            self.grounded.add(name)
        for state, predicate in enumerate(names):
            place = (f"{name}/readings", int) if grounded else None
            when = self._when(state) if grounded else None
            begins = state == 0 if initial else None
            manager.sensor(predicate, place, when, max_age=draw.choice([None, None, 3.0]), initial=begins)
        if draw.random() < 0.15:  # whoever uses this end takes care of it
            manager.latch(f"{name}latch", set=f"{name}_go1.failed", reset=f"{name}0")
        if draw.random() < 0.15:
            manager.define(f"{name}held", f"{name}1 and not {name}0", held_for=0.5)
        return {
            "policy": policy,
            "states": [mdm.StateFactor(f"{name}state", names, draw.choice([None, None, "hold", "error"]))],
        }

    def _when(self, state):
        def when(reading):
            self._journal.now_and_then(chance=0.02)
            return None if reading < 0 else reading == state

        return when

    def _observing(self, name, manager, actions):
        """Return what an ensemble over beliefs takes."""
        draw = self._random
        self.states[name] = 0
        options = {
            "policy": mdm.policies.AlphaVectors(np.eye(2), [draw.randrange(actions) for _ in range(2)], actions),
            "model": model(tuple(f"{name}_go{index}" for index in range(actions))),
            "on_impossible": draw.choice(["predict", "keep", "reset", "safe_action", "safe_action"]),
            "after_safe": draw.choice(["reset", "keep"]),
            "horizon": draw.choice([None, None, 5]),
        }
        if draw.random() < 0.5:
            self.layered.add(name)
            events = [f"{name}{symbol}" for symbol in range(3)]
            for event in events:
                manager.event(event)
            options["observations"] = [mdm.ObservationFactor(f"{name}observation", events)]
        return options
