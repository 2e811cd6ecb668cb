"""What happens in a scenario: who ran which action when, what was raised, and how it ended."""

from __future__ import annotations

import asyncio

from mdm.messages import Control

HEARD = ("decisions", "modes", "lives", "faults")
"""What `Journal.heard` returns."""


class Panic(BaseException):
    """What native code may raise."""


ANYTHING = (ValueError, asyncio.CancelledError, Panic, SystemExit)
"""What may be raised where a failure is expected."""


LIVING = {"running", "stopping"}
"""Where an ensemble stands when its mode is that of this life."""


class Run:
    """One run of an action: whose, when it entered and left, in the order of all events, and when in nanoseconds."""

    def __init__(self, robot, action, entered, time, *, safe):
        self.robot, self.action, self.entered, self.time, self.safe = robot, action, entered, time, safe
        self.left = self.until = None


class Ending:
    """An end of the runtime, or of an ensemble.

    Attributes:
        names: Whose it is.
        asked: When it was asked for.
        deciding: Who was deciding then.
        began: When it began.
        active: Who was deciding or safe then.
        over: When it was over.
        time: When it was asked for, in nanoseconds.
        until: When it was over, in nanoseconds.
    """

    def __init__(self, names, asked, deciding, time):
        self.names, self.asked, self.deciding, self.time = names, asked, deciding, time
        self.began, self.active, self.over, self.until = None, set(), None, None


class Journal:
    """What happens, in its order; what must never happen is found at once.

    Args:
        random: Draws what is raised.
        texts: Makes the texts that are raised, and raises them.

    Attributes:
        runs: Every run of an action.
        overlaps: Those that began while another of the same agent was live, as is right where that was abandoned.
        limits: How many seconds an action may take, where it heeds its cancellation.
        beside: The actions that run beside others.
        groups: The group of each action that is of one: what such a one replaces may still live.
        then: What each action says of what its end is followed by.
        again: The actions each failure of which is followed by a decision.
        whole: The actions of which nothing lives that the library does not know of.
        excused: The texts of cleanups that failed after something else had been decided: no cause of the safe mode.
        patience: Seconds of idleness after which each ensemble is told to have nothing to do; None for the default.
        inside: Does something in the name of a robot's action, or None.
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
        own: Messages of the program's own that a record can hold.
        unfit: How many of them it cannot.
        slack: Seconds by which all may be late.
        wrong: What must not be, in sentences.
    """

    def __init__(self, random, texts):
        self._random, self._texts = random, texts
        self.robots, self.parents = {}, {}
        self.runtime = None
        self.runs, self.overlaps, self.limits, self.beside = [], [], {}, set()
        self.arriving = set()
        self.raised, self.exits, self.answers, self.endings, self.wrong = [], [], [], [], []
        self.lives, self.faults, self.modes, self.decisions = [], [], [], []
        self.blind, self.cautious, self.due, self.sent = {}, set(), {}, {}
        self.groups, self.inside, self._told = {}, None, {}
        self.then, self.patience = {}, {}
        self.again, self.whole, self.excused = set(), set(), []
        self._living, self._newest, self._last, self._begun = {}, {}, {}, {}
        self._pauses = {}
        self.own, self.unfit = [], 0
        self.slack = 0.0
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

    def heard(self):
        """Return what was published that nobody who watches may change."""
        decisions = [(time, each.ensemble, each.epoch, each.cause, each.action_name) for time, each in self.decisions]
        modes = [(each.time, each.ensemble, each.mode, [cause.kind for cause in each.causes]) for each in self.modes]
        lives = [[(each.time, each.life, each.action, each.status, each.detail) for each in one] for one in self.lives]
        faults = [fault for fault in self.faults if fault.kind not in {"observer", "record"}]
        return decisions, modes, lives, [(each.time, each.source, each.kind) for each in faults]

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
            if self.robots[robot].mode == "stopped":
                self.wrong.append(f"{robot} is stopped, but its {action} starts")
            for above in self.above(robot):
                if self.robots[above].mode == "safe":
                    self.wrong.append(f"{above} is safe, but {action} of {robot} starts")
                if self.robots[above].safety.ending:
                    self.wrong.append(f"{above} ends, but {action} of {robot} starts")
        elif self.robots[robot].action.life != "running":
            self.wrong.append(f"the safe action of {robot} starts, but its layer is {self.robots[robot].action.life}")
            beside = [other for other in self.runs if other.action == action and other.left is None]
            if beside and action in self.whole and not any(other.safe for other in beside):
                self.wrong.append(f"{action} of {robot} begins beside itself")
        for other in self.runs:
            if other.robot == robot and other.left is None and not self._side_by_side(other, run):
                self.overlaps.append((other, run))
        self.runs.append(run)
        return run

    def _side_by_side(self, one, other):
        group = self.groups.get(one.action)
        grouped = group is not None and group == self.groups.get(other.action)
        beside = grouped or not self.beside.isdisjoint({one.action, other.action})
        return not (one.safe or other.safe) and beside

    def meddle(self, robot):
        """Let an action do something to the system now and then."""
        if self.inside is not None and self._random.random() < 0.08:
            self.inside(robot)

    def leave(self, run):
        """Note the end of an action."""
        self.order += 1
        run.left, run.until = self.order, self.now()
        limit = None if run.safe else self.limits.get(run.action)
        if limit is not None and self.now() - run.time > (limit + 0.5 + self.slack) * 1e9:
            self.wrong.append(f"{run.action} of {run.robot} lasts longer than {limit} s")

    # -- Failures ------------------------------------------------------------------------------------------------

    def forget(self, names):
        """Note that ensembles know no state from now on."""
        for name in names:
            self.blind[name] = self.now()
            layer = self.robots[name].action
            pending = layer.lives.pending
            self.due[name] = None if pending is None else pending.name
            queue = () if self.runtime is None else self.runtime.dispatcher.queue
            sent = [message.index for subscription, message in queue if subscription.actor is layer and message]
            asked = any(isinstance(message, Control) and message.time == self.now() for _, message in queue)
            self.sent[name] = layer.names if asked else [layer.names[index] for index in sent]

    def throw(self, kinds=ANYTHING, *, superseded=False):
        """Raise something, perhaps where something else has been decided."""
        kind = self._random.choice(kinds)
        text = self.text(leaving=kind is SystemExit)
        if superseded and kind is not SystemExit:
            self.excused.append(text)
        self._texts.throw(kind, text)

    def is_superseded(self, run):
        """Whether a run is cancelled since something else was decided."""
        path = self.path(run.robot)
        decided = [each.action_name for _, each in self.decisions if each.ensemble == path]
        return self.robots[run.robot].mode == "deciding" and decided[-1:] not in ([], [run.action])

    def now_and_then(self, kinds=ANYTHING, chance=0.04):
        """Raise something, or not."""
        if self._random.random() < chance:
            self.throw(kinds)

    def text(self, *, leaving=False):
        """Return a text that must be told once it was raised."""
        text = f"injected #{len(self.raised) + len(self.exits)}#"
        (self.exits if leaving else self.raised).append(text)
        return text

    def says(self, message):
        """Note a message of the program's own, and whether a record can hold it."""
        try:
            fits = isinstance(message, str) and bool(message.encode() or True)
        except UnicodeEncodeError:
            fits = False
        if fits:
            self.own.append({"message": message})
        else:
            self.unfit += 1

    # -- Ends ----------------------------------------------------------------------------------------------------

    def ends(self, names):
        """Note that ensembles are about to end, and return that."""
        self.order += 1
        names = set(names)
        ending = Ending(names, self.order, {name for name in names if self.robots[name].mode == "deciding"}, self.now())
        self.endings.append(ending)
        return ending

    def begins(self, ending):
        """Note that an end begins, which may be a little after it was asked for."""
        if ending.began is None:
            self.order += 1
            ending.began = self.order
            # Of those that were deciding when it was asked for, some may have been stopped by hand meanwhile.
            ending.deciding = {name for name in ending.deciding if self.robots[name].mode != "stopped"}
            robots = {name: self.robots[name] for name in ending.names}
            # The mode of one that does not live is that of the life before.
            ending.active = {name for name, robot in robots.items() if robot.active and robot.life in LIVING}

    def ended(self, ending):
        """Note that an end is over."""
        ending.over, ending.until = self.order, self.now()

    # -- What is told --------------------------------------------------------------------------------------------

    def hear_mode(self, mode):
        """Hear the mode of an ensemble."""
        self.modes.append(mode)
        self._told[mode.ensemble] = mode.mode

    def check_modes(self):
        """Hold each mode against what was last told of it; between turns."""
        for name, robot in self.robots.items():
            told = self._told.get(self.path(name), "stopped")
            if robot.life == "running" and robot.mode != told:
                self.wrong.append(f"{name} is {robot.mode}, but {told} was told")

    def hear_life(self, life):
        """Hear of the begin or the end of an action."""
        living = self._living.setdefault(life.ensemble, {})
        if life.status == "running":
            living[life.life] = life.time
            self._pauses.pop(life.ensemble.rpartition("/")[2], None)
            self._newest[life.ensemble] = life.life
        else:
            took = life.time - living.pop(life.life, life.time)
            # What was begun last stands, though another one that it goes on beside ends later.
            if life.life >= self._newest.get(life.ensemble, life.life):
                self._last[life.ensemble] = life.action, life.status, took > 0, life.time

    def check_liveness(self):
        """Hold that whatever decides does something, or waits for what it names, or is idle and told so in time."""
        for name, robot in self.robots.items():
            path = self.path(name)
            # Where one above it ends, nothing of it starts any more, until its turn to end has come.
            ending = any(self.robots[above].safety.ending for above in self.above(name) if above in self.robots)
            free = robot.life == "running" and not (robot.failing or ending or self.runtime.ending)
            if free and robot.mode == "deciding" and robot.control.event_driven and robot.action.life == "running":
                waiting = robot.statistics().waiting
                self._check_pauses(name, waiting)
                lives = robot.action.lives
                _, status, lasted, when = last = self._last.get(path, ("", "", True, 0))
                # One that another of its group has replaced comes to its end, for at most its grace.
                coming = lives.replaced and self.now() < when + 1e9
                coming = coming or self.now() < when + self.slack * 1e9  # what looks waits behind a circle
                if self._living.get(path) or lives.pending or coming or waiting:
                    continue
                if robot.liveness.since is not None:
                    self._check_told(name, robot.liveness.since, last)
                elif lasted or status != "succeeded":
                    self.wrong.append(f"{name} is deciding, does nothing since {last}, and says nothing of it")
            elif free and robot.mode == "safe" and robot.control.event_driven and robot.action.life == "running":
                self._check_way_back(name, robot)

    def _check_way_back(self, name, robot):
        """Hold that a pause leads out of a safe mode that the failure of an action has brought about."""
        [cause, *others] = robot.causes or [None]
        if cause is None or others or cause.kind != "action" or self._living.get(self.path(name)):
            return
        waiting = robot.statistics().waiting
        self._check_pauses(name, waiting)
        actions = [action for action in self.again if f"action {action!r} " in cause.detail]
        if actions and not waiting and self.now() > cause.since:
            self.wrong.append(f"{name} is safe since {actions[0]} has failed, and nothing leads back")

    def _check_pauses(self, name, waiting):
        """Hold that a pause ends after as long as it is said to take."""
        pauses = {text for text in waiting if text.startswith("a pause of ")}
        begun = self._pauses[name] = {text: self._pauses.get(name, {}).get(text, self.now()) for text in pauses}
        for text, since in begun.items():
            if self.now() > since + (float(text.split()[3]) + self.slack) * 1e9 + 1e6:
                self.wrong.append(f"{name} waits since {since / 1e9:.1f} s for {text}")

    def _check_told(self, name, since, last):
        action, status, lasted, _ = last
        patience = self.patience[name]
        if patience is None and (lasted or status not in {"", "succeeded"}):
            patience = 10.0
        if (
            patience is None
            or self.then.get(action) == "wait"
            or self.now() < since + (patience + self.slack) * 1e9 + 1e6
        ):
            return
        if not any(f.kind == "idle" and f.source == self.path(name) and f.time > since for f in self.faults):
            self.wrong.append(f"{name} is idle since {since / 1e9:.1f} s, after {last}, and no fault tells of it")

    def hear_fault(self, fault):
        """Hear a fault: what it says to live must do so."""
        name = fault.source.removesuffix("/action").rpartition("/")[2]
        if "come to its end within" in fault.detail and not self._live(name, below=True):
            self.wrong.append(f"nothing lives in {name}, but it was told: {fault.detail}")
        if fault.detail.endswith("still runs") and not self._live(name):
            self.wrong.append(f"nothing of {name} still runs, but it was told: {fault.detail}")

    def _live(self, name, *, below=False):
        # Of one that has left its function in this moment the end has not come back yet.
        moment = self.now() - self.slack * 1e9
        runs = [run for run in self.runs if run.left is None or run.until >= moment]
        return any(name in (self.above(run.robot) if below else (run.robot,)) for run in runs)

    def hear(self, change):
        """Hear what becomes of an actor."""
        for ending in self.endings:
            if change.state == "stopping" and ending.over is None and change.actor in ending.names:
                self.begins(ending)
