"""What the demo shows: the floor with the robot, and what it observes, decides and does, and why."""

from __future__ import annotations

import math
import shutil
from collections import deque
from itertools import zip_longest
from typing import TYPE_CHECKING

from building import World, building, floor, robot

import mdm
from mdm.messages import ActionLife, Decision, Fault, PredicateUpdate
from mdm.views.floor import FloorView, Mark

if TYPE_CHECKING:
    from mdm.views.film import Film

INKS = {"robot": (30, 80, 220), "person": (16, 120, 50), "intruder": (150, 40, 160), "fire": (196, 52, 8)}
SIGNS = {"person": "P", "intruder": "I", "fire": "F"}
LINES = {  # the colour of a line, which can be read on black and on white
    "world": (7, 131, 131), "senses": (152, 110, 4), "top": (175, 71, 202), "patrol": (44, 110, 238),
    "action": (7, 136, 43), "fault": (234, 12, 26),
}  # fmt: skip
PICTURES = 2  # a second, in a film
LAST, MOST = 3, 30  # of what happened, below the panel and beside the floor
STRETCH = 2.5  # how many times as wide as it is the floor may be drawn
BESIDE = 140  # columns of a terminal that has room for the panel beside the floor
PANEL = 62
TRAIL = 60  # points of the way that the robot has come,
APART = 0.3  # so many metres from each other


class Display(mdm.Actor):
    """Shows everything that happens: a monitor is an actor beside the others."""

    def __init__(self, system: mdm.System, *, moving: bool, colour: bool, film: Film | None) -> None:
        super().__init__("display")
        self.system = system
        self.moving, self.colour, self.film = moving, colour, film
        self.view = FloorView(floor)
        self.last: deque[tuple[str, str]] = deque(maxlen=MOST)
        self.trail: deque[tuple[float, float]] = deque(maxlen=TRAIL)
        self.decisions = {"top": 0, "patrol": 0}
        self.decided = {"top": "nothing yet", "patrol": "nothing yet"}
        self.why = {"top": "", "patrol": ""}
        self.values: dict[str, dict[str, str]] = {"top": {}, "patrol": {}}

    def on_start(self) -> None:
        """Listen to decisions, actions, predicates and faults."""
        self.began = self.runtime.clock.now()
        World.tell = lambda text: self.show("world", text)
        self.subscribe(self.runtime.decisions, self.on_decision)
        self.subscribe(self.runtime.faults, self.on_fault)
        self.subscribe(self.runtime.channel("predicates/updates", PredicateUpdate), self.on_predicates)
        for ensemble in self.system.ensembles.values():
            self.subscribe(self.runtime.channel(f"{ensemble.path}/lives", ActionLife), self.on_life)
        if self.moving or self.film is not None:
            self.every(5.0, lambda _: self.follow())
        if self.moving:
            print("\x1b[2J", end="")
            self.every(5.0, lambda _: self.draw())
        if self.film is not None:
            self.every(PICTURES, lambda _: self.shoot())

    # -- What there is to see ------------------------------------------------------------------------------------

    def seconds(self) -> float:
        """Return the time since the start."""
        return (self.runtime.clock.now() - self.began) / 1e9

    def follow(self) -> None:
        """Keep the way that the robot has come."""
        here = robot().pose.x, robot().pose.y
        if not self.trail or math.dist(here, self.trail[-1]) >= APART:
            self.trail.append(here)

    def marks(self) -> list[Mark]:
        """Return what is on the floor: where the robot drives to, who and what is there, and the robot."""
        pose, goal = robot().pose, robot().goal
        visits = [visit for kind in SIGNS for visit in building().present(kind)]
        marks = [] if goal is None else [Mark(goal.x, goal.y, "X", ink=INKS["robot"])]
        marks += [Mark(one.x, one.y, SIGNS[one.kind], ink=INKS[one.kind]) for one in visits]
        return [*marks, Mark(pose.x, pose.y, yaw=pose.yaw, ink=INKS["robot"])]

    def panel(self) -> list[str]:
        """Return what the robot observes, decides and does, and why."""
        known = ", ".join(f"the {one.kind} in {one.place}" for one in World.known.values())
        lines = [
            f" observes  it is in {self.place()}; knows of {known or 'nothing to see to'}",
            f"  decides  {self.decided['top']}{_because(self.why['top'])}",
        ]
        if self.decided["top"] == "Patrol":
            lines.append(f"           of the ways {self.decided['patrol']}{_because(self.why['patrol'])}")
        lines.append(f"     does  {self.to_go()}")
        return lines

    def draw(self) -> None:
        """Draw the floor in the place of the last one, and what the robot observes, decides and does."""
        columns, rows = shutil.get_terminal_size()
        panel = [f"{self.seconds():7.1f} s  {self.legend()}", *self.panel()]
        is_beside = columns >= BESIDE
        wide, high = (columns - PANEL - 2, rows - 1) if is_beside else (columns, rows - 1 - 5 - LAST)
        drawn = self.view.text(
            self.marks(), trail=self.trail, columns=wide, rows=max(4, high), colours=self.colour, stretch=STRETCH
        ).splitlines()
        if is_beside:
            lines = [line for text in panel for line in _wrapped(text, PANEL)]
            kept = min(len(self.last), max(0, high - len(lines) - 1))
            lines = [
                *lines,
                "",
                *(self.inked(who, text[:PANEL]) for who, text in [*self.last][len(self.last) - kept :]),
            ]
            far = f"\x1b[{wide + 3}G"  # whatever stands left of it
            shown = [f"{line}{far}{text}" for line, text in zip_longest(drawn, lines, fillvalue="")]
        else:
            panel += [""] * (5 - len(panel))
            happened = [self.inked(who, text[: columns - 1]) for who, text in [*self.last][-LAST:]]
            shown = [*drawn, *(line[: columns - 1] for line in panel), *happened]
        print("\x1b[H" + "\n".join(f"{line}\x1b[K" for line in shown[: rows - 1]) + "\x1b[J", end="", flush=True)

    def legend(self) -> str:
        """Return what the signs on the floor stand for."""
        return "→ robot  • its trail  X its goal  P person  I intruder  F fire"

    def shoot(self) -> None:
        """Take a picture, with the panel below it."""
        assert self.film is not None
        panel = self.panel()
        panel.insert(-1, "") if len(panel) < 4 else None
        happened = self.last[-1][1].strip() if self.last else ""
        title = "\n".join([*(line.strip() or " " for line in panel), f"{self.seconds():.1f} s  {happened}"])
        self.film.add(self.marks(), title, trail=self.trail)

    def place(self) -> str:
        """Return where the robot is, as its predicates have it."""
        values = self.system.predicates.values()
        return next((name for name in floor.labels.names if values[name]), "nowhere known")

    def to_go(self) -> str:
        """Return what the robot does."""
        metres, goal = robot().remaining, robot().goal
        if goal is None or not metres:
            return "stands"
        target = next((node.name for node in floor.graph.nodes if node.goal == goal), "its goal")
        return f"drives to {target}, {metres:.1f} m to go"

    # -- What happens --------------------------------------------------------------------------------------------

    def inked(self, who: str, text: str) -> str:
        """Return a line in the colour of whom it is about."""
        return "\x1b[38;2;{};{};{}m{}\x1b[0m".format(*LINES[who], text) if self.colour else text

    def show(self, who: str, text: str) -> None:
        """Print a line with the time since the start, or keep it for the screen."""
        line = f"{self.seconds():7.1f} s {who:>7}  {text}"
        self.last.append((who, line))
        if not self.moving:
            print(self.inked(who, line), flush=True)

    def on_predicates(self, update: PredicateUpdate) -> None:
        """Show what became true or false, once the first values are known: what is observed, and where the robot is."""
        for name in (*update.rising, *update.falling):
            rising = name in update.rising
            if name in floor.labels.names and rising:
                self.show("senses", f"the robot is in {name}")
            elif "." not in name and name not in floor.labels.names and update.counter > 1:
                self.show("senses", f"{name} is {'true' if rising else 'false'} now")

    def on_decision(self, decision: Decision) -> None:
        """Show a decision, and by which state; keep what of that has changed."""
        name = decision.ensemble.rpartition("/")[2]
        self.decisions[name] += 1
        assert decision.state is not None
        model = self.system.ensembles[name].controller.model
        assert model is not None
        factors = model.state_space.factors
        values = dict(zip([one.name for one in factors], model.state_space.unravel(decision.state), strict=True))
        symbols = {one.name: one.names[values[one.name]] for one in factors}
        if name == "top":
            words = "+".join(factor for factor, value in values.items() if value) or "calm"
        else:
            position, halfway = symbols.values()
            words = f"{position}, {'second' if halfway == 'yes' else 'first'} half of the round"
        before, self.values[name] = self.values[name], symbols
        changed = [
            f"{factor} has become {symbol}" for factor, symbol in symbols.items() if before.get(factor) != symbol
        ]
        self.why[name] = (
            " and ".join(changed) if before and changed else f"the state is '{words}'{' still' if before else ''}"
        )
        self.decided[name] = str(decision.action_name)
        self.show(name, f"the state is '{words}': {decision.action_name}")

    def on_life(self, life: ActionLife) -> None:
        """Show how actions of the top level end, and all that fail."""
        if life.status != "running" and (life.ensemble == "top" or life.status not in {"succeeded", "preempted"}):
            self.show("action", f"{life.action} {life.status.replace('_', ' ')}")

    def on_fault(self, fault: Fault) -> None:
        """Show a fault."""
        self.show("fault", f"{fault.source}: {fault.detail}")


def _because(why: str) -> str:
    return f", since {why}" if why else ""


def _wrapped(text: str, wide: int) -> list[str]:
    """Return a line of the panel as several, with what it says below each other."""
    lines = [text]
    while len(lines[-1]) > wide:
        cut = lines[-1].rfind(" ", 12, wide)
        if cut < 0:
            return [*lines[:-1], lines[-1][:wide]]
        lines[-1:] = [lines[-1][:cut], " " * 11 + lines[-1][cut + 1 :]]
    return lines
