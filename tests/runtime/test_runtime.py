"""The runtime's block: how it is left, and that it is one of several."""

from __future__ import annotations

import asyncio
import gc
import weakref
from contextlib import nullcontext

import pytest
from recorded import Fragile, Recorded, tell
from sentences import refused

import mdm
from mdm import Ensemble, Error, PredicateManager, Runtime, StateFactor, VirtualClock, run
from mdm.messages import State
from mdm.runtime import VirtualEventLoop
from mdm.testing import probe, run_virtual


def test_the_block_may_be_left_in_any_way():
    log = []

    async def leave(how):
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            await runtime.start(Recorded("actor", log))
            if how == "raise":
                raise LookupError("own error")
            if how == "timeout":
                await asyncio.sleep(3600)

    async def main(how):
        async with asyncio.timeout(5):
            await leave(how)

    run(lambda: main("return"), virtual=True)
    with refused(LookupError):
        run(lambda: main("raise"), virtual=True)
    with pytest.raises(TimeoutError):
        run(lambda: main("timeout"), virtual=True)
    assert log == [("start", "actor"), ("stop", "actor")] * 3


def test_ensembles_of_ever_new_names_leave_nothing_in_a_runtime_that_goes_on():
    async def main(runtime):
        async def come_and_go(name):
            predicates = PredicateManager()
            sensor = predicates.sensor("S", max_age=1.0)
            robot = Ensemble(
                name,
                policy=[0, 1],
                actions={"A": lambda: None, "B": lambda: asyncio.sleep(9)},
                predicates=predicates,
                states=[StateFactor("s", ["S"])],
                safe_action=lambda: None,
            )
            await runtime.start(robot)
            sensor.set(True)
            await runtime.stop(robot)
            return weakref.ref(robot)

        channels = runtime.channels
        robots = [await come_and_go(f"robot{number}") for number in range(20)]
        assert runtime.channels == channels
        await asyncio.sleep(100)  # until no timer of theirs waits
        gc.collect()
        assert [robot() for robot in robots] == [None] * 20

    run_virtual(main)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"clock": 5}, "a runtime's clock is a WallClock"),
        ({"debug": "yes"}, "debug is True or False, not 'yes'"),
        ({"signals": 1}, "signals is True or False, not 1"),
        ({"starved_after": 0}, "starved_after is a number of seconds above 0"),
    ],
)
def test_what_is_no_setting_of_a_runtime_is_refused(options, words):
    with pytest.raises(Error, match=words):
        Runtime(**options)


def test_two_runtimes_in_one_program_do_not_know_of_each_other():
    async def main():
        async with Runtime(clock=VirtualClock(), log=None) as first, Runtime(clock=VirtualClock(), log=None) as second:
            seen = probe(first.channel("numbers", State)), probe(second.channel("numbers", State))
            tell(first, 1)
            await second.start(Fragile("fragile", [], supervision="stop"))
            tell(second, 3)
            return [len(messages) for messages in seen]

    assert run(main, virtual=True) == [1, 1]


@pytest.mark.parametrize("error", [asyncio.CancelledError, SystemExit])
@pytest.mark.parametrize("how", ["return", "raise", "abort"])
def test_at_the_end_all_that_run_are_told_at_once_before_the_first_stops(how, error):
    log = []

    class Told(Recorded):
        def on_ending(self):
            log.append(("told", self.name))
            raise error(self.name)

        async def on_stopping(self):
            await asyncio.sleep(0.5)

    async def main():
        async with Runtime(log=None) as runtime:
            runtime.faults.subscribe(faults.append)
            first = Told("first", log)
            first.add(Told("below", log))
            await runtime.start(first)
            await runtime.start(Told("second", log))
            assert not runtime.ending
            log.clear()
            try:
                if how == "raise":
                    raise LookupError
                if how == "abort":
                    runtime.abort(SystemExit(3))
                    await asyncio.sleep(1)
            finally:
                assert runtime.ending == (how == "abort")

    order, faults = ["first", "below", "second"], []
    raised = SystemExit if how == "abort" or error is SystemExit else {"raise": LookupError}.get(how)
    with pytest.raises(raised) if raised else nullcontext():
        run(main, virtual=True)
    assert [fault.detail.partition(" (")[0] for fault in faults] == [f"{error.__name__}: {name}" for name in order]
    told = [("told", name) for name in order]
    assert log == [*told, ("stop", "second"), ("stop", "first/below"), ("stop", "first")]


async def outer(program, how):
    if how == "timeouts":
        async with asyncio.timeout(1.5), asyncio.timeout(1.0):
            await program
    elif how == "wait_for":
        async with asyncio.timeout(1.5):
            await asyncio.wait_for(program, 1.0)
    else:
        task = asyncio.ensure_future(program)
        for seconds in (1.0, 0.25, 0.25):
            await asyncio.sleep(seconds)
            task.cancel()
        await task


@pytest.mark.parametrize("how", ["timeouts", "wait_for", "three"])
@pytest.mark.parametrize("seconds", [2.0, 60.0])
def test_a_program_that_is_cancelled_again_breaks_nothing_off_within_its_limits(how, seconds):
    log = []

    async def brake():
        try:
            await asyncio.sleep(seconds)
            log.append("stands")
        except asyncio.CancelledError:
            log.append("broken off")

    async def program():
        robot = Ensemble("robot", policy=[0], actions={"Go": lambda: None}, safe_action=brake)
        async with Runtime(log=None) as runtime:
            await runtime.start(robot)
            await runtime.wait()

    async def main():
        with pytest.raises((TimeoutError, asyncio.CancelledError)):
            await outer(program(), how)
        return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualEventLoop) as runner:  # which cancels what is left at its end
        ended = runner.run(main())
    assert log == (["stands"] if seconds == 2.0 else ["broken off", "broken off"])
    assert ended < 40


@pytest.mark.parametrize("again", [1, 2])
def test_what_has_no_limit_of_its_own_is_broken_off_a_moment_after_a_cancellation(again):
    class Endless(Recorded):
        async def on_stopping(self):
            await asyncio.sleep(3600)

    async def program():
        async with Runtime(log=None) as runtime:
            await runtime.start(Endless("endless", log))

    async def main():
        task = asyncio.create_task(program())
        for _ in range(again):
            await asyncio.sleep(10)
            task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        return asyncio.get_running_loop().time()

    log = []
    assert run(main, virtual=True) == 10 * again
    assert log[-1] == ("stop", "endless")


def test_an_actor_needs_a_runtime_that_was_entered():
    async def main():
        await Runtime(log=None).start(PredicateManager("robot"))

    with refused(Error):
        run(main, virtual=True)


def test_an_exit_of_the_program_outlasts_a_cancellation_of_the_block_meanwhile():
    class Leaves(mdm.Actor):
        def on_running(self):
            self.spawn(self.leave())

        async def leave(self):
            raise SystemExit(3)

        async def on_stopping(self):
            await asyncio.sleep(1)

    async def main():
        async with mdm.Runtime(log=None) as runtime:
            await runtime.start(Leaves("leaves"))
            asyncio.get_running_loop().call_later(0.5, asyncio.current_task().cancel)
            await runtime.wait()

    with pytest.raises(SystemExit) as left:
        mdm.run(main, virtual=True)
    assert left.value.code == 3


def test_without_asyncio_s_event_loop_the_way_out_is_told():
    """As under trio, where no loop of asyncio runs."""
    with refused(Error):
        mdm.Runtime(log=None).__aenter__().send(None)
