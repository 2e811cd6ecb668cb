"""The way out: signals under every event loop and entry point, in real processes."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import subprocess
import sys
import time
import weakref

import pytest
from patience import PATIENCE
from programs import python
from sentences import refused

from mdm import Error, Runtime, run
from mdm.runtime.process import signals

ROBOT = """
import asyncio, signal, sys, threading, time
import anyio, mdm

began = asyncio.Event()

async def drive():
    print("driving", flush=True)
    began.set()
    await asyncio.sleep(3600)

async def safe():
    try:
        await asyncio.sleep(BRAKING)
        print("SAFE", flush=True)
    finally:
        print("braked", flush=True)

class Feeder(mdm.Actor):
    def __init__(self):
        super().__init__("feeder")
        self.robot = mdm.Ensemble("robot", policy=[0], actions={"Drive": drive}, safe_action=safe)
        self.add(self.robot)
    def on_running(self):
        self.robot.publish_state(0)

async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(Feeder())
        await runtime.wait()
"""
ENTRIES = {
    "asyncio": "asyncio.run(main())",
    "anyio": "anyio.run(main)",
    "uvloop": "import uvloop; uvloop.run(main())",
    "run": "mdm.run(main)",
    "run on uvloop": "mdm.run(main, uvloop=True)",
}
NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def program(entry, *, braking=0.06):
    return f"BRAKING = {braking}\n{ROBOT}\n{entry}\n"


def ended(process):
    """Return what the program wrote, and its status as a shell sees it."""
    output, errors = process.communicate(timeout=PATIENCE)
    status = process.returncode if process.returncode >= 0 else 128 - process.returncode
    return output, status, errors


def each_once(*pairs):
    """Return all pairs of an entry and a signal, all but these of the outer ring."""
    some = set(pairs)
    return [
        pytest.param(entry, number, marks=() if (entry, number) in some else pytest.mark.slow)
        for entry in ENTRIES
        for number in NUMBERS
    ]


@pytest.mark.parametrize(
    ("entry", "number"),
    each_once(
        ("asyncio", signal.SIGTERM),
        ("anyio", signal.SIGINT),
        ("uvloop", signal.SIGTERM),
        ("run", signal.SIGHUP),
        ("run on uvloop", signal.SIGINT),
    ),
)
def test_a_signal_runs_the_safe_action_whatever_runs_the_program(entry, number):
    if "uvloop" in entry:
        pytest.importorskip("uvloop")
    with python("-c", program(ENTRIES[entry])) as process:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(number)
        output, status, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert status == 128 + number
    assert "never retrieved" not in errors


ELSEWHERE = """
class Idle(mdm.Actor):
    def on_stop(self):
        print("stopped", flush=True)

async def main():
    async with mdm.Runtime(log=None, watchdog=None) as runtime:  # which wakes the loop now and then
        await runtime.start(Idle("idle"))
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # of this thread alone: the other one takes it
        print("idle", flush=True)
        await runtime.wait()
"""


@pytest.mark.parametrize(
    "entry",
    [pytest.param(each, marks=() if each in {"asyncio", "uvloop"} else pytest.mark.slow) for each in ENTRIES],
)
def test_a_signal_that_another_thread_takes_wakes_the_loop(entry):
    """Python's handlers run in the main thread, and asyncio's loop sleeps on while nothing tells it to turn."""
    if "uvloop" in entry:
        pytest.importorskip("uvloop")
    with python("-c", program(f"{ELSEWHERE}\n{ENTRIES[entry]}")) as process:
        assert process.stdout.readline() == "idle\n"
        process.send_signal(signal.SIGTERM)
        output, status, errors = ended(process)
    assert output == "stopped\n", errors
    assert status == 143


@pytest.mark.parametrize(
    ("entry", "first", "second", "pause"),
    [
        ("asyncio", signal.SIGTERM, signal.SIGTERM, 0.0),
        pytest.param("anyio", signal.SIGINT, signal.SIGINT, 0.01, marks=pytest.mark.slow),
        ("run", signal.SIGINT, signal.SIGTERM, 0.03),
        pytest.param("uvloop", signal.SIGHUP, signal.SIGINT, 0.05, marks=pytest.mark.slow),
    ],
)
def test_a_second_signal_changes_nothing(entry, first, second, pause):
    if "uvloop" in entry:
        pytest.importorskip("uvloop")
    with python("-c", program(ENTRIES[entry], braking=0.2)) as process:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(first)
        time.sleep(pause)  # what is tested is the time between them
        process.send_signal(second)
        output, status, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert status == 128 + first


def insist(process):
    """Send SIGTERM until the process ends, and return how often; on a busy machine two may be one."""
    for times in range(1, round(2 * PATIENCE)):
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(0.5)  # so that each is a signal of its own
        except subprocess.TimeoutExpired:
            continue
        return times
    return 0


@pytest.mark.parametrize("entry", ["asyncio", pytest.param("run", marks=pytest.mark.slow)])
def test_a_third_signal_breaks_off(entry):
    with python("-c", program(ENTRIES[entry], braking=3600)) as process:
        assert process.stdout.readline() == "driving\n"
        assert insist(process) >= 3
        output, status, errors = ended(process)
    assert output == "braked\n", errors
    assert status == 143


class Clock:
    """Tells the time that it is set to, in place of the system's."""

    now = 100.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize(
    ("times", "broken"),
    [
        ([0.0], None),
        ([0.0, 0.1, 0.2], None),  # at once: they are one
        ([0.0, 0.3], None),  # a second, within the limit
        ([0.0, 0.1, 0.3], None),
        ([0.0, 0.3, 0.3], 0.3),  # the third
        ([0.0, 0.1, 0.3, 9.0], 9.0),
        ([0.0, 10.5], 10.5),  # the second, after the limit
    ],
)
def test_the_third_signal_breaks_off_or_the_second_after_the_limit(times, broken, monkeypatch):
    """Without real signals, of which two may be one on a busy machine."""
    clock, left, broken_off = Clock(), [], []
    monkeypatch.setattr(signals, "monotonic", clock)

    async def main():
        heard = signals.Signals(lambda error: left.append(error) or 10.0, lambda: broken_off.append(clock.now - 100))
        heard.loop = asyncio.get_running_loop()
        for when in times:
            clock.now = 100 + when
            heard.hear(signal.SIGTERM)
            await asyncio.sleep(0)
        assert [error.code for error in left] == [143]
        assert broken_off == ([] if broken is None else [pytest.approx(broken)])

    run(main)


def test_where_the_loop_is_held_the_third_signal_is_raised_in_what_holds_it(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(signals, "monotonic", clock)

    async def main():
        heard = signals.Signals(lambda _: 10.0, lambda: None)
        heard.loop = asyncio.get_running_loop()
        for _ in range(2):  # and the loop does not turn
            heard.hear(signal.SIGHUP)
            clock.now += 0.3
        with pytest.raises(SystemExit) as raised:
            heard.hear(signal.SIGHUP)
        assert raised.value.code == 129

    run(main)


@pytest.mark.parametrize(
    "entry", ["asyncio", *(pytest.param(each, marks=pytest.mark.slow) for each in ("uvloop", "run"))]
)
def test_signals_that_come_at_once_are_one(entry):
    if "uvloop" in entry:
        pytest.importorskip("uvloop")
    with python("-c", program(ENTRIES[entry], braking=0.2)) as process:
        assert process.stdout.readline() == "driving\n"
        for number in NUMBERS:
            process.send_signal(number)
        output, status, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert status - 128 in NUMBERS


@pytest.mark.parametrize(
    "first", [signal.SIGTERM, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGINT, signal.SIGHUP))]
)
@pytest.mark.parametrize(
    ("later", "entry"),
    [
        ("try:\n    ENTRY\nfinally:\n    os.kill(os.getpid(), NUMBER)", "asyncio"),
        ("try:\n    ENTRY\nfinally:\n    os.kill(os.getpid(), NUMBER)", "run"),
        ("import atexit; atexit.register(os.kill, os.getpid(), NUMBER)\nENTRY", "anyio"),
        (
            "class Last:\n  def __del__(self, kill=os.kill, me=os.getpid()): kill(me, NUMBER)\nlast = Last()\nENTRY",
            "run",
        ),
    ],
)
def test_a_signal_while_the_program_ends_does_not_take_the_place_of_the_first(entry, first, later):
    second = signal.SIGHUP if first == signal.SIGTERM else signal.SIGTERM
    text = later.replace("NUMBER", str(int(second))).replace("ENTRY", ENTRIES[entry])
    with python("-c", program(f"import os\n{text}", braking=0)) as process:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(first)
        output, status, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert status == 128 + first


def test_a_signal_that_comes_too_late_is_not_lost():
    before = handlers()
    loop = asyncio.new_event_loop()
    late = signals.Signals(lambda _: 1.0, lambda: None)
    late.open(loop)
    signal.raise_signal(signal.SIGINT)  # in this thread: one that another thread takes may come after what follows
    with pytest.raises(KeyboardInterrupt):
        late.close()
    loop.close()
    assert handlers() == before


def test_nothing_keeps_a_runtime_that_a_signal_has_ended():
    before = handlers()
    ended = []

    async def main():
        async with Runtime(log=None) as runtime:
            ended.append(weakref.ref(runtime))
            os.kill(os.getpid(), signal.SIGINT)
            await runtime.wait()

    try:
        with pytest.raises(KeyboardInterrupt):
            run(main)
    finally:
        for number, handler in zip(NUMBERS, before, strict=True):
            signal.signal(number, handler)
    gc.collect()
    assert ended[0]() is None


def test_a_program_that_goes_on_after_a_signal_hears_the_next_ones_itself(monkeypatch):
    before = handlers()
    monkeypatch.setattr(signals, "_LINGER", 0.0)

    async def main():
        async with Runtime(log=None) as runtime:
            os.kill(os.getpid(), signal.SIGINT)
            await runtime.wait()

    for go in (asyncio.run, run):
        with pytest.raises(KeyboardInterrupt):
            go(main())
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert handlers() == before


HELD = """
import signal, threading, time, mdm

class Held(mdm.Actor):
    def on_running(self):
        self.call_later(0.01, self.hold)
    def hold(self):
        print("held", flush=True)
        while True:
            pass
    def on_stop(self):
        print("stopped", flush=True)

mdm.run(Held("held"))
"""


def test_a_third_signal_reaches_a_callback_that_holds_the_loop():
    with python("-c", HELD) as process:
        assert process.stdout.readline() == "held\n"
        assert insist(process) >= 3
        output, status, errors = ended(process)
    assert output == "stopped\n", errors
    assert status == 143


GENERATOR = """
async def robot():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(Feeder())
        yield runtime

async def enter(generator):
    return await anext(generator)

async def other():
    generator = robot()
    await asyncio.create_task(enter(generator))
    LEFT
"""


@pytest.mark.parametrize(
    ("left", "status"),
    [
        ("await began.wait(); await asyncio.sleep(0.1)", 0),  # the event loop closes the generator
        ("await began.wait(); await asyncio.sleep(0.1); await generator.aclose()", 0),
        ("await began.wait(); await asyncio.sleep(0.1); await asyncio.create_task(generator.aclose())", 0),
        ("await began.wait(); await asyncio.sleep(0.1); sys.exit(3)", 3),
        ("await asyncio.sleep(3600)", 143),
    ],
)
def test_a_block_that_another_task_leaves_stops_the_tree_all_the_same(left, status):
    text = program("", braking=0.06) + GENERATOR.replace("LEFT", left) + "\nasyncio.run(other())"
    with python("-c", text) as process:
        assert process.stdout.readline() == "driving\n"
        if status == 143:
            process.send_signal(signal.SIGTERM)
        output, found, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert found == status, errors


@pytest.mark.parametrize(
    "where",
    [
        "asyncio.get_running_loop().call_later(0.1, sys.exit, 7)",
        "asyncio.create_task(leave())",
        "feeder.spawn(leave())",
        "feeder.call_later(0.1, lambda: sys.exit(7))",
        "feeder.every(10, lambda tick: tick.number and sys.exit(7))",
    ],
)
@pytest.mark.parametrize("entry", [pytest.param("asyncio.run(other())", marks=pytest.mark.slow), "mdm.run(other)"])
def test_an_exit_anywhere_ends_in_order_and_keeps_its_status(entry, where):
    text = program("") + (
        "async def leave():\n    await asyncio.sleep(0.1)\n    sys.exit(7)\n"
        "async def other():\n    async with mdm.Runtime(log=None) as runtime:\n        feeder = Feeder()\n"
        "        await runtime.start(feeder)\n        await began.wait()\n"
        f"        kept = {where}\n        await runtime.wait()\n{entry}"
    )
    with python("-c", text) as process:
        output, status, errors = ended(process)
    assert output == "driving\nSAFE\nbraked\n", errors
    assert status == 7


@pytest.mark.parametrize("action", ["async def drive():\n    sys.exit(7)", "def drive():\n    sys.exit(7)"])
def test_an_exit_in_an_action_runs_the_safe_action(action):
    with python("-c", program(f"{action}\nmdm.run(main)")) as process:
        output, status, errors = ended(process)
    assert output == "SAFE\nbraked\n", errors
    assert status == 7


def test_a_signal_that_is_ignored_stays_ignored():
    """A shell ignores SIGINT for what it starts in the background."""
    process = subprocess.Popen(
        [sys.executable, "-c", program("asyncio.run(main())")],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),  # noqa: PLW1509 - no thread of ours runs
    )
    try:
        assert process.stdout.readline() == "driving\n"
        process.send_signal(signal.SIGINT)
        time.sleep(0.2)  # nothing comes that could be waited for
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=PATIENCE)[0] == "SAFE\nbraked\n"
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 143


def handlers():
    return [signal.getsignal(number) for number in NUMBERS]


def test_handlers_are_given_back_in_any_order_and_the_program_s_own_are_left_alone():
    before = handlers()
    heard = []
    own = signal.signal(signal.SIGHUP, lambda *_: heard.append("own"))

    async def main():
        mine = signal.getsignal(signal.SIGHUP)
        first, second = Runtime(log=None), Runtime(log=None)
        ours = handlers()
        await first.__aenter__()
        await second.__aenter__()
        assert handlers() != ours
        assert signal.getsignal(signal.SIGHUP) is mine
        signal.raise_signal(signal.SIGHUP)
        await first.__aexit__(None, None, None)
        await second.__aexit__(None, None, None)
        assert handlers() == ours

    try:
        asyncio.run(main())
        assert heard == ["own"]
    finally:
        signal.signal(signal.SIGHUP, own)
    assert handlers() == before


def test_without_signals_the_program_s_stay_as_they_are():
    async def main():
        before = handlers()
        async with Runtime(log=None, signals=False):
            assert handlers() == before

    asyncio.run(main())


def test_a_signal_ends_every_open_runtime(monkeypatch, caplog):
    opened, stopped = [], []

    async def one(name):
        async with Runtime(log=None) as runtime:
            try:
                opened.append(name)
                if len(opened) == 2:
                    os.kill(os.getpid(), signal.SIGTERM)
                await runtime.wait()
            finally:
                stopped.append(name)

    async def main():
        await asyncio.gather(one("first"), one("second"))

    monkeypatch.setattr(signals, "_LINGER", 0.0)
    before = handlers()
    try:
        with pytest.raises(SystemExit) as left:
            run(main)
    finally:
        for number, handler in zip(NUMBERS, before, strict=True):
            signal.signal(number, handler)
    assert left.value.code == 143
    assert sorted(stopped) == ["first", "second"]
    del left
    gc.collect()
    assert caplog.text == ""


def test_a_thread_cannot_hear_signals():
    async def main():
        with refused(Error):
            await Runtime(log=None, signals=True).__aenter__()

    asyncio.run(asyncio.wait_for(asyncio.to_thread(asyncio.run, main()), PATIENCE))


FORK = """
import os, signal, sys, time, warnings, mdm
warnings.simplefilter("ignore")

async def main():
    async with mdm.Runtime(log=None) as runtime:
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.write(writer, b"here")
            while True:  # a pause could begin after the signal has come
                time.sleep(0.01)
        os.read(reader, 4)  # Python forgets a signal that comes while it forks
        os.kill(child, signal.SIGTERM)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))

mdm.run(main)
"""


def test_a_forked_child_dies_of_its_signal():
    with python("-c", FORK) as process:
        output, status, errors = ended(process)
    assert (output, status) == ("-15\n", 0), errors


STUCK = """
import asyncio
import mdm

class Gripper(mdm.Actor):
    def on_running(self):
        print("running", flush=True)

    async def on_stopping(self):
        await asyncio.Event().wait()

mdm.run(Gripper("gripper"))
"""


def test_an_actor_that_never_ends_is_named_in_the_log():
    with python("-c", STUCK) as process:
        assert process.stdout.readline() == "running\n"
        process.send_signal(signal.SIGTERM)
        lines = iter(process.stderr.readline, "")
        told = next(line for line in lines if "has not ended within 1 s" in line)
        assert "gripper" in told
        assert "<string>:10" in told
        assert process.poll() is None  # it is still held
