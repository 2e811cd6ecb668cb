"""Teams in virtual time whose agents end and come back with what they have kept, or have never met; some are recorded.

A scenario is a seeded schedule of `team.returns`, or a team that is cut apart before it begins. It is recorded and
shown at times, and sentences say what is wrong.
"""

from __future__ import annotations

import asyncio
import logging
import random
import tempfile
from pathlib import Path

import msgspec
from chaos.watchers import MEMORY, Here
from team.returns import Schedule
from team.sharing.test_commanding_outcomes import NAMES
from team_robots import Robot, over_beliefs, three

from mdm.recording import Record, Recorder
from mdm.snapshots import LiveRun
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

MODES = ("replicated", "replicated", "centralised")


class Strangers:
    """Agents that begin on sides which do not hear each other, some of them told to start by a person.

    Args:
        runtime: Where.
        draw: Draws the sides.
        folder: Where their stops are kept.
    """

    def __init__(self, runtime, draw, folder):
        self._runtime, self._draw = runtime, draw
        self.mode = draw.choice(MODES)
        self._sides = {name: draw.randrange(3) for name in NAMES}
        self._network = Network(runtime.clock, team="squad")
        self._network.partition(*({name for name in NAMES if self._sides[name] == side} for side in range(3)))
        more = {"controller": draw.choice(NAMES)} if self.mode == "centralised" else {}
        self._team = Team("squad", NAMES, mode=self.mode, period=0.5, lease=0.5, state=folder, **more)

    def _build(self, robot, agent):
        return over_beliefs(three())(robot, agent, safe_action=robot.act("SAFE"))

    async def befall(self):
        """Hold that nobody does anything who has not met most of the others; then have them meet."""
        robots = {}
        for name in self._draw.sample(NAMES, 3):
            robots[name] = await Robot(self._team, name, self._network, self._build).start(self._runtime)
            await asyncio.sleep(self._draw.choice([0.0, 0.3, 4.0]))
        seconds = self._draw.choice([3.0, 15.0])
        await asyncio.sleep(seconds)
        for name, robot in robots.items():
            met = [other for other in NAMES if self._sides[other] == self._sides[name]]
            if len(met) == 1:
                assert set(robot.did) <= {"SAFE"}, f"{name} has met nobody, and did {robot.did}"
                modes = {"safe"} if seconds > 10.0 else {"stopped", "safe"}
                assert robot.ensemble.mode in modes, f"{name} has met nobody, and is {robot.ensemble.mode}"
        self._network.heal()
        await asyncio.sleep(10.0)
        for name, robot in robots.items():
            assert robot.ensemble.mode == "deciding", f"{name} has met the others, and is {robot.ensemble.mode}"


def violations(seed):
    """Return a seed, and what is wrong with its scenario."""
    logging.disable()  # asyncio logs errors that nobody awaits, as is meant here
    try:
        return seed, _wrong(seed)
    finally:
        logging.disable(logging.NOTSET)


def _wrong(seed):
    draw, wrong, heard = random.Random(f"squad {seed}"), [], []
    watched = draw.random() < 0.3
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        path = Path(folder) / "run.mcap"
        recorder = Recorder(path) if watched else None

        async def main(runtime):
            runtime.modes.subscribe(heard.append)
            live = LiveRun(runtime)
            if watched:
                live.open()
            try:
                if draw.random() < 0.5:
                    await Strangers(runtime, draw, folder).befall()
                else:
                    squad = await Schedule(runtime, seed, folder).begin()
                    await squad.befall(await squad.asker())
                if watched:
                    msgspec.json.decode(live.encoded())
            finally:
                live.close()

        if watched:
            recorder._writer = Here(path).watch(lambda: recorder._runtime.clock.now())  # noqa: PLW0108 - it has none yet
        try:
            run_virtual(main, record=recorder)
        except Exception as error:
            wrong.append(f"{type(error).__name__}: {error}")
        if watched and not wrong:
            found = Record(path)
            kept = [each.message for each in found.messages(["modes"])]
            if kept != heard[: len(kept)] or found.lost or not found.closed:
                wrong.append(f"the record has {len(kept)} modes of {len(heard)}, and lacks {found.lost} messages")
    return wrong
