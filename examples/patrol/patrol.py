"""The demo: a robot patrols a building and attends to people, intruders and fires.

Everything that decides is declared in ``patrol.toml``; what the robot senses and does is in ``building.py``. This file
runs the two and shows what happens. ``--fast`` runs in virtual time, without waiting.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from pathlib import Path

import mdm
from mdm.messages import ActionLife, Decision, Fault, PredicateUpdate

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from building import building  # noqa: E402 - it stands beside this file

SECONDS = 30.0
COLOURS = {"world": "36", "senses": "33", "top": "1;35", "patrol": "34", "action": "32", "fault": "1;31"}


class Display(mdm.Actor):
    """Prints a line for everything that happens: a monitor is an actor beside the others."""

    def __init__(self, system: mdm.System, *, colour: bool) -> None:
        super().__init__("display")
        self.system = system
        self.colour = colour
        self.decisions: dict[str, int] = {"top": 0, "patrol": 0}

    def on_start(self) -> None:
        """Listen to decisions, actions, predicates and faults."""
        self.began = self.runtime.clock.now()
        building.tell = lambda text: self.show("world", text)
        self.subscribe(self.runtime.decisions, self.on_decision)
        self.subscribe(self.runtime.faults, self.on_fault)
        self.subscribe(self.runtime.channel("predicates/updates", PredicateUpdate), self.on_predicates)
        for ensemble in self.system.ensembles.values():
            self.subscribe(self.runtime.channel(f"{ensemble.path}/lives", ActionLife), self.on_life)

    def show(self, who: str, text: str) -> None:
        """Print a line with the time since the start."""
        seconds = (self.runtime.clock.now() - self.began) / 1e9
        line = f"{who:>7}  {text}"
        if self.colour:
            line = f"\x1b[{COLOURS[who]}m{line}\x1b[0m"
        print(f"{seconds:5.1f} s {line}", flush=True)

    def on_predicates(self, update: PredicateUpdate) -> None:
        """Show what became true or false, once the first values are known."""
        if update.counter > 1:
            for name in (*update.rising, *update.falling):
                self.show("senses", f"{name} is {'true' if name in update.rising else 'false'} now")

    def on_decision(self, decision: Decision) -> None:
        """Show a decision: by which state, or by which belief."""
        name = decision.ensemble.rpartition("/")[2]
        self.decisions[name] += 1
        if decision.belief is None:
            assert decision.state is not None
            model = self.system.ensembles[name].controller.model
            assert model is not None
            values = zip(model.state_space.factors, model.state_space.unravel(decision.state), strict=True)
            troubles = [factor.name for factor, value in values if value]
            self.show(name, f"the state is '{'+'.join(troubles) or 'calm'}': {decision.action_name}")
        else:
            chances = decision.belief.reshape(3, 4).sum(axis=0)
            fires = zip(("nowhere", "lobby", "office", "lab"), chances, strict=True)
            belief = ", ".join(f"{place} {chance:.0%}" for place, chance in fires)
            self.show(name, f"believes the fire is {belief}: {decision.action_name}")

    def on_life(self, life: ActionLife) -> None:
        """Show how actions of the top level end, and all that do not succeed."""
        if life.status != "running" and (life.ensemble == "top" or life.status != "succeeded"):
            self.show("action", f"{life.action} {life.status.replace('_', ' ')}")

    def on_fault(self, fault: Fault) -> None:
        """Show a fault."""
        self.show("fault", f"{fault.source}: {fault.detail}")


async def patrol(*, fast: bool, seconds: float) -> None:
    """Run the system for a time, and say how it went."""
    system = mdm.load_system(HERE / "patrol.toml")
    print("The ensembles:\n")
    print("\n".join(f"  {line}" for line in system.tree().splitlines()))
    print(f"\nThe next {seconds:g} seconds:\n")
    display = Display(system, colour=sys.stdout.isatty())
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(display)
        await runtime.start(system)
        await asyncio.sleep(seconds)
        latencies = {name: ensemble.action.latency for name, ensemble in system.ensembles.items()}
    print("\nWhat it took:\n")
    for name, latency in latencies.items():
        lives = ", ".join(f"{count} {status}" for status, count in sorted(system.ensembles[name].action.ended.items()))
        median = "" if fast else f"; from stimulus to callback {latency.quantile(0.5) * 1e6:.0f} µs (median)"
        print(f"  {name}: {display.decisions[name]} decisions; actions: {lives}{median}")


def main() -> None:
    """Read the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="in virtual time, without waiting")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"how long ({SECONDS:g})")
    arguments = parser.parse_args()
    began = time.monotonic()
    try:
        mdm.run(lambda: patrol(fast=arguments.fast, seconds=arguments.seconds), virtual=arguments.fast)
    except KeyboardInterrupt:
        print("\nstopped: the running action has ended, and the safe action has run")
        sys.exit(130)
    print(f"\nDone in {time.monotonic() - began:.1f} s.")


if __name__ == "__main__":
    main()
