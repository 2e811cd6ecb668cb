"""Robots as real processes, which get signals: seeded scenarios, and what must hold of each.

A robot (`robot.py`) is run under an event loop, beside other work or by itself, or by the command ``mdm run``. It tells
on a pipe what it does. At a moment it gets signals, most often two, some milliseconds apart; other things go wrong as
well. `run` carries a scenario out and returns what the oracles find wrong. A seed draws the scenario, but not how the
processes take turns: what went wrong may go right the next time.
"""

from __future__ import annotations

import importlib.util
import json
import os
import random
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
SIGNALS = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
PAIRS = [(first, second) for first in SIGNALS for second in SIGNALS]
ENTRIES = {
    "asyncio": "asyncio.run(main())",
    "anyio": "import anyio; anyio.run(main)",
    "uvloop": "import uvloop; uvloop.run(main())",
    "run": "mdm.run(main)",
    "run on uvloop": "mdm.run(main, uvloop=True)",
    "run an actor": "mdm.run(mdm.load_system(SYSTEM))",
    "command": None,
}
MOMENTS = ["start", "deciding", "action", "safe"]
FAULTS = ["one", "three", "impatient", "full", "closed", "missing", "ignored", "flood", "held", "stuck", "exit", "fork"]
LONGEST = 0.05
"""Seconds between two signals, at most."""
AT_ONCE = 0.24
"""Seconds after the first signal in which others are one with it, less the time that a robot takes to tell."""
APART = (0.3, 0.4)
"""Seconds between those of somebody who loses patience."""
BOUND = 60.0
"""Seconds in which a robot has ended, on a machine that is busy."""
STATUS = 7


def pair(seed):
    """Return a scenario in which two signals come, and nothing else goes wrong."""
    draw = random.Random(seed)
    return _scenario(draw, None, PAIRS[seed % len(PAIRS)])


def mixed(seed):
    """Return a scenario in which something else goes wrong, too."""
    draw, fault = random.Random(-1 - seed), FAULTS[seed % len(FAULTS)]
    if fault in {"three", "impatient", "stuck"}:
        return _scenario(draw, fault, draw.sample(SIGNALS, 3))  # two of a kind that wait are one
    count = {"one": 1, "exit": draw.randint(0, 1)}.get(fault, draw.randint(1, 2))
    return _scenario(draw, fault, [draw.choice(SIGNALS) for _ in range(count)])


def violations(seed):
    """Run the scenario of a seed; return the seed and what is wrong, as for `chaos.scenario`."""
    return seed, judged((pair, mixed)[seed % 2](seed // 2))


def judged(scenario):
    """Run a scenario; return what is wrong and, if anything is, what was seen."""
    wrong, seen = run(scenario)
    return [*wrong, f"scenario: {scenario}", *(f"{name}: {what}" for name, what in seen.items())] if wrong else []


def _scenario(draw, fault, signals):
    entries = [entry for entry in ENTRIES if "uvloop" not in entry or importlib.util.find_spec("uvloop")]
    entry = draw.choice(entries)
    if fault in {"held", "stuck"}:
        entry = draw.choice([entry for entry in entries if entry not in {"run an actor", "command"}])
    if fault == "ignored":
        signals = [signal.SIGINT, draw.choice([signal.SIGTERM, signal.SIGHUP])]
    if fault == "missing":
        entries = [entry for entry in entries if "uvloop" not in entry]  # libuv aborts at its end
        entry = draw.choice(entries)
    low, high = APART if fault in {"impatient", "stuck"} else (0.0, LONGEST)
    pauses = [draw.choice([low, draw.uniform(low, high)]) for _ in signals]
    return {
        "fault": fault,
        "entry": entry,
        "moment": "action" if fault in {"held", "stuck", "exit", "fork"} else draw.choice(MOMENTS),
        "signals": list(map(int, signals)),
        "pauses": pauses,
        "braking": draw.choice([0.0, 0.0, 0.005, 0.02, 0.1]),
        "caught": fault == "full" or draw.random() < 0.3,
        "status": STATUS,
    }


def run(scenario):
    """Carry a scenario out; return what is wrong with it, each in a sentence, and what was observed."""
    reader, writer = os.pipe()
    with tempfile.TemporaryFile() as errors:
        standard_error, opened = _standard_error(scenario["fault"], errors)
        began = time.monotonic()
        process = subprocess.Popen(
            _command(scenario),
            env=os.environ
            | {
                "ROBOT": json.dumps(scenario | {"pipe": writer}),
                "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent.parent)]),
            },
            pass_fds=[writer],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=standard_error,
            start_new_session=True,
        )
        os.close(writer)
        lines = _Lines(reader)
        wrong = []
        try:
            if not lines.wait_for("ready", began + BOUND):
                wrong.append("was never ready")
            for pause, number in zip(scenario["pauses"], scenario["signals"], strict=True):
                time.sleep(pause)  # the time between them is the scenario
                process.send_signal(number)
            sent = time.monotonic()
            try:
                status = process.wait(BOUND)
            except subprocess.TimeoutExpired:
                wrong.append(f"has not ended within {BOUND:g} s")
                status = 0
            seconds = time.monotonic() - sent
            if not wrong and not lines.ended(time.monotonic() + BOUND):
                wrong.append("left a process that holds its pipe")
        finally:
            try:
                os.killpg(process.pid, signal.SIGKILL)
                if process.returncode is not None:
                    wrong.append("left a process in its session")
            except ProcessLookupError:
                pass
            process.wait()
            lines.ended(time.monotonic())
            for descriptor in (reader, *opened):
                os.close(descriptor)
        errors.seek(0)
        text = errors.read().decode()
    status = 128 - status if status < 0 else status
    if not wrong:
        wrong = _judge(scenario, lines.found, status, text)
    told = {"told": lines.found[-30:], "status": status, "seconds": seconds, "errors": text[-3000:]}
    return wrong, told


def _command(scenario):
    code = ENTRIES[scenario["entry"]]
    if code is None:
        command = [sys.executable, "-m", "mdm", "run", str(HERE / "robot.toml")]
    else:
        if scenario["caught"]:
            code = f"try:\n    {code}\nexcept KeyboardInterrupt:\n    sys.exit(130)"
        command = [sys.executable, "-c", f"from robot import *\n{code}"]
    match scenario["fault"]:
        case "missing":
            return ["/bin/sh", "-c", 'exec "$@" 2>&-', "sh", *command]
        case "ignored":
            return ["/bin/sh", "-c", 'trap "" INT; exec "$@"', "sh", *command]
    return command


def _standard_error(fault, errors):
    """Return what the program gets as standard error, and what of it is to be closed in the end."""
    if fault not in {"full", "closed"}:
        return errors, []
    reader, writer = os.pipe()
    if fault == "closed":
        os.close(reader)
        return writer, [writer]
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, bytes(1024))
    except BlockingIOError:
        os.set_blocking(writer, True)
    return writer, [reader, writer]


class _Lines:
    """Lines that a program tells on a pipe."""

    def __init__(self, reader):
        self._reader, self._rest = reader, b""
        self.found = []

    def wait_for(self, line, until):
        """Read until a line has come; return whether it has."""
        while line not in self.found:
            if not self._read(until):
                return False
        return True

    def ended(self, until):
        """Read to the end; return whether it has come."""
        while self._read(until):
            pass
        return bool(select.select([self._reader], [], [], 0)[0])

    def _read(self, until):
        """Read what is there by then; return whether anything has come."""
        if not select.select([self._reader], [], [], max(until - time.monotonic(), 0))[0]:
            return False
        data = os.read(self._reader, 65536)
        *lines, self._rest = (self._rest + data).split(b"\n")
        self.found += [line.decode() for line in lines]
        return bool(data)


# -- The oracles -------------------------------------------------------------------------------------------------


def _judge(scenario, told, status, errors):
    fault = scenario["fault"]
    wrong = [*_safe(scenario, told), *_status(scenario, told, status), *_errors(scenario, told, status, errors)]
    if fault == "held" and "emergency" not in told:
        wrong.append("emergency was not called")
    if fault == "fork" and not any(re.fullmatch(r"forked child \(\d+, 0\)", line) for line in told):
        wrong.append("a forked child could set a predicate, or failed at it otherwise")
    return wrong


def _safe(scenario, told):
    """Hold that what drove has been made safe, the outermost last."""
    if "drive" not in told and "race" not in told:
        return
    last = {
        name: max((n for n, line in enumerate(told) if line.startswith(name)), default=-1)
        for name in ("drive", "race", "safe robot", "safe team")
    }
    driven = max(last["drive"], last["race"])
    taken = [float(line.rpartition(" ")[2]) for line in told if line.startswith("took ")]
    broken_off = len(scenario["signals"]) > 2 and max(taken, default=0) - min(taken, default=0) > AT_ONCE
    for name in ("robot", "team"):
        if last[f"safe {name}"] < driven:
            if not broken_off or (name == "robot" and scenario["braking"] == 0):
                yield f"the safe action of {name} has not run"
        elif f"safe {name} ended" not in told and not broken_off:
            yield f"the safe action of {name} was broken off"
    if not broken_off and last["safe team"] < last["safe robot"]:
        yield "the outermost safe action was not the last"


def _status(scenario, told, status):
    """Hold that the status is that of the signal that the program heard first, or of its exit."""
    heard = [int(line.partition(" ")[2]) for line in told if line.startswith("heard ")]
    sent = [number for number in scenario["signals"] if scenario["fault"] != "ignored" or number != signal.SIGINT]
    if scenario["fault"] == "exit":
        if status not in {STATUS, *(128 + number for number in sent)}:  # which of them came first, nobody knows
            yield f"the status is {status}, not {STATUS}"
    elif not heard:
        if status - 128 not in sent:
            yield f"the status is {status}, which is none of the signals'"
        if "drive" in told:
            yield "drove, but heard no signal"
    elif status != 128 + heard[0]:
        yield f"the status is {status}, but the first signal was {heard[0]}"


def _errors(scenario, told, status, errors):
    """Hold that nothing is printed as a traceback but a `KeyboardInterrupt` that the program does not catch."""
    tracebacks = errors.count("Traceback (most recent call last)")
    meant = signal.SIGINT in scenario["signals"] and not scenario["caught"] and scenario["entry"] != "command"
    if scenario["fault"] == "stuck":
        return  # a third signal is raised in what holds the loop, and tells where that was
    if status == 128 + signal.SIGINT:
        meant = meant and errors.rstrip().endswith("KeyboardInterrupt")
    elif any(line.startswith("heard ") for line in told):
        meant = False  # else it was ended by another signal while it printed
    if tracebacks and not meant:
        yield "a traceback was printed"
    if re.search(r"never retrieved|Exception ignored|was destroyed|Fatal Python|RuntimeWarning", errors):
        yield "Python complains"


def hear():
    """Let programs hear signals that a script or nohup ignores: a handler is not inherited."""
    for number in SIGNALS:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
