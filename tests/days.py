"""Days of the demo: how long its robot stands idle, its calls wait, and which rooms it visits.

``python -m days 20 86400`` runs the seeds 1 to 20 for a day of virtual time each, and says which were not as they
should be.
"""

from __future__ import annotations

import asyncio
import math
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise

import numpy as np
from places import EXAMPLES

import mdm
from mdm.messages import ActionLife

FOLDER = EXAMPLES / "patrol"
BOUND = 300.0
"""Seconds within which a call is attended or gone, as docs/maps.md says."""
IDLE = 0.01
"""Of the time for which the top level may have nothing to do."""
ERRORS = 4.5
"""Standard errors by which a room's share of decisions may differ: chance alone does so in 1 of 100 times 20 days."""


@dataclass(frozen=True)
class Leg:
    """From one decision of the patrol to the next: the states, the action, and whether anything else came between."""

    state: int
    action: int
    following: int
    disturbed: bool


@dataclass(frozen=True)
class Day:
    """How a run of the demo went; all times are in seconds."""

    idle: float
    attended: list[tuple[float, str]]
    left: list[tuple[float, str]]
    waiting: list[tuple[float, str]]
    contacts: int
    failed: int
    legs: list[Leg]

    @property
    def longest(self):
        """How long a call has waited at most, whatever became of it."""
        return max((seconds for seconds, _ in (*self.attended, *self.left, *self.waiting)), default=0.0)


@contextmanager
def example(seed):
    """Import what stands beside the demo, anew, for a seed."""
    path = list(sys.path)
    sys.path.insert(0, str(FOLDER))
    sys.modules.pop("building", None)
    try:
        demo = import_module("building")
        demo.World.seed = seed
        yield demo
    finally:
        sys.path[:] = path
        sys.modules.pop("building", None)


def day(seed, seconds, *, calm=False):
    """Run the demo; where it is calm nobody comes, and nothing burns."""
    with example(seed) as demo:
        if calm:
            visits = demo.Visits
            demo.Visits = lambda kind, **_: visits(kind, every=math.inf)

        async def main():
            system = mdm.load_system(FOLDER / "patrol.toml")
            decisions, failed = [], []

            def note(life):
                if life.status not in {"running", "succeeded", "preempted"}:
                    failed.append(life)

            async with mdm.Runtime(log=False) as runtime:
                runtime.decisions.subscribe(decisions.append)
                for ensemble in system.ensembles.values():
                    runtime.channel(f"{ensemble.path}/lives", ActionLife).subscribe(note)
                await runtime.start(system)
                await asyncio.sleep(seconds)
                now = runtime.clock.time()
                waiting = [(now - since, demo.World.known[number].kind) for number, since in demo.World.since.items()]
                idle = system.ensembles["top"].statistics().idle
            return Day(
                *(idle, demo.World.attended, demo.World.left, waiting),
                *(demo.robot().collisions, len(failed), legs(decisions)),
            )

        return mdm.run(main, virtual=True)


def legs(decisions):
    """Pair each decision of the patrol with its next one."""
    found = [index for index, decision in enumerate(decisions) if decision.ensemble == "top/patrol"]
    return [
        Leg(decisions[one].state, decisions[one].action, decisions[other].state, disturbed=other > one + 1)
        for one, other in pairwise(found)
    ]


class Forecast:
    """How often the patrol decides in each state, as its model has it under its policy.

    Of a state from which the robot drives on undisturbed, the model says what follows, with the building's chance that
    a drive arrives in place of the model's. Where the robot was called away the model does not say what follows: that,
    and how often it happens, is as it was among ``before``, which are to be other legs than those that are compared.
    """

    def __init__(self, before):
        model, policy = mdm.load_model(FOLDER / "patrol.npz"), mdm.load_policy(FOLDER / "patrol.policy")
        states = range(len(model.state_space))
        self.places = [model.state_space.unravel(state)[0] for state in states]
        self.actions = policy.actions
        self.following = [model.transition_matrix(self.actions[state])[state] for state in states]
        own = [leg for leg in before if not leg.disturbed]
        self.arrives = sum(leg.following != leg.state for leg in own) / len(own)
        chain = np.zeros((len(states), len(states)))
        for state in states:
            here = [leg for leg in before if leg.state == state]
            away = [leg.following for leg in here if leg.disturbed]
            share = len(away) / len(here) if here else 0.0
            chain[state] = (1 - share) * self.moves(state)
            for following in away:
                chain[state, following] += 1 / len(here)
        self.chain = chain

    def moves(self, state):
        """Return what follows a state undisturbed: of the model that the robot moves, of the building how often."""
        moved = self.following[state].copy()
        moved[state] = 0.0
        chances = self.arrives * moved / moved.sum()
        chances[state] = 1 - self.arrives
        return chances

    def rooms(self, distribution):
        """Return the shares of the rooms."""
        return np.bincount(self.places, weights=distribution)

    def stationary(self, start):
        """Return the shares of the states in the long run, from the one in which it begins."""
        mean, now = np.zeros(len(self.chain)), np.eye(len(self.chain))[start]
        for _ in range(5000):
            mean, now = mean + now / 5000, now @ self.chain
        return mean

    def compare(self, states, *, parts=20):
        """Return by how much each room's share of decisions differs, and the standard errors, by parts in a row."""
        rooms = max(self.places) + 1
        places = np.array(self.places)[states]
        shares = np.array([np.bincount(part, minlength=rooms) / len(part) for part in np.array_split(places, parts)])
        differences = shares.mean(axis=0) - self.rooms(self.stationary(states[0]))
        return differences, shares.std(axis=0, ddof=1) / math.sqrt(parts)


def difference(day):
    """Return by how many standard errors, both halves' together, a room's share is at most not as forecast."""
    half = len(day.legs) // 2
    before, after = day.legs[:half], day.legs[half:]
    forecast = Forecast(before)
    differences, errors = forecast.compare([leg.state for leg in after])
    errors = np.hypot(errors, forecast.compare([leg.state for leg in before])[1])  # from which it was made
    return float(np.max(np.abs(differences) / np.maximum(errors, 1 / half)))


def output(seed, seconds):
    """Return what the demo tells of a run, but for the last line, how long it took."""
    command = [sys.executable, str(FOLDER / "patrol.py"), "--fast", "--seconds", str(seconds), "--seed", str(seed)]
    return subprocess.run(command, capture_output=True, check=True).stdout.splitlines()[:-1]


def faults(day, seconds):
    """Return in words what was not as it should be."""
    checks = {
        f"idle for {day.idle:.1f} s": day.idle < IDLE * seconds,
        f"a call waited for {day.longest:.1f} s": day.longest <= BOUND,
        f"{day.contacts} contacts": day.contacts == 0,
        "rooms not visited as the model has it": difference(day) < ERRORS,
    }
    return [words for words, is_right in checks.items() if not is_right]


def main():
    """Run as many as asked for, and say how they went."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 86400.0
    wrong = 0
    print(" seed  idle %  attended  longest  left  longest  not yet  contacts  failed  decisions  rooms")
    for seed in range(1, count + 1):
        it = day(seed, seconds)
        most = [max((took for took, _ in each), default=0.0) for each in (it.attended, it.left)]
        found = faults(it, seconds)
        wrong += bool(found)
        print(
            f"{seed:5} {100 * it.idle / seconds:7.3f} {len(it.attended):9} {most[0]:8.1f} {len(it.left):5} "
            f"{most[1]:8.1f} {len(it.waiting):8} {it.contacts:9} {it.failed:7} {len(it.legs):10} "
            f"{difference(it):6.1f}  {'; '.join(found)}".rstrip(),
            flush=True,
        )
    is_same = output(1, 3600) == output(1, 3600)
    print(f"{count} runs of {seconds:g} s: {wrong} not as they should be")
    print(f"an hour twice: {'the same' if is_same else 'not the same'}")
    sys.exit(bool(wrong) or not is_same)


if __name__ == "__main__":
    main()
