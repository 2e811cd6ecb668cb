"""The last word at an end: a safe action runs, or runs once more, when all that is below has ended."""

from __future__ import annotations

import asyncio

import pytest
from safe_robots import Log, robot, two_levels

from mdm import Ensemble, Runtime, bind, run
from mdm.testing import run_virtual


def test_a_safe_action_that_runs_already_is_not_the_last_word_over_what_is_below():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Rest", "Below", safe_action=log.slow("TOP", 2.0), cleanup=3.0)
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(2)  # top is safe, and its safe action runs for another second

    run_virtual(main)
    assert log == ["Rest", "Work begins", "TOP begins", "TOP ends", "Work ends", "TOP begins", "TOP ends"]


def test_a_safe_action_that_fails_at_the_end_is_tried_once_more_when_what_is_below_has_ended():
    log = Log()

    async def make_safe():
        log.append("TOP begins")
        await asyncio.sleep(2)
        log.append("TOP ends")
        if log.count("TOP ends") == 1:
            raise LookupError

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Below", "Rest"), safe_action=make_safe, safe_below=log.slow("BELOW", 3.0)
        )
        await runtime.start(top)
        below.publish_state(0)
        sensor.set(False)
        await asyncio.sleep(2)  # the sensor's value is too old since a second: top is safe, and below has stopped

    run_virtual(main)
    assert log == [
        *("Work begins", "Work ends", "TOP begins", "TOP ends"),
        *("BELOW begins", "BELOW ends", "TOP begins", "TOP ends"),
    ]


def test_a_safe_action_below_that_fails_is_tried_once_more_before_the_one_above_begins():
    log = Log()

    async def make_safe():
        log.append("BELOW begins")
        if log.count("BELOW begins") == 1:
            raise LookupError
        await asyncio.sleep(3)
        log.append("BELOW ends")

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Below", "Rest"), safe_action=log.slow("TOP", 1.0), safe_below=make_safe, cleanup=2.0
        )
        await runtime.start(top)
        below.publish_state(0)
        sensor.set(False)
        await asyncio.sleep(2)  # top is safe since a second, and waits for what is below

    run_virtual(main)
    assert log == [
        *("Work begins", "Work ends", "BELOW begins", "BELOW begins", "BELOW ends", "TOP begins", "TOP ends")
    ]


def left_below(log, *, safe_low, safe_top):
    """A top that goes safe after a second, one below it whose work takes time to end, and one that this has left."""

    async def work():
        log.append("Work begins")
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(2)
            log.append("Work ends")

    low = Ensemble("low", policy=[0], actions={"Rest": log.plain("Rest")}, safe_action=safe_low)
    actions = {"Low": low, "Work": bind(work, grace=5.0)}
    middle = robot(log, "middle", actions=actions, safe_action=log.plain("MIDDLE"))
    top, _, sensor = two_levels(log, "Below", "Rest", safe_action=safe_top, below=middle)

    async def live(runtime):
        await runtime.start(top)
        low.publish_state(0)
        middle.publish_state(0)
        sensor.set(False)
        middle.publish_state(1)
        await asyncio.sleep(2)  # top is safe since a second, and waits for what is below

    return live


def test_a_safe_action_that_began_beside_those_below_runs_once_more_when_they_have_ended():
    log = Log()
    run_virtual(left_below(log, safe_low=log.slow("LOW", 3.0), safe_top=log.slow("TOP", 5.0)))
    assert log == [
        *("Rest", "Work begins", "Work ends", "TOP begins", "LOW begins", "LOW ends", "MIDDLE", "TOP ends"),
        *("TOP begins", "TOP ends"),
    ]


def test_a_safe_action_that_has_failed_twice_beside_those_below_runs_once_more_when_they_have_ended():
    log, calls = Log(), []

    async def make_safe():
        log.append("TOP begins")
        if log.count("TOP begins") == 1:
            raise LookupError
        await asyncio.sleep(2)
        log.append("TOP ends")
        if log.count("TOP ends") == 1:
            raise LookupError

    async def main():
        async with Runtime(log=None, emergency=lambda: calls.append("emergency")) as runtime:
            top, below, sensor = two_levels(log, "Rest", "Below", safe_action=make_safe, cleanup=1.5)
            await runtime.start(top)
            below.publish_state(0)
            below.start()  # by hand
            sensor.set(True)
            await asyncio.sleep(2)  # top is safe since a second, and tries once more

    run(main, virtual=True)
    assert log == [
        *("Rest", "Work begins", "TOP begins", "TOP begins", "Work ends", "TOP ends"),
        *("TOP begins", "TOP ends"),
    ]
    assert calls == ["emergency"]


def test_a_safe_action_that_began_beside_an_action_below_runs_once_more_when_that_has_ended():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Rest", "Below", safe_action=log.slow("TOP", 5.0), cleanup=3.0)
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(2)  # top is safe since a second, and its safe action runs

    run_virtual(main)
    assert log == ["Rest", "Work begins", "TOP begins", "Work ends", "TOP ends", "TOP begins", "TOP ends"]


def test_a_safe_action_that_began_after_one_below_but_before_its_end_runs_once_more():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Rest", "Below"), safe_action=log.slow("TOP", 5.0), safe_below=log.slow("BELOW", 3.0)
        )
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(0.5)
        below.safety.endanger("mine", "words", runtime.clock.now())
        await asyncio.sleep(1.5)  # top is safe since a second

    run_virtual(main)
    assert log == [
        *("Rest", "Work begins", "Work ends", "BELOW begins", "TOP begins", "BELOW ends", "TOP ends"),
        *("TOP begins", "TOP ends"),
    ]


@pytest.mark.parametrize("when", [1.5, 5.0])
def test_what_was_told_to_stop_while_it_is_safe_has_the_last_word_over_what_is_made_safe_below(when):
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Rest", "Below"), safe_action=log.slow("TOP", 2.0), safe_below=log.slow("BELOW", 3.0)
        )
        await runtime.start(top)
        below.publish_state(0)
        sensor.set(True)
        await asyncio.sleep(1.5)  # top is safe since half a second
        top.stop()
        await asyncio.sleep(when - 1.5)
        if when > 1.5:
            assert top.mode == "stopped"
            below.start()  # by hand
            await asyncio.sleep(1)

    run_virtual(main)
    work = ["Work begins", "Work ends", "BELOW begins", "BELOW ends", "TOP begins", "TOP ends"] if when > 1.5 else []
    assert log == ["Rest", "TOP begins", "TOP ends", *work]


def test_what_is_told_to_stop_and_is_safe_when_the_end_comes_has_the_last_word():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Rest", "Below"), safe_action=log.slow("TOP", 3.0), safe_below=log.slow("BELOW", 3.0)
        )
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(1.5)  # top is safe since half a second
        top.stop()

    run_virtual(main)
    assert log == [
        *("Rest", "Work begins", "TOP begins", "Work ends", "TOP ends", "BELOW begins", "BELOW ends"),
        *("TOP begins", "TOP ends"),
    ]


@pytest.mark.parametrize("before", [False, True])
def test_what_has_not_acted_since_its_start_runs_no_safe_action_though_something_below_does(before):
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(
            *(log, "Rest", "Below"), safe_action=log.plain("TOP"), safe_below=log.plain("BELOW")
        )
        if before:
            await runtime.start(top)
            sensor.set(True)
            await runtime.stop(top)
            assert log == ["Rest", "TOP"]
            log.clear()
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        await asyncio.sleep(1)
        below.stop()
        top.stop()

    run_virtual(main)
    assert log == ["Work begins", "Work ends", "BELOW"]


def test_an_end_waits_for_both_tries_of_a_safe_action_that_has_run_beside_those_below():
    log, calls = Log(), []

    async def make_safe():
        log.append("TOP begins")
        await asyncio.sleep(59.0 if log.count("TOP begins") == 1 else 1e6)

    async def main():
        async with Runtime(log=None, emergency=lambda: calls.append("emergency")) as runtime:
            top, below, sensor = two_levels(log, "Rest", "Below", safe_action=make_safe, safe_timeout=60.0, cleanup=3.0)
            await runtime.start(top)
            below.publish_state(0)
            below.start()  # by hand
            sensor.set(True)
            await asyncio.sleep(2)  # top is safe since a second, and its safe action runs

    run(main, virtual=True)
    assert log == ["Rest", "Work begins", "TOP begins", "Work ends", "TOP begins", "TOP begins"]
    assert calls == ["emergency"]
