"""The robot that `chaos.processes` runs as a program: it tells on a pipe what it does, and does what its plan says."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import mdm
from mdm.runtime.process.signals import Signals

PLAN = json.loads(os.environ["ROBOT"])
MOMENT, FAULT = PLAN["moment"], PLAN["fault"]
SYSTEM = Path(__file__).with_name("robot.toml")


def tell(words):
    """Write a line to the pipe at once, whatever becomes of the program."""
    os.write(PLAN["pipe"], f"{words}\n".encode())


def begin(self, error, *, begin=Signals._begin):
    """Tell the signal that ends a runtime: of two that wait, the system and Python choose which is heard first."""
    tell(f"heard {2 if isinstance(error, KeyboardInterrupt) else error.code - 128}")
    begin(self, error)


def hear(self, number, *, hear=Signals.hear):
    """Tell when a signal is taken, which may be long after it was sent."""
    tell(f"took {number} {time.monotonic()}")
    hear(self, number)


Signals._begin, Signals.hear = begin, hear


def drive():
    """Drive until cancelled, or do what an action must not."""
    return _act("drive")


def race():
    """The same, faster."""
    return _act("race")


async def _act(name):
    tell(name)
    if FAULT == "exit":
        tell("ready")
        sys.exit(PLAN["status"])
    if MOMENT == "safe":
        raise RuntimeError("the wheel has come off")
    if MOMENT == "action" and FAULT not in {"held", "stuck", "fork"}:
        tell("ready")
    await asyncio.sleep(3600)


def _safe_action(name):
    def plain():
        tell(f"safe {name}")
        if MOMENT == "safe":
            tell("ready")
        tell(f"safe {name} ended")

    async def brake():
        tell(f"safe {name}")
        if MOMENT == "safe":
            tell("ready")
        await asyncio.sleep(PLAN["braking"])
        tell(f"safe {name} ended")

    return brake if PLAN["braking"] else plain


make_robot_safe, make_team_safe = _safe_action("robot"), _safe_action("team")


async def live(system):
    """What goes on beside the ensembles, for ever."""
    tell("entered")
    predicates = system.predicates
    if FAULT == "flood":
        threading.Thread(target=_flood, args=(predicates,), daemon=True).start()
    if FAULT in {"held", "stuck"}:
        asyncio.get_running_loop().call_later(0.01, _hold)
    if FAULT == "fork":
        tell(f"forked child {await asyncio.to_thread(os.waitpid, _fork(predicates), 0)}")
        tell("ready")
    fast = False
    while MOMENT == "deciding":
        fast = not fast
        predicates.sense("Fast", fast)
        if fast:
            tell("ready")
        await asyncio.sleep(0.001)
    await asyncio.sleep(3600)


def _flood(predicates):
    fast = False
    with suppress(mdm.Error):
        while True:
            fast = not fast
            predicates.sense("Fast", fast)


def _hold():
    tell("ready")
    until = time.monotonic() + (0.4 if FAULT == "held" else 3600)
    while time.monotonic() < until:
        time.sleep(0.001)


def _fork(predicates):
    child = os.fork()
    if child == 0:
        try:
            predicates.sense("Fast", True)
        except mdm.Error:
            os._exit(0)
        os._exit(1)
    return child


def cut():
    """Cut the motors."""
    tell("emergency")


async def main():
    """The robot beside other work of a program."""
    if MOMENT == "start":
        tell("ready")
    watch = {"watchdog": 0.1, "emergency": cut} if FAULT in {"held", "stuck"} else {}
    async with mdm.Runtime(log="console", **watch) as runtime:
        await runtime.start(mdm.load_system(SYSTEM))
        await asyncio.gather(runtime.wait(), asyncio.sleep(3600))


if MOMENT == "start" and PLAN["entry"] in {"command", "run an actor"}:
    tell("ready")
