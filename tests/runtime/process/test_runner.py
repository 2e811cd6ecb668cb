"""What `run` takes, and how it ends."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
import threading
from contextlib import nullcontext

import pytest
from programs import python
from sentences import refused

from mdm import Actor, ActorFailure, DeadlockError, Ensemble, Error, FixedRate, Runtime, WallClock, load_system, run
from mdm.messages import State
from mdm.policies import DeterministicPolicy
from mdm.runtime import VirtualClock


def robot(calls, **options):
    return Ensemble(
        "robot",
        policy=DeterministicPolicy([0], 1),
        actions={"go": lambda: calls.append("go")},
        **options,
    )


class Feeder(Actor):
    """A robot and what tells it its state."""

    def __init__(self, calls):
        super().__init__("feeder")
        self.robot = robot(calls, drive=FixedRate(10.0))
        self.add(self.robot)

    def on_running(self):
        self.robot.publish_state(0)


def test_a_runtime_takes_the_time_of_its_event_loop():
    async def main():
        calls = []
        async with Runtime(log=None) as runtime:
            assert isinstance(runtime.clock, VirtualClock)
            await runtime.start(Feeder(calls))
            await asyncio.sleep(0.95)
        return len(calls)

    assert run(main, virtual=True) == 10

    async def real():
        return type(Runtime(log=None).clock)

    assert run(real) is WallClock


@pytest.mark.parametrize("make", [lambda: Runtime(clock=WallClock(), log=None), None])
def test_a_wall_clock_in_virtual_time_is_refused(make):
    outside = Runtime(log=None)

    async def main():
        async with make() if make else outside:
            pass

    with refused(Error):
        run(main, virtual=True)


def test_an_ensemble_runs_for_some_seconds_and_again(capsys):
    calls = []
    feeder = Feeder(calls)
    assert run(feeder, virtual=True, seconds=0.95) is None
    assert calls == ["go"] * 10
    assert feeder.life == "stopped"
    run(feeder, virtual=True, seconds=0.95)
    assert calls == ["go"] * 20
    capsys.readouterr()


def test_a_system_runs_until_nothing_is_left_to_do(tmp_path, capsys):
    (tmp_path / "robot.toml").write_text(
        "[predicates]\nA = { initial = true }\n[ensembles.robot]\npolicy = [0, 0]\nsafe_action = 'Go'\n"
        "[ensembles.robot.states]\na = ['A']\n[ensembles.robot.actions]\nGo = 'nowhere:go'\n"
    )
    system = load_system(tmp_path / "robot.toml", callbacks=False)
    run(system, virtual=True)
    assert system.ensembles["robot"].action.ended == {"succeeded": 2}  # of which the last is the safe action
    capsys.readouterr()


def test_an_actor_that_ends_ends_the_run(capsys):
    class Brief(Actor):
        def on_running(self):
            self.call_later(3.0, self.end)

    run(Brief("brief"), virtual=True)

    class Faulty(Actor):
        def on_running(self):
            self.call_later(3.0, lambda: 1 / 0)

    for supervision, words in (("escalate", "division by zero"), ("stop", "'faulty' failed")):
        with pytest.raises(ActorFailure, match=words):
            run(Faulty("faulty", supervision=supervision), virtual=True)
    capsys.readouterr()


def test_functions_and_coroutines_run_to_their_end():
    async def main():
        await asyncio.sleep(1)
        return 7

    assert run(main, virtual=True) == run(main(), virtual=True) == 7
    with pytest.raises(DeadlockError):
        run(lambda: asyncio.Event().wait(), virtual=True)


async def coroutine():
    pass


@pytest.mark.parametrize(
    ("program", "options", "words"),
    [
        (lambda: 7, {}, "not 7|returned 7 in place of a coroutine: define it with `async def`"),
        (7, {}, "a program is an ensemble, a system, another actor or an async function, not 7"),
        (coroutine, {"seconds": 1}, "seconds is for an actor"),
        (Actor("a"), {"seconds": 0}, "seconds is a number of seconds above 0 .* not 0"),
    ],
)
def test_what_cannot_be_run(program, options, words):
    with pytest.raises(Error, match=words):
        run(program, **options)


def test_a_coroutine_that_is_refused_is_closed():
    with refused(Error):
        run(coroutine(), seconds=1)


def test_a_second_event_loop_is_refused():
    async def main():
        with refused(Error):
            run(coroutine())

    asyncio.run(main())


ROBOT = """
import sys, mdm

class Robot(mdm.Actor):
    def on_running(self):
        print("ready", flush=True)
    def on_stop(self):
        print("stopped", flush=True)

mdm.run(Robot("robot"))
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)])
def test_signals_stop_an_actor_in_order(number, status):
    with python("-c", ROBOT) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        output, errors = process.communicate()
    assert output == "stopped\n"
    assert process.returncode in {status, 130}, errors


PROGRAM = """
import asyncio, sys, mdm
from mdm.messages import State

class Robot(mdm.Actor):
    def on_start(self):
        self.spawn(self.drive(), lambda work: print("work ended", flush=True))
    async def drive(self):
        try:
            print("ready", flush=True)
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(0.01)
            print("motors off", flush=True)
    def on_stop(self):
        print("stopped", flush=True)

async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(Robot("robot"))
        await runtime.wait()

mdm.run(main, uvloop=len(sys.argv) > 1)
"""


@pytest.mark.parametrize("loop", [[], ["uvloop"]])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)])
def test_signals_stop_a_program_in_order(loop, number, status):
    with python("-c", PROGRAM, *loop) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        output, errors = process.communicate()
    assert output == "motors off\nwork ended\nstopped\n"
    assert process.returncode in {status, 130}, errors


def test_run_works_in_another_thread():
    results = []

    async def main():
        async with Runtime(log=None):
            results.append("ran")

    thread = threading.Thread(target=lambda: run(main))
    thread.start()
    thread.join()
    assert results == ["ran"]


def test_a_class_is_no_program():
    with refused(Error):
        run(Ensemble)


def test_what_a_task_that_is_left_fails_of_is_told(caplog):
    kept = []

    async def fail():
        try:
            await asyncio.sleep(3600)
        finally:
            raise ValueError("too late")

    async def main():
        kept.append(asyncio.create_task(fail()))
        await asyncio.sleep(0)

    gc.collect()  # what other tests have left behind is told of now, and not below
    caplog.clear()
    run(main)
    kept.clear()
    gc.collect()
    assert [record.message for record in caplog.records] == ["a task failed while the program ended"]
    assert "ValueError: too late" in caplog.text


@pytest.mark.parametrize("how", ["return", "raise", "exit", "stop", "cancelled", "exit beside"])
def test_a_runtime_in_a_task_that_is_left_ends_within_its_limits(how):
    log, kept = [], []

    async def brake():
        log.append("brake")
        try:
            await asyncio.sleep(2)
            log.append("stands")
        except asyncio.CancelledError:
            log.append("broken off")
            raise

    async def live():
        async with Runtime(log=None) as runtime:
            await runtime.start(robot(log, safe_action=brake, drive=FixedRate(1.0)))
            runtime.channel("robot/state", State).publish(State(0, 0, (0,)))
            await runtime.wait()

    async def drive_bus():
        try:
            await asyncio.sleep(3600)
        finally:
            log.append("bus closed")

    async def leave():
        await asyncio.sleep(0.5)
        sys.exit(3)

    async def main():
        kept.append(asyncio.create_task(drive_bus()))
        if how == "exit beside":
            kept.append(asyncio.create_task(leave()))
            await live()
        kept.append(asyncio.create_task(live()))
        await asyncio.sleep(0.5)
        if how == "raise":
            raise LookupError
        if how == "exit":
            sys.exit(3)
        if how == "stop":
            asyncio.get_running_loop().stop()
            await asyncio.sleep(1)
        if how == "cancelled":
            kept[-1].cancel()
            await asyncio.sleep(0.5)

    raised = {"raise": LookupError, "stop": RuntimeError, "exit": SystemExit, "exit beside": SystemExit}.get(how)
    with pytest.raises(raised) if raised else nullcontext():
        run(main, virtual=True)
    assert log[-3:] == ["brake", "stands", "bus closed"]
    kept.clear()


def test_what_ends_the_program_in_one_task_breaks_no_robot_off():
    log = []

    class Slow(Actor):
        async def on_stopping(self):
            await asyncio.sleep({"first": 0.25, "second": 0.75}[self.name])
            log.append(self.name)

    async def live(name):
        async with Runtime(log=None) as runtime:
            await runtime.start(Slow(name))
            try:
                await runtime.wait()
            finally:
                runtime.abort(SystemExit(name))

    async def main():
        kept.extend(asyncio.create_task(live(name)) for name in ("first", "second"))
        await asyncio.sleep(1)

    kept = []
    with pytest.raises(SystemExit):
        run(main, virtual=True)
    assert log == ["first", "second"]
