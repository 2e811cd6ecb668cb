from __future__ import annotations

import asyncio
import threading

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import ConfigError, Error, ObservationFactor, ObservationLayer, P, PredicateManager, Restart, Runtime, run
from mdm.messages import EventUpdate, Observation, PredicateUpdate, SensorUpdate, State, Tick
from mdm.testing import crash, probe, run_virtual


def updates_of(runtime, name="predicates"):
    return probe(runtime.channel(f"{name}/updates", PredicateUpdate))


def test_sensors_formulas_latches_and_events():
    async def main(runtime):
        manager = PredicateManager()
        south, north = manager.sensor("South", initial=False), manager.sensor("North")
        moving = manager.event("Bump")
        manager.define("Between", ~P("South") & ~P("North"))
        manager.latch("HalfWay", set="South", reset="North or Bump")
        manager.event("Arrived", "North")
        await runtime.start(manager)
        updates, events = updates_of(runtime), probe(runtime.channel("predicates/events", EventUpdate))
        assert manager.values() == {"South": False, "North": None, "Between": None, "HalfWay": False}
        north.set(False)
        assert manager.value("Between") is True
        south.set(np.bool_(True))
        assert manager.value("HalfWay") is True
        south.set(True)  # nothing new: nothing published
        moving.fire()
        assert manager.value("HalfWay") is False
        north.set(True)
        north.set(True)
        assert [(u.rising, u.falling) for u in updates] == [
            (("Between",), ("North",)),
            (("South", "HalfWay"), ("Between",)),
            ((), ("HalfWay",)),
            (("North",), ()),
        ]
        assert [update.counter for update in updates] == [2, 3, 4, 5]
        assert [update.events for update in events] == [("Bump",), ("Arrived",)]
        with refused(Error):
            south.set(1)

    run_virtual(main)


def test_before_the_start_every_predicate_is_unknown():
    manager = PredicateManager()
    south = manager.sensor("South", initial=False)
    manager.define("NotSouth", "not South")
    manager.event("Arrived", "South")
    assert manager.values() == {"South": None, "NotSouth": None}
    assert (manager.value("NotSouth"), south.value) == (None, None)
    for name in ("Arrived", "Sout"):
        with pytest.raises(Error, match="there is no predicate"):
            manager.value(name)


def test_a_frozen_sensor_becomes_unknown_and_is_reported():
    async def main(runtime):
        manager = PredicateManager()
        sensor = manager.sensor("A", max_age=1.0)
        manager.define("NotA", "not A")
        await runtime.start(manager)
        faults = probe(runtime.faults)
        for _ in range(5):
            sensor.set(True)
            await asyncio.sleep(0.9)
            assert manager.value("A") is True
        await asyncio.sleep(0.2)
        assert manager.values() == {"A": None, "NotA": None}
        assert [(fault.kind, fault.detail) for fault in faults] == [
            ("stale", "predicate 'A' was not refreshed for 1 s")
        ]
        await asyncio.sleep(10)
        sensor.set(False)
        assert manager.value("NotA") is True
        await asyncio.sleep(1.1)
        assert manager.value("A") is None
        assert len(faults) == 2

    run_virtual(main)


def test_a_condition_must_have_held():
    async def main(runtime):
        manager = PredicateManager()
        waiting = manager.sensor("Waiting", initial=False)
        manager.define("WaitedLong", "Waiting", held_for=5)
        manager.event("Impatient", "WaitedLong")
        await runtime.start(manager)
        events = probe(runtime.channel("predicates/events", EventUpdate))
        waiting.set(True)
        await asyncio.sleep(4.9)
        waiting.set(False)
        waiting.set(True)
        await asyncio.sleep(4.9)
        assert manager.value("WaitedLong") is False
        await asyncio.sleep(0.2)
        assert manager.value("WaitedLong") is True
        assert [update.time for update in events] == [9_900_000_000]
        waiting.set(None)
        assert manager.value("WaitedLong") is None

    run_virtual(main)


def test_an_event_that_is_true_at_start_reaches_those_who_start_right_after():
    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("A", initial=True)
        manager.event("Up", "A")
        manager.event("Down", "not A")
        await runtime.start(manager)
        layer = ObservationLayer([ObservationFactor("direction", ["Up", "Down"])], manager)
        seen = probe(runtime.channel("observation/observation", Observation))
        await runtime.start(layer)
        assert [message.index for message in seen] == [0]

    run_virtual(main)


def test_groundings_on_channels_and_what_they_raise():
    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("High", ("height", State), lambda message: None if message.index < 0 else 10 / message.index < 1)
        await runtime.start(manager)
        faults, height = probe(runtime.faults), runtime.channel("height", State)
        values = []
        for index in (20, 5, -1, 30, 0):
            height.publish(State(0, index, ()))
            values.append(manager.value("High"))
        assert values == [True, False, None, True, None]
        assert [fault.kind for fault in faults] == ["sensor"]
        assert "'when' of predicate 'High' raised ZeroDivisionError" in faults[0].detail
        assert manager.life == "running"

    run_virtual(main)


def test_messages_with_unknown_names_are_reported_and_change_nothing():
    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("A", initial=False)
        await runtime.start(manager)
        faults = probe(runtime.faults)
        runtime.channel("predicates/sensed", SensorUpdate).publish(SensorUpdate(0, (("A", True), ("Aa", True))))
        assert manager.value("A") is False
        assert "no predicate or event 'Aa'; did you mean 'A'" in faults[0].detail

    run_virtual(main)


def test_threads_set_sensors():
    async def main():
        async with Runtime(log=None) as runtime:
            manager = PredicateManager()
            sensors = [manager.sensor(f"S{i}", initial=False) for i in range(4)]
            done = manager.event("Done")
            await runtime.start(manager)
            finished = asyncio.Event()
            ends = []

            def end(update):
                ends.append(update)
                if len(ends) == 4:
                    finished.set()

            runtime.channel("predicates/events", EventUpdate).subscribe(end)

            def work(sensor):
                for index in range(501):
                    sensor.set(index % 2 == 0)
                with manager.batch():
                    sensor.set(True)
                    done.fire()

            threads = [threading.Thread(target=work, args=(sensor,)) for sensor in sensors]
            for thread in threads:
                thread.start()
            await finished.wait()
            for thread in threads:
                thread.join()
            assert manager.values() == dict.fromkeys(["S0", "S1", "S2", "S3"], True)

    run(main)


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda m: (m.sensor("A"), m.define("A", "true")), "'A' is declared twice"),
        (lambda m: m.sensor("A", max_age=0), "max_age"),
        (
            lambda m: m.sensor("A", max_age=float("inf")),
            "max_age of 'A' is a number of seconds above 0 and at most 10.9",
        ),
        (lambda m: m.sensor("A", max_age="5"), "max_age"),
        (lambda m: m.define("A", "B", held_for=float("nan")), "held_for"),
        (lambda m: m.define("A", "B", held_for=-1), "held_for"),
        (lambda m: m.sensor("A", when=bool), "a channel and a 'when'"),
    ],
)
def test_wrong_declarations(declare, message):
    with pytest.raises(ConfigError, match=message):
        declare(PredicateManager())


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda m: (m.define("A", "B"), m.define("B", "A")), "cycle"),
        (lambda m: m.define("A", "Nothing"), "'Nothing', which is not declared"),
        (
            lambda m: m.latch("A", set="Go.faild", reset="Go.running"),
            "'Go.faild' is used, but not declared; did you mean",
        ),
    ],
)
def test_what_only_the_whole_shows_is_refused_at_start(declare, message):
    async def main(runtime):
        manager = PredicateManager()
        declare(manager)
        with pytest.raises(Error, match=message):
            await runtime.start(manager)

    run_virtual(main)


def test_declarations_after_the_start_are_too_late():
    async def main(runtime):
        manager = PredicateManager()
        early = manager.sensor("A")
        early.set(True)
        await runtime.start(manager)
        assert manager.value("A") is True
        with refused(Error):
            manager.sensor("B")

    run_virtual(main)


@given(st.data())
def test_what_is_published_is_what_changed(data):
    names = ["A", "B", "C"]

    async def main(runtime):
        manager = PredicateManager()
        for name in names:
            manager.sensor(name)
        manager.define("X", "A and not B")
        manager.define("Y", "X xor C")
        manager.define("Never", "X and B")
        await runtime.start(manager)
        updates = updates_of(runtime)
        known = manager.values()
        for _ in range(data.draw(st.integers(1, 15))):
            changes = data.draw(
                st.lists(st.tuples(st.sampled_from(names), st.sampled_from([True, False, None])), max_size=3)
            )
            before = len(updates)
            with manager.batch():
                for name, value in changes:
                    manager.sense(name, value)
            now = manager.values()
            expected = {name: value for name, value in now.items() if known[name] is not value}
            assert len(updates) - before == bool(expected)
            if expected:
                last = updates[-1]
                told = (
                    dict.fromkeys(last.rising, True) | dict.fromkeys(last.falling, False) | dict.fromkeys(last.unknown)
                )
                assert told == expected
            values = {**now, **{name: now[name] for name in names}}
            for name, formula in (("X", P("A") & ~P("B")), ("Y", P("X") ^ P("C")), ("Never", P("X") & P("B"))):
                assert now[name] is formula.evaluate(values)
            assert now["Never"] is not True
            known = now
        assert [update.counter for update in updates] == list(range(2, len(updates) + 2))

    run_virtual(main)


def undecided():
    manager = PredicateManager()
    manager.sensor("IsOpen")
    manager.define("IsShut", ~P("IsOpen"))
    manager.event("Bump")
    manager.event("Opened", "IsOpen and robot2/IsNear")
    manager.latch("Done", set="Go.succeeded", reset="Bump")
    return manager


@pytest.mark.parametrize("started", [False, True])
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda manager: manager.sense("IsOpn", True), "no predicate 'IsOpn'; did you mean 'IsOpen'"),
        (lambda manager: manager.sense("xyz", True), "no predicate 'xyz'; there are IsOpen, IsShut, Done"),
        (lambda manager: manager.sense("IsShut", True), "predicate 'IsShut' is derived from others"),
        (lambda manager: manager.sense("Bump", True), "no predicate 'Bump': it is an event"),
        (lambda manager: manager.sense("robot2/IsFar", True), "no predicate 'robot2/IsFar'"),
        (lambda manager: manager.occur("Bunp"), "no event 'Bunp'; did you mean 'Bump'"),
        (lambda manager: manager.occur("Bump", "Opened"), "event 'Opened' is derived from others"),
        (lambda manager: manager.occur("IsOpen"), "no event 'IsOpen': it is a predicate"),
        (lambda manager: manager.occur("Go.failed"), "no event 'Go.failed'"),
        (lambda manager: manager.sense("IsOpen", "yes"), "'IsOpen' is True, False or None .unknown., not 'yes'"),
        (lambda manager: manager.sense("IsOpen", 1), "'IsOpen' is True, False or None .unknown., not 1"),
        (lambda manager: manager.sense("IsOpen", [True]), "'IsOpen' is True, False or None"),
        (lambda manager: manager._sensors["IsOpen"].set("yes"), "'IsOpen' is True, False or None"),
    ],
)
def test_wrong_input_is_refused_where_it_is_given(started, call, words):
    manager = undecided()

    async def main(runtime):
        await runtime.start(manager)
        faults = probe(runtime.faults)
        with pytest.raises(Error, match=words), manager.batch():
            call(manager)
        assert manager.value("IsOpen") is None
        assert (manager.life, faults) == ("running", [])

    if started:
        run_virtual(main)
    else:
        with pytest.raises(Error, match=words):
            call(manager)


def test_input_of_every_kind_is_taken_before_and_after_the_start():
    manager = undecided()
    manager.sense("IsOpen", np.True_)
    manager.sense("robot2/IsNear", True)
    manager.occur("Bump", "Go.succeeded")  # which nothing hears yet

    async def main(runtime):
        await runtime.start(manager)
        assert manager.values() == {"IsOpen": True, "IsShut": False, "Done": False, "robot2/IsNear": True}
        manager.sense("IsOpen", np.False_)
        manager.sense("robot2/IsNear", None)
        manager.occur("Go.succeeded")
        assert manager.values() == {"IsOpen": False, "IsShut": True, "Done": True, "robot2/IsNear": None}

    run_virtual(main)


@pytest.mark.parametrize("value", ["yes", [1], 2])
def test_a_message_with_no_truth_value_is_reported_and_changes_nothing(value):
    async def main(runtime):
        manager = PredicateManager()
        manager.sensor("A", initial=False)
        manager.sensor("B", initial=False)
        await runtime.start(manager)
        faults = probe(runtime.faults)
        sensed = runtime.channel("predicates/sensed", SensorUpdate)
        sensed.publish(SensorUpdate(0, (("A", value),)))
        sensed.publish(SensorUpdate(0, (("B", True), ("A", value))))
        assert manager.values() == {"A": False, "B": False}
        assert all("predicate 'A' is True, False or None" in fault.detail for fault in faults)
        assert len(faults) == 2

    run_virtual(main)


def test_a_wrong_initial_value_is_refused():
    with refused(Error):
        PredicateManager().sensor("A", initial="no")


def test_a_value_that_waited_for_longer_than_it_holds_is_unknown():
    async def main(runtime):
        manager = PredicateManager()
        sensor = manager.sensor("A", max_age=0.5)
        lasting = manager.sensor("B")
        await runtime.start(manager)
        updates, faults = probe(manager.updates), probe(runtime.faults)
        thread = threading.Thread(target=lambda: (sensor.set(True), lasting.set(True)))
        thread.start()
        thread.join()
        asyncio.get_running_loop()._virtual.now += 600_000_000  # the loop is held for so long
        await asyncio.sleep(0)
        before = sensor.value, lasting.value
        sensor.set(True)
        return before, sensor.value, [name for update in updates for name in update.rising], faults

    before, after, rising, faults = run_virtual(main)
    assert before == (None, True)
    assert after is True
    assert rising == ["B", "A"]
    assert [(fault.kind, fault.detail) for fault in faults] == [
        ("stale", "values of A waited 0.6 s, longer than they hold")
    ]


def test_while_a_manager_that_failed_is_down_nothing_is_known():
    async def main(runtime):
        manager = PredicateManager(supervision=Restart(backoff=2.0))
        sensor = manager.sensor("S", initial=True)
        manager.define("T", "not S")
        await runtime.start(manager)
        updates = updates_of(runtime)
        crash(manager)
        assert manager.values() == {"S": None, "T": None}
        assert updates[-1].unknown == ("S", "T")
        await asyncio.sleep(1)
        sensor.set(False)
        assert sensor.value is None
        await asyncio.sleep(2)
        assert manager.values() == {"S": False, "T": True}

    run_virtual(main)


def test_truth_values_of_numpy_ground_a_predicate():
    async def main(runtime):
        predicates = PredicateManager()
        distances = runtime.channel("distances", Tick)
        predicates.sensor("Near", distances, lambda tick: np.float64(tick.number) < 3, initial=np.bool_(False))
        await runtime.start(predicates)
        distances.publish(Tick(0, 1, 0, 0))
        return predicates.value("Near")

    assert run_virtual(main) is True


@pytest.mark.parametrize("again", ["while it waits to start anew", "when it has started anew", "never"])
def test_how_long_a_condition_has_held_is_counted_anew_after_a_restart(again):
    async def main(runtime):
        manager = PredicateManager(supervision=Restart(backoff=0.5))
        waiting = manager.sensor("Waiting", initial=False)
        manager.define("WaitedLong", "Waiting", held_for=2.0)
        await runtime.start(manager)
        seen = updates_of(runtime)
        waiting.set(True)
        await asyncio.sleep(1.0)
        crash(manager)
        if again == "while it waits to start anew":
            await asyncio.sleep(0.25)
            waiting.set(True)
        await asyncio.sleep(0.75)
        if again == "when it has started anew":
            waiting.set(True)
        since = {"while it waits to start anew": 1.5, "when it has started anew": 1.75}.get(again)
        await asyncio.sleep(5.0)
        risen = [update.time / 1e9 for update in seen if "WaitedLong" in update.rising]
        assert risen == ([] if since is None else [since + 2.0])

    run_virtual(main)


def test_a_monitor_is_false_once_its_formula_is_for_ever():
    async def main(runtime):
        manager = PredicateManager(supervision=Restart(backoff=0.5))
        stairs, dock = manager.sensor("Stairs", initial=False), manager.sensor("Dock")
        manager.monitor("Careful", "G(not Stairs) and F(Dock)")
        manager.monitor("Docked", "F(Dock)")
        manager.event("Fell", "not Careful")
        assert (manager.verdict("Careful"), manager.value("Careful")) == (None, None)
        await runtime.start(manager)
        events = probe(runtime.channel("predicates/events", EventUpdate))

        def told():
            return [(manager.value(name), manager.verdict(name)) for name in ("Careful", "Docked")]

        assert told() == [(True, None), (True, None)]  # never unknown, as the dock is
        dock.set(True)
        assert told() == [(True, None), (True, True)]
        stairs.set(None)
        assert told() == [(True, None), (True, True)]
        stairs.set(True)
        stairs.set(False)
        assert told() == [(False, False), (True, True)]
        assert [update.events for update in events] == [("Fell",)]
        crash(manager)
        dock.set(False)
        stairs.set(False)
        await asyncio.sleep(1.0)
        assert told() == [(True, None), (True, None)]  # from the first valuation on

    run_virtual(main)


def test_reports_of_a_batch_are_one_valuation():
    async def main(runtime):
        manager = PredicateManager()
        first, second = manager.sensor("A", initial=False), manager.sensor("B", initial=False)
        manager.monitor("Together", "G(A implies B)")
        manager.monitor("Next", "X X A")
        await runtime.start(manager)
        with manager.batch():
            first.set(True)
            second.set(True)
        assert (manager.verdict("Together"), manager.verdict("Next")) == (None, None)
        second.set(True)  # nothing new, and no valuation
        second.set(False)
        assert (manager.verdict("Together"), manager.verdict("Next")) == (False, None)
        first.set(False)
        assert manager.verdict("Next") is False

    run_virtual(main)


@pytest.mark.parametrize(
    "declare",
    [
        lambda m: m.monitor("A", "G(not"),
        lambda m: (m.monitor("A", "G(not B)"), m.network().compile()),
        lambda m: (m.event("B"), m.monitor("A", "G(not B)"), m.network().compile()),
        lambda m: (m.monitor("A", "G(not A)"), m.network().compile()),
        lambda m: (m.monitor("Careful", "G(not B)"), m.verdict("Carefull")),
    ],
)
def test_what_cannot_be_monitored_is_refused(declare):
    with refused(Error):
        declare(PredicateManager())
