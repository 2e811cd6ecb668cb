"""Predicates that are told numbers: thresholds with hysteresis, in whatever way they are told, and their records."""

from __future__ import annotations

import asyncio
import io
import math
import threading

import numpy as np
import pytest
from sentences import refused

import mdm
from mdm import PredicateManager
from mdm.cli import main as command
from mdm.errors import ConfigError, Error, FormatError
from mdm.messages import SensorUpdate
from mdm.replay import replay
from mdm.testing import crash, probe, run_virtual

LOW = "< 0.2 until > 0.3"
READINGS = [
    (0.25, None),  # where it has come from is not known
    (0.31, False),
    (0.3, False),
    (0.2, False),
    (0.19, True),
    (0.25, True),
    (math.nan, None),
    (0.25, True),  # what it has come from is
    (None, None),
    (0.3, True),
    (np.float32(0.5), False),
    (1, False),
    (False, False),
    (True, True),
    (0.25, True),
]


@pytest.mark.parametrize("tell", ["set", "sense", "batch", "thread"])
def test_a_predicate_is_true_from_one_bound_to_the_other(tell):
    async def main(runtime):
        manager = PredicateManager()
        battery = manager.sensor("BatteryIsLow", when=LOW)
        await runtime.start(manager)
        found = []
        for number, _ in READINGS:
            if tell == "thread":
                thread = threading.Thread(target=battery.set, args=(number,))
                thread.start()
                thread.join()
                await asyncio.sleep(0)
            elif tell == "batch":
                with manager.batch():
                    battery.set(number)
            elif tell == "set":
                battery.set(number)
            else:
                manager.sense("BatteryIsLow", number)
            found.append(battery.value)
        return found

    assert run_virtual(main) == [expected for _, expected in READINGS]


def test_numbers_that_were_replaced_while_they_waited_count_for_those_in_between():
    async def main(runtime):
        manager = PredicateManager()
        battery = manager.sensor("BatteryIsLow", when=LOW)
        await runtime.start(manager)
        updates = probe(manager.sensed)
        thread = threading.Thread(target=lambda: [battery.set(number) for number in (0.5, 0.1, 0.25)])
        thread.start()
        thread.join()
        await asyncio.sleep(0)
        return battery.value, len(updates)

    assert run_virtual(main) == (True, 1)


@pytest.mark.parametrize("initial", [None, True, False])
def test_a_number_in_between_is_at_the_start_as_declared(initial):
    manager = PredicateManager()
    battery = manager.sensor("BatteryIsLow", when=LOW, initial=initial)

    async def main(runtime):
        await runtime.start(manager)
        first = battery.value
        battery.set(0.25)
        found = first, battery.value
        battery.set(0.1 if initial is False else 0.9)
        return found

    assert [run_virtual(main) for _ in range(2)] == [(initial, initial)] * 2  # of the first run nothing is known


def test_what_was_told_before_the_start_is_known_at_it():
    manager = PredicateManager()
    battery = manager.sensor("BatteryIsLow", when=LOW)
    battery.set(0.1)

    async def main(runtime):
        await runtime.start(manager)
        first = battery.value
        battery.set(0.25)
        return first, battery.value

    assert run_virtual(main) == (True, True)


def test_ages_and_holds_are_those_of_any_predicate():
    async def main(runtime):
        manager = PredicateManager(supervision=mdm.Restart(1))
        battery = manager.sensor("BatteryIsLow", when=LOW, max_age=1.0)
        manager.define("Charge", "BatteryIsLow", held_for=3.0)
        await runtime.start(manager)
        faults = probe(runtime.faults)
        found = []
        for number in (0.1, 0.25, 0.25, 0.25, None, 0.25):  # each is as fresh as any
            battery.set(number)
            await asyncio.sleep(0.9)
            found.append((battery.value, manager.value("Charge")))
        await asyncio.sleep(0.2)
        stale = battery.value
        battery.set(0.25)
        back = battery.value
        crash(manager)
        await asyncio.sleep(2)
        restarted = battery.value
        battery.set(0.25)
        return found, stale, back, restarted, battery.value, [fault.kind for fault in faults]

    found, stale, back, restarted, last, faults = run_virtual(main)
    assert found == [(True, False)] * 3 + [(True, True), (None, None), (True, False)]
    assert (stale, back, restarted, last) == (None, True, None, True)
    assert faults[0] == "stale"


@pytest.mark.parametrize("value", ["0.1", [0.1], np.array(0.1), 1j])
def test_what_is_no_number_is_refused(value):
    manager = PredicateManager()
    battery = manager.sensor("BatteryIsLow", when=LOW)
    with refused(Error):
        battery.set(value)
    with refused(Error):
        manager.sense("BatteryIsLow", value)


def test_a_predicate_without_a_threshold_takes_no_number():
    manager = PredicateManager()
    with refused(Error):
        manager.sensor("BatteryIsLow").set(0.1)


def test_a_wrong_threshold_is_refused_where_it_is_declared():
    manager = PredicateManager()
    with refused(FormatError):
        manager.sensor("BatteryIsLow", when="< 0.3 until > 0.2")
    with refused(Error):
        manager.sensor("BatteryIsLow", ("x", SensorUpdate), when="< 0.2")


def test_it_is_told_in_words():
    manager = PredicateManager()
    manager.sensor("BatteryIsLow", when=LOW, max_age=5.0)
    manager.sensor("IsFar", when=">2")
    assert manager.declared.definition("BatteryIsLow") == (
        "set by code to a number: < 0.2 until > 0.3, unknown after 5 s"
    )
    assert manager.declared.definition("IsFar") == "set by code to a number: > 2"


FILE = """
[predicates]
BatteryIsLow = {{ {table} }}

[ensembles.robot]
policy = [0, 1]
[ensembles.robot.states]
battery = ["BatteryIsLow"]
[ensembles.robot.actions]
Go = "builtins:list"
Charge = "builtins:list"
"""


def test_a_file_says_it_and_its_run_is_replayed(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(FILE.format(table='when = "< 0.2 until > 0.3", max_age = 5.0'))
    found = []

    async def main():
        async with mdm.Runtime(log=False, record=tmp_path / "run.mcap") as runtime:
            system = mdm.load_system(path)
            runtime.decisions.subscribe(lambda decision: found.append(decision.action_name))
            await runtime.start(system)
            for number in (0.25, 0.5, 0.25, 0.1, 0.25, 0.31, 0.29):
                system.predicates.sense("BatteryIsLow", number)

    mdm.run(main, virtual=True)
    assert found == ["Go", "Charge", "Go"]
    result = replay(tmp_path / "run.mcap", [mdm.load_system(path)])
    assert result.replayed == 3
    assert not result.differences


@pytest.mark.parametrize(
    "table",
    [
        'when = "< 0.3 until > 0.2"',
        'when = "percentage < 0.2"',
        "when = 0.2",
        'when = "< 0.2", held_for = 1.0',
        'when = "< 0.2", formula = "X"',
        'when = "< 0.2", set = "X", reset = "Y"',
        'when = "< 0.2", sensor = false',
    ],
)
def test_a_wrong_threshold_in_a_file_is_told_with_its_key(tmp_path, table):
    path = tmp_path / "robot.toml"
    path.write_text(FILE.format(table=table))
    with refused(ConfigError):
        mdm.load_system(path)


def test_a_trace_takes_numbers(tmp_path, monkeypatch, capsys):
    path = tmp_path / "robot.toml"
    path.write_text(FILE.format(table=f'when = "{LOW}"'))
    numbers = enumerate((0.5, 0, 1))
    lines = [f'{{"time": {time}, "predicates": {{"BatteryIsLow": {number}}}}}' for time, number in numbers]
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO("\n".join(lines).encode())))
    assert command(["trace", str(path)]) == 0
    assert [line.count('"Charge"') for line in capsys.readouterr().out.splitlines()] == [0, 1, 0]
