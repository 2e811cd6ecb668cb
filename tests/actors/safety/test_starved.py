"""Ensembles beside a turn without end: other input is taken in, and all go safe when that turn goes on for too long."""

from __future__ import annotations

import asyncio
import threading

import pytest
from circles import Lamp
from replay.held import START, HeldClock

import mdm
from mdm.runtime import Subscription
from mdm.testing import probe

_MS = 1_000_000


def run(happen, *, system=None, **options):
    """Run a lamp beside a robot, where each switch takes a millisecond; return what a coroutine function returns."""
    clock = HeldClock()
    lamp = Lamp(**(system or {}))

    def acts():
        clock.shown += _MS

    lamp.acts = acts

    async def main():
        async with mdm.Runtime(clock=clock, log=False, watchdog=None, **options) as runtime:
            for top in lamp.tops:
                await runtime.start(top)
            lamp.faults = probe(runtime.faults)
            lamp.shown = lambda: (clock.shown - START) / 1e9
            lamp.power.set(True)
            return await happen(lamp, runtime)

    return asyncio.run(main())


def tell(sensor, value):
    """Set a sensor from another thread."""
    thread = threading.Thread(target=sensor.set, args=(value,))
    thread.start()
    thread.join()


async def passes(lamp, until):
    """Let the event loop turn until so many seconds have passed."""
    while lamp.shown() < until:
        await asyncio.sleep(0)


def test_input_is_taken_in_while_a_turn_goes_on_without_end():
    async def happen(lamp, runtime):
        assert lamp.motors == ["drive"]
        tell(lamp.obstacle, True)
        before = lamp.shown()
        while lamp.motors == ["drive"]:
            await asyncio.sleep(0)
        assert runtime.dispatcher.active, "the turn has ended"
        assert lamp.shown() - before < 0.5
        tell(lamp.obstacle, False)
        await passes(lamp, 0.9)
        return list(lamp.motors)

    assert run(happen) == ["drive", "halt", "drive"]


@pytest.mark.parametrize("limit", [None, 3.0])
def test_all_go_safe_when_a_turn_goes_on_for_too_long_and_decide_again_at_its_end(limit):
    async def happen(lamp, runtime):
        seconds = limit or 1.0
        await passes(lamp, seconds - 0.3)
        tell(lamp.obstacle, False)
        first = lamp.shown()
        await passes(lamp, first + seconds - 0.2)
        assert (lamp.robot.mode, lamp.lamp.mode, lamp.motors) == ("deciding", "deciding", ["drive"])
        await passes(lamp, first + seconds + 0.5)
        assert [cause.kind for cause in lamp.robot.causes] == ["starved"]
        assert lamp.motors == ["drive", "off"]
        (fault,) = lamp.faults
        assert (fault.source, fault.kind, lamp.robot.causes[0].detail) == ("runtime", "starved", fault.detail)
        for words in ("'lamp/action' publishes on 'robot/predicates/sensed'", "'lamp/state'", f"for {seconds:g} s"):
            assert words in fault.detail
        tell(lamp.obstacle, True)
        await passes(lamp, first + seconds + 1.0)
        assert lamp.motors == ["drive", "off"]
        tell(lamp.power, False)
        while runtime.dispatcher.active:
            await asyncio.sleep(0)
        assert (lamp.robot.mode, lamp.motors, runtime.starved) == ("deciding", ["drive", "off", "halt"], "")

    run(happen, **({} if limit is None else {"starved_after": limit}))


def test_a_turn_without_end_is_no_cause_where_no_other_input_comes():
    async def happen(lamp, runtime):
        await passes(lamp, 5.0)
        assert runtime.dispatcher.active
        return lamp.robot.mode, [fault.kind for fault in lamp.faults]

    assert run(happen) == ("deciding", [])


def test_a_callback_that_holds_the_loop_starves_nobody_by_this_rule():
    async def happen(lamp, runtime):
        lamp.power.set(False)
        while runtime.dispatcher.active:
            await asyncio.sleep(0)
        before = lamp.shown()

        def hold():
            for _ in range(5_000):
                lamp.acts()
            tell(lamp.obstacle, True)

        runtime.dispatcher.deliver(Subscription(None, None, lambda _: hold()), None)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        return lamp.shown() - before, lamp.robot.mode, list(lamp.motors), lamp.faults

    assert run(happen) == (5.0, "deciding", ["drive", "halt"], [])


def test_an_ensemble_stops_in_the_midst_of_its_own_turn_without_end():
    async def happen(lamp, runtime):
        await passes(lamp, 0.3)
        lamp.lamp.stop()
        while runtime.dispatcher.active:
            await asyncio.sleep(0)
        switches = lamp.switches
        await asyncio.sleep(0)
        assert (lamp.lamp.mode, lamp.switches) == ("stopped", switches)
        lamp.lamp.start()
        assert lamp.lamp.mode == "deciding"
        assert lamp.switches > switches

    run(happen)


def test_what_is_started_while_a_turn_goes_on_for_too_long_is_safe_at_once():
    async def happen(lamp, runtime):
        lamp.robot.stop()
        await passes(lamp, 0.3)
        tell(lamp.obstacle, True)
        await passes(lamp, 2.0)
        assert (lamp.robot.mode, bool(runtime.starved)) == ("stopped", True)
        lamp.robot.start()
        await passes(lamp, 2.5)
        return lamp.robot.mode, [cause.kind for cause in lamp.robot.causes], list(lamp.motors)

    assert run(happen) == ("safe", ["starved"], ["drive", "off"])


def test_a_safe_action_that_fails_within_a_turn_without_end_is_tried_once_more():
    tries = []

    async def happen(lamp, runtime):
        def fail():
            tries.append(lamp.shown())
            raise OSError("the motor does not answer")

        robot = mdm.Ensemble(
            "other",
            policy=[0, 1],
            predicates=lamp.predicates,
            states=[mdm.StateFactor("obstacle", ["Obstacle"])],
            actions={"drive": lambda: None, "halt": lambda: None},
            safe_action=fail,
        )
        await runtime.start(robot)
        tell(lamp.obstacle, False)
        await passes(lamp, lamp.shown() + 2.0)
        assert runtime.dispatcher.active
        assert len(tries) == 2
        assert [cause.kind for cause in robot.causes] == ["starved", "safe_action"]
        return [fault.kind for fault in lamp.faults]

    assert run(happen, emergency=lambda: None).count("emergency") == 1


def test_the_age_of_a_sensor_is_noticed_beside_an_actor_that_publishes_to_itself():
    class Ping(mdm.Actor):
        def on_start(self):
            self.own = self.channel("own", int)
            self.subscribe(self.own, self.pass_on)

        def pass_on(self, number):
            self.clock.shown += _MS
            self.own.publish(number + 1)

    async def happen(lamp, runtime):
        lamp.power.set(False)
        ping = Ping("ping")
        ping.clock = runtime.clock
        await runtime.start(ping)
        asyncio.get_running_loop().call_soon(ping.own.publish, 0)
        await passes(lamp, 1.6)
        assert runtime.dispatcher.active
        assert [cause.kind for cause in lamp.robot.causes] == ["stale_input"]
        assert lamp.motors == ["drive", "off"]
        assert [fault.kind for fault in lamp.faults] == ["stale", "stale_input"]
        await passes(lamp, 3.0)
        assert "'ping' publishes on 'ping/own'" in runtime.starved

    run(happen, system={"max_age": 1.0})
