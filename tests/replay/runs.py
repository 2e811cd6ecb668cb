"""Records of random systems in wall time, and their replays."""

from __future__ import annotations

import asyncio
import contextlib
import faulthandler
import logging
import traceback
from pathlib import Path

from replay.systems import System

import mdm
from mdm.recording import Record
from mdm.recording.recorder import Recorder
from mdm.replay import replay

_LONGEST = 600.0
"""Seconds after which a system hangs: a machine that is busy with much else may take a minute."""


def record(seed, path, seconds):
    """Run the system of a seed in wall time and record it; return what the recorder has counted."""
    system = System(seed, behaviour=f"behaviour of {seed}")
    recorder = Recorder(path)

    async def main():
        async with mdm.Runtime(log=False, watchdog=None, record=recorder) as runtime:
            await system.run(runtime, seconds)

    with contextlib.suppress(mdm.Error):
        asyncio.run(main())
    return recorder.statistics()


def violations(seed, path, seconds=0.5):
    """Record the system of a seed and replay it; return how many decisions it made, and what is wrong."""
    logging.disable()  # asyncio logs errors that nobody awaits, as is meant here
    try:
        counted = record(seed, path, seconds)
    finally:
        logging.disable(logging.NOTSET)
    wrong = []
    if counted.dropped:
        wrong.append(f"the record lost {counted.dropped} messages")
    found = Record(path)
    system = System(seed)
    replayed = replay(found, system.tops)
    if system.called:
        wrong.append(f"functions were called: {system.called[:5]}")
    if replayed.lost:
        wrong.append(f"the record lacks {replayed.lost} messages")
    if not replayed.exact:
        wrong.append("numbers were not compared exactly")
    if replayed.replayed > 1.5 * replayed.recorded + 2:
        wrong.append(f"{replayed.replayed} decisions in place of {replayed.recorded}")
    if replayed.differences:
        epoch = int(found.head["epoch"])
        wrong.append(f"{len(replayed.differences)} differences; {replayed.differences[0].describe(epoch)}")
    return replayed.recorded, wrong


def work(job):
    """Return a seed, how many decisions its system made, and what is wrong."""
    seed, seconds, folder = job
    path = Path(folder) / f"{seed}.mcap"
    faulthandler.dump_traceback_later(_LONGEST, exit=True)
    try:
        decisions, wrong = violations(seed, path, seconds)
    except Exception:
        return seed, 0, [traceback.format_exc()]
    if not wrong:
        path.unlink()
    return seed, decisions, wrong


def spin():
    """Keep a core busy."""
    while True:
        pass
