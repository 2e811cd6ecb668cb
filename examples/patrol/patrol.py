"""The demo: a robot patrols a floor of six rooms, and attends to people, intruders and fires.

Everything that decides is declared in ``patrol.toml``; the building that the robot moves in is in ``building.py``. This
file runs the two and shows what happens: in a terminal the floor with the robot on it, else a line for each event, as
with ``--log``. ``--fast`` runs in virtual time, without waiting; ``--film FILE.gif`` (or ``.png``) draws pictures.
"""

from __future__ import annotations

import signal

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the robot is there, Ctrl-C just ends the program

import argparse
import asyncio
import io
import os
import shutil
import sys
import time
from collections import deque
from pathlib import Path

import mdm
from mdm.messages import ActionLife, Decision, Fault, PredicateUpdate
from mdm.views.film import Film
from mdm.views.floor import FloorView, Mark

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

try:
    from building import World, building, floor, robot  # it stands beside this file
except mdm.Error as error:
    sys.exit(f"patrol.py: {error}")

SECONDS = 40.0
COLOURS = {"world": "36", "senses": "33", "top": "1;35", "patrol": "34", "action": "32", "fault": "1;31"}
SIGNS = {"person": ("P", (20, 140, 60)), "intruder": ("I", (150, 40, 160)), "fire": ("F", (220, 70, 20))}
PLURALS = {"person": "people", "intruder": "intruders", "fire": "fires"}
PICTURES = 2  # a second, in a film
LINES = 4  # of what happened, below the floor
LEGEND = "→ robot  P person  I intruder  F fire"


class Display(mdm.Actor):
    """Shows everything that happens: a monitor is an actor beside the others."""

    def __init__(self, system: mdm.System, *, moving: bool, colour: bool, film: Film | None) -> None:
        super().__init__("display")
        self.system = system
        self.moving, self.colour, self.film = moving, colour, film
        self.view = FloorView(floor)
        self.last: deque[str] = deque(maxlen=LINES)
        self.latest = ""
        self.decisions: dict[str, int] = {"top": 0, "patrol": 0}
        self.decided: dict[str, str] = {"top": "nothing yet", "patrol": "nothing yet"}

    def on_start(self) -> None:
        """Listen to decisions, actions, predicates and faults."""
        self.began = self.runtime.clock.now()
        World.tell = lambda text: self.show("world", text)
        self.subscribe(self.runtime.decisions, self.on_decision)
        self.subscribe(self.runtime.faults, self.on_fault)
        self.subscribe(self.runtime.channel("predicates/updates", PredicateUpdate), self.on_predicates)
        for ensemble in self.system.ensembles.values():
            self.subscribe(self.runtime.channel(f"{ensemble.path}/lives", ActionLife), self.on_life)
        if self.moving:
            print("\x1b[2J", end="")
            self.every(5.0, lambda _: self.draw())
        if self.film is not None:
            self.every(PICTURES, lambda _: self.shoot())

    # -- What there is to see ------------------------------------------------------------------------------------

    def seconds(self) -> float:
        """Return the time since the start."""
        return (self.runtime.clock.now() - self.began) / 1e9

    def marks(self) -> list[Mark]:
        """Return what is on the floor."""
        visits = [visit for kind in SIGNS for visit in building().present(kind)]
        pose = robot().pose
        marks = [Mark(one.x, one.y, SIGNS[one.kind][0], ink=SIGNS[one.kind][1]) for one in visits]
        return [*marks, Mark(pose.x, pose.y, yaw=pose.yaw, ink=(30, 80, 220))]

    def draw(self) -> None:
        """Draw the floor in the place of the last one, and below it what the robot observes, decides and does."""
        columns, rows = shutil.get_terminal_size()
        text = self.view.text(self.marks(), columns=columns, rows=max(4, rows - LINES - 5), colours=self.colour)
        known = ", ".join(f"the {one.kind} in {one.place}" for one in World.known.values())
        patrols = f", {self.decided['patrol']}" if self.decided["top"] == "Patrol" else ""
        lines = [
            f"{self.seconds():5.1f} s  {LEGEND}",
            f" observes  {self.place()}; {known or 'nothing to see to'}",
            f"  decides  {self.decided['top']}{patrols}",
            f"     does  {self.to_go()}",
            *self.last,
        ]
        shown = [*text.splitlines(), *(line[: columns - 1] for line in lines)][: rows - 1]
        print("\x1b[H" + "\n".join(f"{line}\x1b[K" for line in shown) + "\x1b[J", end="", flush=True)

    def shoot(self) -> None:
        """Take a picture."""
        assert self.film is not None
        self.film.add(self.marks(), f"{self.seconds():.1f} s  {self.latest}")

    def place(self) -> str:
        """Return where the robot is, as its predicates have it."""
        values = self.system.predicates.values()
        return next((name for name in floor.labels.names if values[name]), "nowhere known")

    def to_go(self) -> str:
        """Return what the robot does."""
        metres = robot().remaining
        return f"drives, {metres:.1f} m to go" if metres else "stands"

    # -- What happens --------------------------------------------------------------------------------------------

    def show(self, who: str, text: str) -> None:
        """Print a line with the time since the start, or keep it for the screen."""
        line = f"{who:>7}  {text}"
        self.last.append(f"{self.seconds():5.1f} s {line}")
        self.latest = f"{who}: {text}"
        if self.colour:
            line = f"\x1b[{COLOURS[who]}m{line}\x1b[0m"
        if not self.moving:
            print(f"{self.seconds():5.1f} s {line}", flush=True)

    def on_predicates(self, update: PredicateUpdate) -> None:
        """Show what became true or false, once the first values are known: what is observed, and where the robot is."""
        for name in (*update.rising, *update.falling):
            rising = name in update.rising
            if name in floor.labels.names and rising:
                self.show("senses", f"the robot is in {name}")
            elif "." not in name and name not in floor.labels.names and update.counter > 1:
                self.show("senses", f"{name} is {'true' if rising else 'false'} now")

    def on_decision(self, decision: Decision) -> None:
        """Show a decision, and by which state."""
        name = decision.ensemble.rpartition("/")[2]
        self.decisions[name] += 1
        assert decision.state is not None
        model = self.system.ensembles[name].controller.model
        assert model is not None
        factors = model.state_space.factors
        values = zip(factors, model.state_space.unravel(decision.state), strict=True)
        if name == "top":
            words = "+".join(factor.name for factor, value in values if value) or "calm"
        else:
            (place, at), (_, halfway) = values
            words = f"{place.names[at]}, {'second' if halfway else 'first'} half of the round"
        self.decided[name] = str(decision.action_name)
        self.show(name, f"the state is '{words}': {decision.action_name}")

    def on_life(self, life: ActionLife) -> None:
        """Show how actions of the top level end, and all that fail."""
        if life.status != "running" and (life.ensemble == "top" or life.status not in {"succeeded", "preempted"}):
            self.show("action", f"{life.action} {life.status.replace('_', ' ')}")

    def on_fault(self, fault: Fault) -> None:
        """Show a fault."""
        self.show("fault", f"{fault.source}: {fault.detail}")


async def patrol(arguments: argparse.Namespace, film: Film | None) -> None:
    """Run the system for a time, and say how it went."""
    system = mdm.load_system(HERE / "patrol.toml")
    seconds = arguments.seconds
    print("The ensembles:\n")
    print("\n".join(f"  {line}" for line in system.tree().splitlines()))
    print(f"\nThe next {seconds:g} seconds:\n", flush=True)
    terminal = sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    colour = terminal and not os.environ.get("NO_COLOR")
    moving = terminal and not arguments.log and not arguments.fast
    display = Display(system, moving=moving, colour=colour, film=film)
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(display)
        await runtime.start(system)
        await asyncio.sleep(seconds)
        latencies = {name: ensemble.action.latency for name, ensemble in system.ensembles.items()}
        idle = system.ensembles["top"].statistics().idle
        where = f"the robot is in {display.place()}, and {display.to_go()}"
    print(f"\nAt the end {where}.\n")
    columns = min(72, shutil.get_terminal_size().columns - 1)
    print(display.view.text(display.marks(), columns=columns, rows=24, colours=colour))
    print("\nWhat it took:\n")
    for name, latency in latencies.items():
        lives = ", ".join(f"{count} {status}" for status, count in sorted(system.ensembles[name].action.ended.items()))
        median = "" if arguments.fast else f"; from stimulus to callback {latency.quantile(0.5) * 1e6:.0f} µs (median)"
        print(f"  {name}: {display.decisions[name]} decisions; actions: {lives}{median}")
    for kind, name in PLURALS.items():
        took = sorted(took for took, attended in World.attended if attended == kind)
        if took:
            mean, half = sum(took) / len(took), took[len(took) // 2]
            waiting = sum(visit.kind == kind for visit in World.known.values())
            print(
                f"  {name}: {len(took)} attended, after {mean:.1f} s in the mean, {half:.1f} s (median), and "
                f"{took[-1]:.1f} s at most; {waiting} not yet"
            )
    print(f"  top level: idle for {idle:.1f} s, which is {100 * idle / seconds:.1f} % of the time")
    print(f"  robot: {building().steps / 10:g} s on the floor; collisions: {robot().collisions}")


def save(film: Film) -> None:
    """Write the pictures that there are, and say so."""
    film.save(1 / PICTURES)
    print(f"  {film.path}: {len(film)} pictures")


def main() -> None:
    """Read the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="in virtual time, without waiting")
    parser.add_argument("--log", action="store_true", help="a line for each event, in place of the floor")
    parser.add_argument("--film", metavar="FILE", help="pictures of the floor: an animation .gif, or a sheet .png")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"how long ({SECONDS:g})")
    parser.add_argument("--seed", type=int, default=World.seed, help=f"what is drawn at random ({World.seed})")
    arguments = parser.parse_args()
    if not 0 < arguments.seconds < float("inf"):
        parser.error("--seconds is a number above 0")
    if arguments.seed < 0:
        parser.error("--seed is a number from 0 on")
    World.seed = arguments.seed
    try:
        robot()  # while Ctrl-C just ends the program, for its simulator takes long to load
    except mdm.Error as error:
        sys.exit(f"patrol.py: {error}")
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal without arrows shows the floor nevertheless
        sys.stdout.reconfigure(errors="replace")
    began = time.monotonic()
    try:
        film = None if arguments.film is None else Film(FloorView(floor), arguments.film)
        try:
            mdm.run(lambda: patrol(arguments, film), virtual=arguments.fast)
        finally:
            if film:  # also what was filmed until Ctrl-C
                save(film)
    except KeyboardInterrupt:
        print("\nstopped: the running action has ended, and the safe action has run")
        sys.exit(130)
    except (mdm.Error, OSError) as error:
        if sys.stdout is not None:  # what could not be printed is not tried again at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        is_gone = isinstance(error.__cause__ or error, BrokenPipeError)
        sys.exit(1 if is_gone else f"patrol.py: {error}")  # a reader that has gone needs no telling
    print(f"\nDone in {time.monotonic() - began:.1f} s.")


if __name__ == "__main__":
    main()
