"""What only watches a run never harms it: observers that raise, and texts that none of them can take."""

from __future__ import annotations

import asyncio
import functools
import threading
from typing import Any

import msgspec
import pytest

import mdm
from mdm import Actor, Runtime
from mdm.messages import ActionLife, SensorUpdate
from mdm.recording import Record, Recorder
from mdm.runtime.process import log as log_module
from mdm.runtime.tape import Tape
from mdm.snapshots import LiveRun
from mdm.testing import probe, run_virtual

ERRORS = [Exception, MemoryError, RecursionError]
TEXTS = ["caf\udce9.yaml", "\0 and \x1b[2J", "10 MB: " + 10_000_000 * "x", "<script>alert('&')</script>", ""]
NOTES = [name for name in vars(Tape) if not name.startswith("_") and name != "comes"]


class Sabotage:
    """Raises in one of the calls that come to it, or in all.

    Args:
        error: What it raises.
        place: In which call, counted from 0; None for all of them, -1 for none.
    """

    def __init__(self, error=Exception, place=-1):
        self.error, self.place, self.calls = error, place, 0

    def __call__(self, function):
        @functools.wraps(function)
        def called(*arguments, **named):
            self.calls += 1
            if self.place is None or self.place == self.calls - 1:
                raise self.error("as it was meant to be \udce9")
            return function(*arguments, **named)

        return called


def recorder(path, sabotage):
    """Return a recorder that fails as its notes are taken, and writes nothing."""

    class Failing(Recorder):
        pass

    for name in NOTES:
        setattr(Failing, name, sabotage(vars(Recorder)[name]))
    failing = Failing(path)
    failing._writer.open = lambda: None
    return failing


class Logger:
    """A log of the program's own.

    Args:
        sabotage: In what it fails.
    """

    def __init__(self, sabotage):
        self.debug = self.info = self.warning = self.error = sabotage(lambda *_, **__: None)


class Own(msgspec.Struct):
    message: Any


class Fragile(Actor):
    """Fails, and starts anew."""

    def __init__(self):
        super().__init__("fragile", supervision=mdm.Restart(limit=3, backoff=0.1))

    def on_running(self):
        self.every(0.7, self._break)

    def _break(self, _):
        raise ValueError(TEXTS[0])


def a_robot():
    """Return a robot of which most goes wrong: actions of all kinds that fail with hostile texts, ticks, a child."""
    texts = iter(TEXTS * 100)
    predicates = mdm.PredicateManager("predicates")
    near = predicates.sensor("Near", initial=False)
    far = predicates.sensor("Far", initial=True)

    def fails():
        raise ValueError(next(texts))

    async def drives():
        await asyncio.sleep(0.4)
        near.set(not near.value)
        await asyncio.sleep(0.2)
        raise OSError(next(texts))

    ensemble = mdm.Ensemble(
        "robot",
        policy=mdm.policies.DeterministicPolicy([0, 1, 2, 0], 3),
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"]), mdm.StateFactor("far", ["Far"])],
        actions={"fails": fails, "drives": drives, "stays": lambda: None},
        safe_action=lambda: None,
        drive=2.0,
    )
    return ensemble, near, far


def a_failing_robot():
    """Return a robot whose first action fails with a text that nothing can encode."""

    def fails():
        raise ValueError(TEXTS[0])

    policy = mdm.policies.DeterministicPolicy([0], 1)
    return mdm.Ensemble("robot", policy=policy, actions={"fails": fails}, safe_action=lambda: None)


def lived(**options):
    """Run the robot in virtual time, and return its decisions, modes, lives, own failures, and observers' faults."""
    look = options.pop("look", None)
    ensemble, near, far = a_robot()
    told = {}

    async def main():
        runtime = Runtime(**{"log": False, **options})
        for name in ("decisions", "modes", "lives", "faults"):
            told[name] = probe(getattr(runtime, name))
        told["robot"] = probe(runtime.channel("robot/lives", ActionLife))
        async with runtime:
            await happen(runtime)

    async def happen(runtime):
        live = None if look is None else look(runtime)
        near.set(False)
        await runtime.start(ensemble)
        await runtime.start(Fragile())
        for number in range(8):
            far.set(number % 3 == 0)
            await asyncio.sleep(0.3)
            if live is not None:
                live.frame()
            if number == 3:
                ensemble.stop()
            if number == 4:
                ensemble.start()
        ensemble.report("own", TEXTS[number % 2])
        await asyncio.sleep(1)
        if live is not None:
            live.close()

    mdm.run(main, virtual=True)
    observers = [each.detail for each in told["faults"] if each.kind == "observer"]
    told["faults"] = [each for each in told["faults"] if each.kind not in {"observer", "record"}]
    return told, observers


@pytest.fixture(scope="module")
def alone():
    """Return what the robot does while nobody watches."""
    told, observers = lived()
    assert not observers
    assert {each.status for each in told["robot"]} >= {"running", "failed", "succeeded"}
    assert {each.mode for each in told["modes"]} >= {"deciding", "safe"}
    assert len(told["decisions"]) > 5
    return told


def places(calls, shard):
    """Return the calls to fail in: of many, some of each kind, for each error others."""
    return [*range(shard, calls, max(1, calls // 12)), None]


def of_recorders(tmp_path, sabotage, patch):
    return {"record": recorder(tmp_path / "run.mcap", sabotage)}


def of_pages(tmp_path, sabotage, patch):
    for name in ("_on_mode", "_on_fault", "_on_idle", "_on_life"):
        patch.setattr(LiveRun, name, sabotage(vars(LiveRun)[name]))

    def look(runtime):
        live = LiveRun(runtime)
        live.open()
        return live

    return {"look": look}


def of_logs(tmp_path, sabotage, patch):
    return {"log": Logger(sabotage), "debug": True}


def of_log_handlers(tmp_path, sabotage, patch):
    for name in ("_published", "_changed", "_tells"):
        patch.setattr(mdm.runtime.Log, name, sabotage(vars(log_module.Log)[name]))
    return {"log": Logger(Sabotage())}


@pytest.mark.parametrize("make", [of_recorders, of_pages, of_logs, of_log_handlers])
@pytest.mark.parametrize("error", ERRORS)
def test_an_observer_that_raises_at_any_call_changes_nothing(make, error, alone, tmp_path):
    count = Sabotage()
    with pytest.MonkeyPatch.context() as patch:
        assert lived(**make(tmp_path, count, patch)) == (alone, [])
    assert count.calls > 12
    for place in places(count.calls, ERRORS.index(error)):
        with pytest.MonkeyPatch.context() as patch:
            told, observers = lived(**make(tmp_path, Sabotage(error, place), patch))
        assert told == alone, place
        assert len(observers) == 1, place
        (detail,) = observers  # once
        assert f"has failed: {error.__name__}: as it was meant to be \\udce9" in detail


def test_each_note_of_a_recorder_may_fail():
    assert set(NOTES) >= {"said", "decided", "finishes", "goes_on", "kept", "counts_from", "latency", "raised"}
    assert all(name in vars(Recorder) for name in NOTES)


def test_a_question_is_answered_as_without_the_observer_and_asked_once():
    async def main(runtime):
        guard = runtime.guard("the tape")
        asked = []

        class Broken:
            def __getattr__(self, name):
                def note(*_, **__):
                    raise MemoryError

                return note

        tape = guard.tape(Broken())
        for answer in (True, False):
            assert tape.goes_on("robot", 1, 2, lambda answer=answer: asked.append(answer) or answer) is answer
        assert asked == [True, False]
        assert tape.kept("robot", {"Near": True}, {"Near": 3}, 4) == ({"Near": True}, {"Near": 3})
        assert tape.counts_from("robot", 4, 5) == 5
        assert tape.latency("robot", 1, 2, 3, 4) == 3
        assert tape.raised("robot", 1, "", 2, unrun=True) is None
        await tape.comes("robot", "start")
        assert not tape.repeats
        return guard.lost

    assert run_virtual(main) == 6


def test_an_observer_at_the_end_of_the_stack_is_counted():
    """Where there is no room for one more call, nothing can be told: the next failure is."""

    async def main(runtime):
        guard, faults = runtime.guard("the page"), probe(runtime.faults)
        depths = []

        def endless():
            endless()

        def deep():
            depths.append(None)
            hear()
            deep()

        hear = guard(endless)

        with pytest.raises(RecursionError):
            deep()
        assert guard.lost >= len(depths) - 1 > 10
        guard(lambda: 1 / 0)()
        await asyncio.sleep(0)
        return [each.kind for each in faults]

    assert run_virtual(main) == ["observer"]


def test_what_ends_a_program_passes():
    async def main(runtime):
        def ends():
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            runtime.guard("the page")(ends)()

    run_virtual(main)


@pytest.mark.parametrize("virtual", [True, False])
def test_hostile_texts_and_messages_leave_the_record_whole(virtual, tmp_path):
    path = tmp_path / "run.mcap"
    recorder = Recorder(path, channels=["own"])

    class Talker(Actor):
        def on_start(self):
            self.own = self.runtime.channel("own", Own)

        def on_running(self):
            cycle, deep = {}, {}
            cycle["again"] = cycle
            for _ in range(100_000):
                deep = {"in": deep}
            for message in ("caf\udce9", cycle, deep, {"fine": 1}):
                self.own.publish(Own(message))

    async def main():
        async with Runtime(log=False, record=recorder) as runtime:
            faults = probe(runtime.faults)
            await runtime.start(Talker("talker"))
            robot = a_failing_robot()
            await runtime.start(robot)
            robot.publish_state(0)
        return faults

    faults = mdm.run(main, virtual=virtual)
    found = Record(path)
    assert [each.message for each in found.messages(["own"])] == [{"message": {"fine": 1}}]
    assert (found.closed, found.lost, recorder.statistics().dropped) == (True, 3, 3)
    kinds = [each.message.kind for each in found.messages(["faults"])]
    assert kinds.count("observer") == 1 == [each.kind for each in faults].count("observer")
    details = "; ".join(each.message.detail for each in found.messages(["faults"]))
    assert "ValueError: caf\\udce9.yaml" in details


def test_without_a_log_a_failure_that_no_thread_can_print_ends_nothing(monkeypatch):
    class Threadless(threading.Thread):
        def start(self):
            if self.name == "mdm:log":
                raise RuntimeError("can't start new thread")
            super().start()

    monkeypatch.setattr("mdm.runtime.process.writer.threading.Thread", Threadless)
    closed = []

    class Signals(mdm.runtime.runtime.Signals):
        def close(self):
            super().close()
            closed.append("signals")

    monkeypatch.setattr("mdm.runtime.runtime.Signals", Signals)

    async def main():
        robot = a_failing_robot()
        async with Runtime(log=None, watchdog=None) as runtime:
            faults = probe(runtime.faults)
            await runtime.start(robot)
            robot.publish_state(0)
        return faults

    assert [each.kind for each in mdm.run(main)] == ["action", "observer"]
    assert closed == ["signals"]


def test_what_raises_at_the_end_leaves_nothing_open(tmp_path):
    class Showing:
        async def open(self, runtime):
            pass

        async def close(self):
            raise OSError("the page cannot be closed")

    class Closing(mdm.runtime.Log):
        def close(self):
            super().close()
            raise OSError("the log cannot be closed")

    path = tmp_path / "run.mcap"
    log = Closing(Logger(Sabotage()))
    run_virtual(lambda runtime: runtime.start(a_robot()[0]), record=path, page=Showing(), log=log)
    found = Record(path)
    assert found.closed
    (fault,) = (
        each.message
        for each in found.messages(["faults"])
        if each.message.kind == "observer" and "page" in each.message.detail
    )
    assert "the page has failed: OSError: the page cannot be closed" in fault.detail


def test_the_first_fault_of_a_log_that_fails_is_told_from_its_thread():
    async def main():
        async with Runtime(log=Logger(Sabotage(place=None))) as runtime:
            told = asyncio.Event()
            faults = []

            def hear(fault):
                faults.append(fault)
                told.set()

            runtime.faults.subscribe(hear)
            await runtime.start(Actor("one"))
            await told.wait()
        return [each.kind for each in faults], runtime.statistics().log

    kinds, found = mdm.run(main)
    assert kinds == ["observer"]
    assert found.written == 0 < found.lost


def test_sensors_set_while_a_tape_fails_are_taken_in_their_order():
    """A fault that is told in the middle of a stimulus comes behind it."""

    async def main(runtime):
        order = []
        runtime.dispatcher.tape = runtime.guard("the tape").tape(Failing())
        channel = runtime.channel("in", SensorUpdate)
        channel.input = True
        runtime.faults.subscribe(lambda fault: order.append(fault.kind))
        channel.publish(SensorUpdate(0, {}, ()))  # to nobody
        channel.subscribe(lambda update: order.append("update"))
        channel.publish(SensorUpdate(0, {}, ()))
        await asyncio.sleep(0)
        return order

    class Failing:
        def __getattr__(self, name):
            def note(*_):
                if name == "said":
                    raise ValueError

            return note

    assert run_virtual(main) == ["update", "observer"]
