"""A search of what may happen to three ensembles above each other: safe modes, lives, starts, stops, aborts, the end.

Every sequence of events up to a length is played on the real layers in virtual time; of sequences that lead to the same
situation one is gone on with. `python -m ladder 20000` plays so many.
"""

from __future__ import annotations

import asyncio
import sys
from collections import deque

from mdm import Ensemble, bind
from mdm.actors.safety.modes import Try
from mdm.policies import DeterministicPolicy
from mdm.testing import run_virtual

DRIVE = object()
"""The group of actions that replace each other."""

WAIT = "what was cancelled ends"

DECIDED = {"top": ("Mid", "Rest"), "mid": ("Low", "Left", "Right", "Sing"), "low": ("Work", "Turn")}


class Wrong(Exception):
    """What must not happen has happened."""


class Body:
    """A function that runs: it ends when it is told to, and a second after it was cancelled."""

    def __init__(self, robot, name):
        self.robot, self.name = robot, name
        self.end: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        self.cancelled = False


class Ladder:
    """Three ensembles: `top` has `mid` as an action, and that one `low`."""

    def __init__(self):
        self.running: list[Body] = []
        self.begun: list[tuple[str, str]] = []
        low = self._robot("low", {"Work": self._task("low", "Work"), "Turn": self._plain("low", "Turn")})
        drives = {name: bind(self._task("mid", name), group=DRIVE) for name in ("Left", "Right")}
        sing = bind(self._task("mid", "Sing"), concurrent=True)
        mid = self._robot("mid", {"Low": low, **drives, "Sing": sing})
        top = self._robot("top", {"Mid": mid, "Rest": self._plain("top", "Rest")})
        self.robots = {"top": top, "mid": mid, "low": low}
        self.ending = False

    def _robot(self, name, actions):
        policy = DeterministicPolicy([*range(len(actions))], num_actions=len(actions))
        return Ensemble(name, policy=policy, actions=actions, safe_action=self._task(name, "SAFE"))

    def _task(self, robot, name):
        async def run():
            body = self._begin(robot, name)
            try:
                if not await body.end:
                    raise RuntimeError("it fails")
            except asyncio.CancelledError:
                body.cancelled = True
                await asyncio.sleep(1)
                raise
            finally:
                self.running.remove(body)

        return run

    def _plain(self, robot, name):
        return lambda: self._check_begin(robot, name)

    def _begin(self, robot, name):
        self._check_begin(robot, name)
        body = Body(robot, name)
        self.running.append(body)
        return body

    def _check_begin(self, name, action):
        robot, beside = self.robots[name], [body for body in self.running if body.robot == name]
        self.begun.append((name, action))
        if action == "SAFE":
            below = {"top": {"mid", "low"}, "mid": {"low"}, "low": set()}[name]
            living = [body.name for body in self.running if body.robot in below and body.robot in self._led(name)]
            if beside or living:
                raise Wrong(f"the safe action of {name} begins beside {[body.name for body in beside] or living}")
            return
        one = robot
        while isinstance(one, Ensemble):
            if one.mode == "safe" or one.safety.ending:
                raise Wrong(f"{action} of {name} begins while {one.name} is {one.mode}")
            one = one.parent
        for body in beside:
            replaced = {body.name, action} <= {"Left", "Right"}
            if not (replaced or "Sing" in {body.name, action}):
                raise Wrong(f"{action} of {name} begins beside {body.name}")

    def _led(self, name):
        """Return the ensembles below that live as an action, and have not been asked to end for another reason."""
        led, robot = set(), self.robots[name]
        while (life := robot.action.lives.current) is not None and life.binding.ensemble is not None:
            robot = life.binding.ensemble
            led.add(robot.name)
        return led

    # -- Events --------------------------------------------------------------------------------------------------

    def events(self):
        """Return what may happen now, by name."""
        found = {}
        for name, robot in self.robots.items():
            for index, action in enumerate(DECIDED[name]):
                found[f"{name} decides {action}"] = lambda robot=robot, index=index: robot.publish_state(index)
            found[f"start {name}"] = robot.start
            found[f"stop {name}"] = robot.stop
            found[f"release {name}"] = robot.release
            found[f"endanger {name}"] = lambda robot=robot: robot.safety.endanger("mine", "", 0)
            found[f"mend {name}"] = lambda robot=robot: robot.safety.reopen(frozenset({"mine"}), 0)
        for body in self.running:
            if not (body.cancelled or body.end.done()):
                for well in (True, False):
                    label = f"{body.name} of {body.robot} {'succeeds' if well else 'fails'}"
                    found.setdefault(label, lambda body=body, well=well: body.end.set_result(well))
        if any(body.cancelled for body in self.running):
            found[WAIT] = lambda: None
        return found

    @property
    def key(self):
        """Return what the situation is."""
        robots = []
        for robot in self.robots.values():
            modes, lives = robot.safety.modes, robot.action.lives
            of = [(life.name, life.ending) for life in lives.living]
            waits = (None if lives.pending is None else lives.pending.name, *lives.behind)
            kept = (modes.mode, modes.leaving, modes.stage, modes.safe_action, frozenset(modes.causes))
            robots.append((*kept, lives.gate, tuple(of), waits, robot.interrupted, robot.awaited, robot.control.acted))
        return (*robots, tuple((body.robot, body.name, body.cancelled) for body in self.running))

    def check(self):
        """Hold what holds between turns."""
        for name, robot in self.robots.items():
            modes, lives = robot.safety.modes, robot.action.lives
            if lives.open != modes.deciding:
                raise Wrong(f"{name} is {modes.mode}, but its actions are {lives.gate.value}")
            if modes.mode == "stopped" and modes.safe_action is not Try.NONE:
                raise Wrong(f"{name} is stopped, and its safe action is due")

    def check_rest(self):
        """Hold what holds when all that ran has ended."""
        for name, robot in self.robots.items():
            modes, lives = robot.safety.modes, robot.action.lives
            if modes.securing or lives.waits or (modes.mode != "deciding" and not lives.quiet):
                raise Wrong(f"{name} is {modes.mode}, and waits for ever")
            if modes.mode == "safe" and not modes.causes:
                raise Wrong(f"{name} is safe without a cause")


def play(sequence):
    """Play events one after the other; return what may follow, and the situation.

    Raises:
        Wrong: If anything happens that must not.
    """
    told, following, key = [], [], None

    async def main(runtime):
        nonlocal following, key
        ladder = Ladder()
        runtime.faults.subscribe(told.append)
        await runtime.start(ladder.robots["top"])
        for robot in ladder.robots.values():
            robot.publish_state(0)
        for name in sequence:
            events = ladder.events()
            if name in events:
                events[name]()
            await asyncio.sleep(1.1 if name == WAIT else 0.001)
            ladder.check()
        following, key = [*ladder.events()], ladder.key
        await _end_all(ladder, 20)
        ladder.check_rest()
        begun = len(ladder.begun)
        stopped = asyncio.ensure_future(runtime.stop(ladder.robots["top"]))
        await _end_all(ladder, 20)
        await stopped
        if ladder.running:
            raise Wrong(f"{ladder.running[0].name} outlives the end")
        last = [one for one in ladder.begun[begun:] if one[1] == "SAFE"]
        if last and last[-1][0] != "top":
            raise Wrong(f"the last word is that of {last[-1][0]}")

    run_virtual(main)
    wrong = [fault.detail for fault in told if "Wrong" in fault.detail]
    if wrong:
        raise Wrong(wrong[0])
    return following, key


async def _end_all(ladder, rounds):
    """Let all that runs end, as often as something new begins."""
    for _ in range(rounds):
        for body in [*ladder.running]:
            if not body.end.done():
                body.end.set_result(True)
        await asyncio.sleep(1.1)


def search(most):
    """Play at most so many sequences, the shorter ones first; return how many situations they lead to."""
    frontier, seen, played = deque([()]), set(), 0
    while frontier and played < most:
        sequence = frontier.popleft()
        try:
            following, key = play(sequence)
        except Exception as error:
            raise AssertionError(f"{' · '.join(sequence)}: {error}") from error
        played += 1
        if key not in seen:
            seen.add(key)
            frontier.extend((*sequence, name) for name in following)
    return len(seen)


if __name__ == "__main__":
    most = int(sys.argv[1])
    print(f"{search(most)} situations of three ensembles, in {most} sequences of events: nothing wrong")
