"""An ensemble that decides again and again, and nothing comes of it, says so: once a spell, and what loops."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import robot
from patience import PATIENCE

from mdm import Ensemble, FixedRate, PredicateManager, Runtime, StateFactor, bind, run
from mdm.messages import State
from mdm.testing import capture_decisions, probe, run_virtual

AT_ONCE = (
    "action 'Charge' has succeeded at once 30 times in a row, and was decided again each time: its success changes "
    "nothing of what it is decided on"
)


def told(faults):
    return [(fault.time / 1e9, fault.detail) for fault in faults if fault.kind == "livelock"]


def plain():
    """Find the battery full, by another threshold than that of the state."""


def lasting(seconds):
    async def charge():
        await asyncio.sleep(seconds)

    return charge


@pytest.mark.parametrize(
    ("action", "pause", "when"),
    [
        (plain, 1.0, 30.0),
        (plain, 0.2, 6.0),
        (lasting(0.05), 1.0, 31.55),
        (lasting(0.2), 1.0, None),
    ],
)
def test_an_action_that_succeeds_at_once_again_and_again_is_told_once(action, pause, when):
    async def main(runtime):
        ensemble = robot({"Charge": bind(action, then="decide", pause=pause)})
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(600)
        assert ensemble.liveness.repeats >= 490
        assert told(faults) == ([] if when is None else [(pytest.approx(when), AT_ONCE)])

    run_virtual(main)


@pytest.mark.parametrize("horizon", [None, 1, 3])
def test_what_is_counted_as_decided_again_is_a_decision_of_that_cause(horizon):
    async def main(runtime):
        ensemble = robot({"Charge": bind(plain, then="decide", pause=0.1)}, horizon=horizon)
        with capture_decisions(runtime) as decisions:
            await runtime.start(ensemble)
            for seconds in (1.05, 0.05, 0.35):
                ensemble.publish_state(0)
                await asyncio.sleep(seconds)
            ensemble.channel("state", State, retain=True).publish(State(runtime.now(), None, (None,)))
            await asyncio.sleep(1.0)  # a pause that it had begun ends, and no state is known
        again = [decision.cause for decision in decisions].count("again")
        assert ensemble.status().repeats == again == {None: 13, 1: 0, 3: 9}[horizon]

    run_virtual(main)


def test_in_real_time_too():
    async def main():
        async with Runtime(log=None) as runtime:
            ensemble = robot({"Charge": bind(plain, then="decide", pause=1e-6)})
            faults = probe(runtime.faults)
            said = asyncio.Event()
            runtime.faults.subscribe(lambda _: said.set())
            await runtime.start(ensemble)
            ensemble.publish_state(0)
            await asyncio.wait_for(said.wait(), PATIENCE)
            return told(faults)

    assert [detail for _, detail in run(main)] == [AT_ONCE]


@pytest.mark.parametrize("change", ["input", "stop"])
def test_what_decides_otherwise_begins_the_count_anew(change):
    async def main(runtime):
        ensemble = robot({"Charge": bind(plain, then="decide"), "Go": bind(plain, then="decide")})
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        for _ in range(4):
            ensemble.start()
            ensemble.publish_state(0)
            await asyncio.sleep(28.5)
            if change == "stop":
                ensemble.stop()
            else:
                ensemble.publish_state(1)
                await asyncio.sleep(0.2)
        assert told(faults) == []
        ensemble.start()
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert len(told(faults)) == 1

    run_virtual(main)


def test_a_poll_at_a_fixed_rate_is_none():
    async def main(runtime):
        ensemble = robot({"Charge": bind(plain, then="decide", pause=0.1)}, drive=FixedRate(20))
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert told(faults) == []

    run_virtual(main)


# -- What flaps -----------------------------------------------------------------------------------------------------


class Flapping:
    """A robot that backs off while something is near, and the sensor that says so."""

    values = True, False

    def __init__(self, action=lambda: None, way_out="", **options):
        manager = PredicateManager()
        if way_out == "held":
            self.sensor = manager.sensor("Seen", initial=False)
            manager.define("Near", "Seen", held_for=0.5)
        elif way_out == "hysteresis":
            self.sensor = manager.sensor("Near", when="< 0.2 until > 0.3")
            self.values = 0.21, 0.29
        else:
            self.sensor = manager.sensor("Near", initial=False)
        manager.define("Far", "not Near")
        self.ensemble = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"Go": action, "Back": action},
            predicates=manager,
            states=[StateFactor("way", ["Far", "Near"])],
            **options,
        )

    async def flap(self, rate, seconds):
        for number in range(round(rate * seconds)):
            self.sensor.set(self.values[number % 2])
            await asyncio.sleep(1 / rate)


@pytest.mark.parametrize("action", [lambda: None, lasting(0.0), lasting(3600.0)])
@pytest.mark.parametrize(("rate", "by"), [(20, 3.0), (1000, 2.0), (8, None)])
def test_a_predicate_that_flaps_is_told_once_with_its_rate(action, rate, by):
    async def main(runtime):
        robot = Flapping(action)
        faults = probe(runtime.faults)
        await runtime.start(robot.ensemble)
        await robot.flap(rate, 3.0)
        if by is None:
            await robot.flap(rate, 60.0)
            assert told(faults) == []
            return
        [(when, detail)] = told(faults)
        assert 1.5 < when <= by
        assert detail.startswith("predicate 'Near' flaps: ")
        assert float(detail.split()[3]) == pytest.approx(rate, rel=0.05)
        await robot.flap(rate, 3.0)
        assert len(told(faults)) == 1
        assert robot.ensemble.predicates.updates.statistics().subscribers == 1  # nobody else hears it then

    run_virtual(main)


def test_actions_whose_ends_lead_to_each_other_are_told_too():
    async def main(runtime):
        manager = PredicateManager()
        manager.latch("There", set="Go.succeeded", reset="Back.succeeded")
        manager.define("Here", "not There")
        ensemble = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"Go": lasting(0.01), "Back": lasting(0.01)},
            predicates=manager,
            states=[StateFactor("at", ["Here", "There"])],
        )
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        await asyncio.sleep(10)
        [(_, detail)] = told(faults)
        assert detail == "predicates Here, There flap: 100 decisions a second"

    run_virtual(main)


def test_each_spell_is_told_however_often_somebody_asks_for_statistics():
    async def main(runtime):
        robot = Flapping()
        faults = probe(runtime.faults)
        await runtime.start(robot.ensemble)
        for _ in range(2):
            for _ in range(30):
                await robot.flap(20, 0.1)
                assert robot.ensemble.control.statistics().latency
            await asyncio.sleep(60)
        assert len(told(faults)) == 2

    run_virtual(main)


@pytest.mark.parametrize("way", ["held", "hysteresis", "fixed rate", "other input", "stopped meanwhile"])
def test_the_ways_out_lead_out_and_what_does_not_flap_is_none(way):
    async def main(runtime):
        robot = Flapping(way_out=way, **({"drive": FixedRate(20)} if way == "fixed rate" else {}))
        faults = probe(runtime.faults)
        await runtime.start(robot.ensemble)
        if way == "other input":  # states come quickly by themselves, and the predicate changes now and then
            for number in range(600):
                robot.ensemble.publish_state(number % 2)
                if not number % 20:
                    robot.sensor.set(not number % 40)
                await asyncio.sleep(0.05)
        elif way == "stopped meanwhile":
            for _ in range(10):
                robot.ensemble.start()
                await robot.flap(20, 1.4)
                robot.ensemble.stop()
        else:
            await robot.flap(20, 6.0)
        assert told(faults) == []

    run_virtual(main)
