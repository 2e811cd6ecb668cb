"""What only watches a run never harms it: observers that raise, and texts that none of them can take."""

from __future__ import annotations

import asyncio
import functools
import gc
import threading
from collections import Counter
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import mdm
from mdm import Actor, Runtime
from mdm.messages import ActionLife, Idle, SensorUpdate
from mdm.recording import Record, Recorder
from mdm.runtime.observing import Choices, Guard, Observer
from mdm.runtime.process import log as log_module
from mdm.snapshots import LiveRun
from mdm.stimuli import Said
from mdm.testing import probe, run_virtual

ERRORS = [Exception, MemoryError, RecursionError]
TEXTS = ["caf\udce9.yaml", "\0 and \x1b[2J", "10 MB: " + 10_000_000 * "x", "<script>alert('&')</script>", ""]
NOTES = [name for name in vars(Observer) if name.startswith("on_") and name in vars(Recorder) and name != "on_end"]


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


def a_lamp():
    """Return what calls functions that succeed, of whose lives nobody asks."""
    policy = mdm.policies.DeterministicPolicy([0, 1], 2)
    return mdm.Ensemble("lamp", policy=policy, actions={"shines": lambda: None, "rests": lambda: None})


def lived(**options):
    """Run the robot in virtual time, and return its decisions, modes, lives, own failures, and observers' faults."""
    look = options.pop("look", None)
    ensemble, near, far = a_robot()
    lamp = a_lamp()
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
        await runtime.start(lamp)
        for number in range(8):
            lamp.publish_state(number % 2)
            far.set(number % 3 == 0)
            await asyncio.sleep(0.3)
            if live is not None:
                live.frame()
            if number == 3:
                ensemble.stop()
            if number == 4:
                ensemble.start()
        ensemble.report("own", TEXTS[number % 2])
        runtime.idles.publish(Idle(runtime.now(), "lamp", True, 0, "shines", False))
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
    for name in ("on_mode", "on_fault", "on_idle", "on_life"):
        patch.setattr(LiveRun, name, sabotage(vars(LiveRun)[name]))

    def look(runtime):
        live = LiveRun(runtime)
        live.open()
        return live

    return {"look": look}


def of_logs(tmp_path, sabotage, patch):
    return {"log": Logger(sabotage), "debug": True}


def of_log_handlers(tmp_path, sabotage, patch):
    for name in ("on_fault", "on_mode", "_tells"):
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
    assert set(NOTES) == {"on_message", "on_step", "on_stimulus", "on_life", "on_call", "on_control"}


def test_the_world_answers_where_no_run_is_repeated():
    async def main():
        asked, choices = [], Choices()
        for answer in (True, False):
            assert choices.goes_on("robot", 1, 2, lambda answer=answer: asked.append(answer) or answer) is answer
        assert asked == [True, False]
        assert choices.kept("robot", {"Near": True}, {"Near": 3}, 4) == ({"Near": True}, {"Near": 3})
        assert choices.counts_from("robot", 4, 5) == 5
        assert choices.latency("robot", 1, 2, 3) == 3
        assert [choices.over("robot", 1, 2, 3, over) for over in (True, False)] == [True, False]
        await choices.comes("robot", "start")
        assert not choices.repeats

    asyncio.run(main())


def test_an_observer_at_the_end_of_the_stack_is_counted():
    """Where there is no room for one more call, nothing can be told: the next failure is."""

    async def main(runtime):
        guard, faults = Guard(runtime, "the page"), probe(runtime.faults)
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
            Guard(runtime, "the page")(ends)()

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
        def on_end(self):
            super().on_end()
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


def test_sensors_set_while_an_observer_fails_are_taken_in_their_order():
    """A fault that is told in the middle of a stimulus comes behind it."""

    async def main(runtime):
        order = []
        runtime.observe(Failing())
        channel = runtime.channel("in", SensorUpdate)
        channel.input = True
        runtime.faults.subscribe(lambda fault: order.append(fault.kind))
        channel.publish(SensorUpdate(0, {}, ()))  # to nobody
        channel.subscribe(lambda update: order.append("update"))
        channel.publish(SensorUpdate(0, {}, ()))
        await asyncio.sleep(0)
        return order

    class Failing(Observer):
        def on_message(self, channel, message, time):
            raise ValueError

    assert run_virtual(main) == ["update", "observer"]


# -- Observers of the program's own ------------------------------------------------------------------------------------

HOOKS = [name for name in vars(Observer) if name.startswith("on_")]


def observing(heard, fails=lambda name: None):
    """Return an observer that notes what it hears, by the methods that it overrides, and raises then where it should.

    Args:
        heard: Lists of what was heard, by the names of methods: those that are overridden.
        fails: Returns what a call raises; None for nothing.
    """

    def overriding(name):
        def hear(self, *arguments):
            heard[name].append(arguments)
            error = fails(name)
            if error is not None:
                raise error

        return hear

    return type("Own", (mdm.Extension,), {name: overriding(name) for name in heard})()


def test_one_that_observes_hears_everything(alone):
    heard = {name: [] for name in HOOKS}
    told, observers = lived(extensions=[observing(heard)])
    assert (told, observers) == (alone, [])
    assert not [name for name in HOOKS if not heard[name]]
    assert [each for (each,) in heard["on_decision"]] == alone["decisions"]
    assert [each for (each,) in heard["on_mode"]] == alone["modes"]
    assert [each for (each,) in heard["on_change"]] == alone["lives"]
    assert [each for (each,) in heard["on_fault"]] == alone["faults"]
    assert [each for (each,) in heard["on_life"]] == alone["robot"]
    assert [(ensemble, life) for ensemble, life, *_ in heard["on_call"]] == [("lamp", life) for life in range(1, 9)]
    assert len(heard["on_step"]) == len(alone["decisions"])
    assert len(heard["on_end"]) == 1


def test_one_that_hears_no_messages_hears_them_as_stimuli(tmp_path):
    heard = {"on_stimulus": []}
    path = tmp_path / "run.mcap"
    lived(extensions=[observing(heard)], record=path)
    recorded = [each.message for each in Record(path).messages(["stimuli"])]
    told = [each for (each,) in heard["on_stimulus"]]
    assert [type(each) for each in told] == [type(each) for each in recorded]
    assert {type(each).__name__ for each in told} >= {"Said", "Began", "Ticked", "Lasts", "Ended", "Raised", "Finished"}
    assert [each for each in told if not isinstance(each, Said)] == [
        each for each in recorded if not isinstance(each, Said)
    ]
    assert {each.where for each in told if isinstance(each, Said)} >= {"outside", "task"}


def test_one_that_is_cancelled_hears_nothing_more_and_nothing_is_made_for_it():
    async def main(runtime):
        heard = {"on_stimulus": [], "on_fault": []}
        hearing = runtime.observe(observer := observing(heard))
        assert runtime.observe(observer) is hearing
        runtime.root.report("one", "")
        assert runtime.observers.heard
        assert runtime.dispatcher.observed
        hearing.cancel()
        assert not runtime.observers.heard
        assert not runtime.dispatcher.observed
        runtime.root.report("two", "")
        assert [fault.kind for (fault,) in heard["on_fault"]] == ["one"]
        assert runtime.observers.hears_steps is runtime.observers.hears_lives is runtime.observers.hears_calls is False

    run_virtual(main)


def test_one_that_begins_while_robots_run_hears_them(alone):
    heard = {"on_step": [], "on_call": [], "on_life": []}

    class Late:
        def __init__(self, runtime):
            self.runtime, self.frames = runtime, 0

        def frame(self):
            self.frames += 1
            if self.frames == 3:
                self.hearing = self.runtime.observe(observing(heard))

        def close(self):
            self.hearing.cancel()

    told, observers = lived(look=Late)
    assert (told, observers) == (alone, [])
    assert 0 < len(heard["on_step"]) < len(alone["decisions"])
    assert heard["on_call"]
    assert heard["on_life"]


@given(
    raising=st.lists(
        st.dictionaries(st.sampled_from(HOOKS), st.sampled_from(ERRORS) | st.none(), min_size=1), min_size=1, max_size=3
    ),
    now_and_then=st.booleans(),
)
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_observers_that_raise_at_every_call_change_nothing(raising, now_and_then, alone):
    given_ = []
    for hooks in raising:
        calls = Counter()

        def fails(name, hooks=hooks, calls=calls):
            calls[name] += 1
            error = hooks[name]
            return (
                None if error is None or (now_and_then and calls[name] % 2) else error("as it was meant to be \udce9")
            )

        given_.append(observing({name: [] for name in hooks}, fails))
    told, observers = lived(extensions=given_)
    assert told == alone
    failing = sum(any(hooks.values()) for hooks in raising)
    assert len(observers) <= failing if now_and_then else len(observers) == failing  # each once
    assert all("Own has failed: " in detail for detail in observers)


def test_what_an_observer_loses_is_counted():
    async def main(runtime):
        hearing = runtime.observe(observing({"on_fault": []}, lambda _: ValueError()))
        for number in range(5):
            runtime.root.report("own", str(number))
        await asyncio.sleep(0)
        return hearing.lost, str(hearing.error)

    lost, _ = run_virtual(main)
    assert lost == 6  # the fault about it, too


def test_who_is_gone_is_not_looked_at():
    class Looking:
        def look(self):
            looked.append(self)

    async def main(runtime):
        looking = Looking()
        runtime.observers.watch(looking.look)
        runtime.observers.watch(looking.look)
        runtime.observe(observing({"on_life": []}))
        assert looked == [looking] * 3
        looked.clear()
        before = len(runtime.observers._looks)
        del looking
        gc.collect()
        assert len(runtime.observers._looks) == before - 1

    looked = []
    run_virtual(main)
