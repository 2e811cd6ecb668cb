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
from contextlib import nullcontext
from pathlib import Path

import mdm
from mdm.views.floor import Film, FloorView
from mdm.views.palette import Palette

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

try:
    from building import World, building, floor, robot  # these stand beside this file
    from display import PICTURES, Display
except mdm.Error as error:
    sys.exit(f"patrol.py: {error}")

SECONDS = 40.0
PLURALS = {"person": "people", "intruder": "intruders", "fire": "fires"}


async def patrol(arguments: argparse.Namespace, film: Film | None) -> None:
    """Run the system for a time, and say how it went."""
    system = mdm.load_system(HERE / "patrol.toml")
    seconds = arguments.seconds
    print("The ensembles:\n")
    print("\n".join(f"  {line}" for line in system.tree().splitlines()))
    print(f"\nThe next {seconds:g} seconds:\n", flush=True)
    terminal = sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    palette = Palette.of(os.environ) if terminal else Palette(0)
    moving = terminal and not arguments.log and not arguments.fast
    display = Display(system, moving=moving, palette=palette, film=film)
    with display.terminal if moving else nullcontext():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(display)
            await runtime.start(system)
            await asyncio.sleep(seconds)
            latencies = {name: ensemble.action.latency for name, ensemble in system.ensembles.items()}
            idle = system.ensembles["top"].statistics().idle
            where = f"the robot is in {display.place()}, and {display.to_go()}"
    print(f"\nAt the end {where}.\n")
    columns = min(72, shutil.get_terminal_size().columns - 1)
    print(display.view.text(display.marks(), columns=columns, rows=24, palette=palette, stretch=1.5))
    print("\nWhat it took:\n")
    for name, latency in latencies.items():
        lives = ", ".join(f"{count} {status}" for status, count in sorted(system.ensembles[name].action.ended.items()))
        median = "" if arguments.fast else f"; from stimulus to callback {latency.quantile(0.5) * 1e6:.0f} µs (median)"
        print(f"  {name}: {display.decisions[name]} decisions; actions: {lives}{median}")
    print("\n  calls      attended  after, mean  median  at most   gone  at most   not yet\n")
    for kind, name in PLURALS.items():
        took = sorted(took for took, attended in World.attended if attended == kind)
        left = [took for took, gone in World.left if gone == kind]
        waiting = sum(visit.kind == kind for visit in World.known.values())
        times = (sum(took) / len(took), took[len(took) // 2], took[-1]) if took else ()
        mean, half, most = (f"{seconds:.1f} s" for seconds in times) if took else ("", "", "")
        gone = f"{max(left):.1f} s" if left else ""
        print(f"  {name:10} {len(took):8} {mean:>12} {half:>7} {most:>8} {len(left):6} {gone:>8} {waiting:9}")
    print()
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
    parser.add_argument("--pixels", type=int, default=900, help="the longer side of a picture of the film (900)")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"how long ({SECONDS:g})")
    parser.add_argument("--seed", type=int, default=World.seed, help=f"what is drawn at random ({World.seed})")
    arguments = parser.parse_args()
    if not 0 < arguments.seconds < float("inf"):
        parser.error("--seconds is a number above 0")
    if arguments.pixels < 100:
        parser.error("--pixels is a number from 100 on")
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
        film = None if arguments.film is None else Film(FloorView(floor), arguments.film, size=arguments.pixels)
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
