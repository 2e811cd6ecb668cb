"""What the demo shows: the floor with the robot, and what it observes, decides and does, and why."""

from __future__ import annotations

import math
from collections import deque
from itertools import zip_longest
from typing import TYPE_CHECKING

from building import World, building, floor, robot
from panel import INKS, SIGNS, WHO, Row, happened, legend, told
from terminal import Terminal

import mdm
from mdm.messages import ActionLife, Decision, Fault, PredicateUpdate
from mdm.views.floor import FloorView, Mark

if TYPE_CHECKING:
    from mdm.views.floor import Film
    from mdm.views.palette import Palette

PICTURES = 2  # a second, in a film
LAST, MOST = 3, 50  # of what happened, below the panel and beside the floor
STRETCH = 2.5  # how many times as wide as it is the floor may be drawn
BESIDE = 140  # columns of a terminal that has room for the panel beside the floor
PANEL = 62
CAUSES = {  # of decisions where nothing in their state has changed
    "start": "it starts", "resume": "it is in charge again", "again": "its last action has ended",
}  # fmt: skip
TRAIL = 60  # points of the way that the robot has come,
APART = 0.3  # so many metres from each other


class Display(mdm.Actor):
    """Shows everything that happens: a monitor is an actor beside the others."""

    def __init__(self, system: mdm.System, *, moving: bool, palette: Palette, film: Film | None) -> None:
        super().__init__("display")
        self.system = system
        self.moving, self.palette, self.film = moving, palette, film
        self.terminal = Terminal()
        self.view = FloorView(floor)
        self.last: deque[tuple[float, str, str]] = deque(maxlen=MOST)
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

    def panel(self) -> list[Row]:
        """Return what the robot observes, decides and does, and why."""
        known = ", ".join(f"the {one.kind} in {one.place}" for one in World.known.values())
        rows = [
            Row("observes", "senses", f"in {self.place()}; knows of {known or 'nothing to see to'}"),
            Row("top decides", "top", f"{self.decided['top']}{self.why['top']}"),
            Row("patrol decides", "patrol", f"{self.decided['patrol']}{self.why['patrol']}"),
            Row("does", "action", self.to_go()),
        ]
        if self.decided["top"] != "Patrol":
            rows[2] = Row("patrol decides", "patrol", "nothing, until top decides Patrol")
        return rows

    def draw(self) -> None:
        """Draw the floor in the place of the last one, and what the robot observes, decides and does."""
        columns, rows = self.terminal.size
        is_beside = columns >= BESIDE
        wide, high = (columns - PANEL - 2, rows) if is_beside else (columns, max(4, rows - 5 - LAST))
        drawn = self.view.text(
            self.marks(), trail=self.trail, columns=wide, rows=high, palette=self.palette, stretch=STRETCH
        ).splitlines()
        room = PANEL if is_beside else columns
        signs = legend(self.seconds(), room, self.palette)
        panel = signs if is_beside else signs[:1]
        for row in self.panel():
            most = 4 if is_beside else 2 if "decides" in row.label else 1
            panel += [*([""] if is_beside else []), *row.lines(room, most, self.palette)]
        panel += [""] if is_beside else []
        kept = max(0, rows - len(panel) - (0 if is_beside else len(drawn)))
        panel += [happened(*one, room, self.palette) for one in [*self.last][max(0, len(self.last) - kept) :]]
        if is_beside:
            far = f"\x1b[{wide + 3}G"  # whatever stands left of it
            shown = [f"{line}{far}{text}" for line, text in zip_longest(drawn, panel, fillvalue="")]
        else:
            shown = [*drawn, *panel]
        self.terminal.show(shown[:rows])

    def shoot(self) -> None:
        """Take a picture, with the panel below it."""
        assert self.film is not None
        rows = [f"{row.label}: {row.text}" for row in self.panel()]
        latest = "{1}: {2}".format(*self.last[-1]) if self.last else ""
        title = "\n".join([*rows, f"{self.seconds():.1f} s  {latest}"])
        self.film.add(self.marks(), title, trail=self.trail)

    def place(self) -> str:
        """Return where the robot is, as its predicates have it."""
        values = self.system.predicates.values()
        return next((name for name in floor.labels.names if values[name]), "no room that it knows of")

    def to_go(self) -> str:
        """Return what the robot does."""
        metres, goal = robot().remaining, robot().goal
        if goal is None or not metres:
            return "stands"
        target = next((node.name for node in floor.graph.nodes if node.goal == goal), "its goal")
        return f"drives to {target}, {metres:.1f} m to go"

    # -- What happens --------------------------------------------------------------------------------------------

    def show(self, who: str, text: str) -> None:
        """Print a line with the time since the start, or keep it for the screen."""
        self.last.append((self.seconds(), who, text))
        if not self.moving:
            print(self.palette.inked(told(*self.last[-1]), WHO[who]), flush=True)

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
            f"{factor} is {symbol}, was {before[factor]}"
            for factor, symbol in symbols.items()
            if before.get(factor, symbol) != symbol
        ]
        self.why[name] = f", since {', and '.join(changed) or CAUSES.get(decision.cause, decision.cause)}"
        self.why[name] += f": the policy's action in '{words}'"
        self.decided[name] = str(decision.action_name)
        self.show(name, f"the state is '{words}': {decision.action_name}")

    def on_life(self, life: ActionLife) -> None:
        """Show how actions of the top level end, and all that fail."""
        if life.status != "running" and (life.ensemble == "top" or life.status not in {"succeeded", "preempted"}):
            self.show("action", f"{life.action} {life.status.replace('_', ' ')}")

    def on_fault(self, fault: Fault) -> None:
        """Show a fault."""
        self.show("fault", f"{fault.source}: {fault.detail}")
