"""What happens in a scenario: who ran which action when, what was raised, and how it ended."""

from __future__ import annotations

import asyncio

from mdm.messages import Control


class Panic(BaseException):
    """What native code may raise."""


ANYTHING = (ValueError, asyncio.CancelledError, Panic, SystemExit)
"""What may be raised where a failure is expected."""


class Run:
    """One run of an action: whose, when it entered and left, in the order of all events, and when in nanoseconds."""

    def __init__(self, robot, action, entered, time, *, safe):
        self.robot, self.action, self.entered, self.time, self.safe = robot, action, entered, time, safe
        self.left = None


class Ending:
    """An end of the runtime, or of an ensemble.

    Attributes:
        names: Whose it is.
        asked: When it was asked for.
        deciding: Who was deciding then.
        began: When it began.
        active: Who was deciding or safe then.
        over: When it was over.
    """

    def __init__(self, names, asked, deciding):
        self.names, self.asked, self.deciding = names, asked, deciding
        self.began, self.active, self.over = None, set(), None


class Journal:
    """What happens, in its order; what must never happen is found at once.

    Args:
        random: Draws what is raised.

    Attributes:
        runs: Every run of an action.
        overlaps: Those that began while another of the same agent was live, as is right where that was abandoned.
        limits: How many seconds an action may take, where it heeds its cancellation.
        beside: The actions that run beside others.
        raised: The texts of what was raised, each of which must be told.
        exits: The texts of those that end the program.
        answers: What was raised to callers, who are thereby told.
        endings: The ends of ensembles and of the runtime.
        decisions: What was decided, and when.
        blind: The ensembles over states that have been told no state since they, or what their states come from, ended,
            and when that was.
        cautious: Those that go safe whatever way their state turns unknown, within the turn.
        due: What each had decided by then, to begin when the action before has ended.
        sent: What each had decided, or was told to decide, in the turn, ahead of what tells of the loss.
        wrong: What must not be, in sentences.
    """

    def __init__(self, random):
        self._random = random
        self.robots, self.parents = {}, {}
        self.runtime = None
        self.runs, self.overlaps, self.limits, self.beside = [], [], {}, set()
        self.raised, self.exits, self.answers, self.endings, self.wrong = [], [], [], [], []
        self.lives, self.faults, self.modes, self.decisions = [], [], [], []
        self.blind, self.cautious, self.due, self.sent = {}, set(), {}, {}
        self.order = 0

    def now(self):
        """Return the time in nanoseconds."""
        return self.runtime.clock.now()

    def above(self, name):
        """Return an ensemble's name and those of the ensembles above it."""
        names = []
        while name is not None:
            names.append(name)
            name = self.parents.get(name)
        return names

    def path(self, name):
        """Return the path of an ensemble."""
        return "/".join(reversed(self.above(name)))

    # -- Actions -------------------------------------------------------------------------------------------------

    def enter(self, robot, action, *, safe):
        """Note the begin of an action."""
        self.order += 1
        run = Run(robot, action, self.order, self.now(), safe=safe)
        if not safe:
            if self.runtime.ending:
                self.wrong.append(f"the runtime ends, but {action} of {robot} starts")
            now = self.blind.get(robot) == self.now()
            decided = now and action in self.sent[robot]
            if robot not in self.cautious:
                decided = now or self.due.get(robot) == action
            if robot in self.blind and not decided:
                self.wrong.append(f"{robot} knows no state, but {action} starts")
            for above in self.above(robot):
                if self.robots[above].mode == "safe":
                    self.wrong.append(f"{above} is safe, but {action} of {robot} starts")
        for other in self.runs:
            if other.robot == robot and other.left is None and not self._side_by_side(other, run):
                self.overlaps.append((other, run))
        self.runs.append(run)
        return run

    def _side_by_side(self, one, other):
        return not (one.safe or other.safe) and not self.beside.isdisjoint({one.action, other.action})

    def leave(self, run):
        """Note the end of an action."""
        self.order += 1
        run.left = self.order
        limit = None if run.safe else self.limits.get(run.action)
        if limit is not None and self.now() - run.time > (limit + 0.5) * 1e9:
            self.wrong.append(f"{run.action} of {run.robot} lasts longer than {limit} s")

    # -- Failures ------------------------------------------------------------------------------------------------

    def forget(self, names):
        """Take it that ensembles know no state any more."""
        for name in names:
            self.blind[name] = self.now()
            layer = self.robots[name].action
            pending = layer._pending
            self.due[name] = None if pending is None else pending[0]
            queue = () if self.runtime is None else self.runtime.dispatcher.queue
            sent = [message.index for subscription, message in queue if subscription.actor is layer and message]
            asked = any(isinstance(message, Control) and message.time == self.now() for _, message in queue)
            self.sent[name] = layer.names if asked else [layer.names[index] for index in sent]

    def throw(self, kinds=ANYTHING):
        """Raise something."""
        kind = self._random.choice(kinds)
        raise kind(self.text(leaving=kind is SystemExit))

    def now_and_then(self, kinds=ANYTHING, chance=0.04):
        """Raise something, or not."""
        if self._random.random() < chance:
            self.throw(kinds)

    def text(self, *, leaving=False):
        """Return a text that must be told once it was raised."""
        text = f"injected #{len(self.raised) + len(self.exits)}#"
        (self.exits if leaving else self.raised).append(text)
        return text

    # -- Ends ----------------------------------------------------------------------------------------------------

    def ends(self, names):
        """Note that ensembles are about to end, and return that."""
        self.order += 1
        names = set(names)
        ending = Ending(names, self.order, {name for name in names if self.robots[name].mode == "deciding"})
        self.endings.append(ending)
        return ending

    def begins(self, ending):
        """Note that an end begins, which may be a little after it was asked for."""
        if ending.began is None:
            self.order += 1
            ending.began = self.order
            ending.active = {name for name in ending.names if self.robots[name].active}

    def hear(self, change):
        """Hear what becomes of an actor."""
        for ending in self.endings:
            if change.state == "stopping" and ending.over is None and change.actor in ending.names:
                self.begins(ending)
