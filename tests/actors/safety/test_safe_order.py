"""The order among ensembles: what is below one that goes safe, and random hierarchies."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from safe_robots import Log, robot, two_levels

from mdm import ActorFailure, Ensemble, PredicateManager, Restart, StateFactor, bind
from mdm.policies import DeterministicPolicy
from mdm.testing import crash, probe, run_virtual


def test_what_was_started_by_hand_below_an_ensemble_that_goes_safe_is_stopped():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Rest", "Below", safe_action=log.plain("TOP"))
        await runtime.start(top)
        below.publish_state(0)
        below.start()
        sensor.set(True)
        await asyncio.sleep(2)
        assert below.mode == "stopped"

    run_virtual(main)
    assert log == ["Rest", "Work begins", "TOP", "Work ends", "TOP"]


def test_below_an_ensemble_that_is_safe_nothing_is_started_by_hand():
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Below", "Rest", safe_action=log.slow("TOP", 5.0))
        faults = probe(runtime.faults)
        await runtime.start(top)
        below.publish_state(0)
        sensor.set(True)
        await asyncio.sleep(1.5)
        below.start()
        await asyncio.sleep(1)
        assert log == ["Work begins", "Work ends", "TOP begins"]
        assert below.mode == "stopped"
        assert (faults[-1].source, faults[-1].kind) == ("top/below", "control")
        assert faults[-1].detail == "was not started: ensemble 'top' above it is safe or ends"
        await asyncio.sleep(5)
        sensor.set(False)
        await asyncio.sleep(0.5)
        assert log[3:] == ["TOP ends", "Work begins"]

    run_virtual(main)


@pytest.mark.parametrize("by_action", [False, True])
@pytest.mark.parametrize("command", ["start", "resume"])
def test_one_in_a_safe_mode_of_its_own_is_not_started_below_one_that_is_safe(command, by_action):
    log = Log()

    async def main(runtime):
        below = robot(log, "below", safe_action=log.slow("BELOW", 3.0))
        actions = {"Below": below, "Rest": log.plain("Rest")}
        top = Ensemble("top", policy=[0, 1], actions=actions, safe_action=log.slow("TOP", 20.0))
        faults = probe(runtime.faults)
        await runtime.start(top)
        top.publish_state(0 if by_action else 1)
        below.start()
        below.publish_state(0)
        below.safety.endanger("mine", "", 0)
        await asyncio.sleep(1)
        top.safety.endanger("mine", "", 0)
        await asyncio.sleep(1)
        assert (below.mode, top.mode) == ("safe", "safe")
        below.start(resume=command == "resume")
        fault = faults[-1]
        assert (fault.source, fault.kind) == ("top/below", "control")
        assert "was not started: " in fault.detail
        below.release()
        await asyncio.sleep(5)
        below.publish_state(1)
        await asyncio.sleep(5)
        assert (below.mode, top.mode) == ("stopped", "safe")
        assert not {"A", "B"}.intersection(log[log.index("BELOW begins") :])

    run_virtual(main)


def test_ticks_of_one_that_was_not_started_below_one_that_is_safe_decide_nothing():
    log = Log()

    async def main(runtime):
        below = robot(log, "below", safe_action=log.slow("BELOW", 3.0), drive=10.0)
        top = Ensemble(
            "top", policy=[0, 1], actions={"Below": below, "Rest": log.plain("Rest")}, safe_action=log.slow("TOP", 5.0)
        )
        await runtime.start(top)
        top.publish_state(1)
        below.publish_state(0)
        below.start()
        await asyncio.sleep(1)
        below.safety.endanger("mine", "", 0)
        top.safety.endanger("mine", "", 0)
        log.clear()
        below.start()
        await asyncio.sleep(10)
        assert log == ["BELOW begins", "TOP begins", "BELOW ends", "TOP ends"]
        assert below.control.ticks._ticker is None

    run_virtual(main)


@pytest.mark.parametrize("work", ["plain", "async"])
def test_what_is_below_is_latched_with_what_is_above(work):
    log = Log()

    async def main(runtime):
        target = log.plain("Work") if work == "plain" else log.slow("Work", 1e6)
        below = Ensemble("below", policy=[0, 0], actions={"Work": target})
        top = Ensemble(
            "top",
            policy=DeterministicPolicy([0, 1], 2),
            actions={"Below": below, "Broken": bind(lambda: 1 / 0, concurrent=True)},
            safe_action=log.plain("SAFE"),
        )
        await runtime.start(top)
        top.publish_state(0)

        def both(_):
            top.publish_state(1)
            below.publish_state(0)  # its decision stands behind the one of the parent that fails

        channel = runtime.channel("both", int)
        channel.subscribe(both)
        channel.publish(1)
        await asyncio.sleep(0.1)
        assert log in (["SAFE"], ["Work begins", "Work ends", "SAFE"])
        assert (top.mode, below.mode) == ("safe", "stopped")

    run_virtual(main)


class Robot:
    """A hierarchy of two or three levels whose actions are plain, slow, stubborn or broken, and what they do."""

    def __init__(self, draw):
        self.log = []
        self.live = {}
        self.violations = []
        self.ensembles = []
        self.sensors = []
        self.manager = PredicateManager()
        self.top = self.build("top", draw, draw(st.integers(1, 3)))

    def build(self, name, draw, levels):
        sensor = self.manager.sensor(f"{name}S", max_age=draw(st.sampled_from([None, 1.0, 3.0])))
        self.sensors.append(sensor)
        actions = {
            "A": self.build(f"{name}x", draw, levels - 1) if levels > 1 else self.action(name, draw),
            "B": self.action(name, draw),
        }
        ensemble = Ensemble(
            name,
            policy=DeterministicPolicy([0, 1]),
            actions=actions,
            predicates=self.manager,
            states=[StateFactor("s", [f"{name}S"])],
            safe_action=self.safe(name, draw),
            supervision=draw(st.sampled_from(["escalate", Restart(limit=2, backoff=0.5)])),
        )
        self.ensembles.append(ensemble)
        return ensemble

    def act(self, name):
        self.log.append(("act", name))
        if self.find(name).mode != "deciding":
            self.violations.append(f"{name} acts while it is {self.find(name).mode}")

    def make_safe(self, name):
        self.log.append(("safe", name))
        if self.live.get(name):
            self.violations.append(f"{name} is made safe while an action lives")

    def enter(self, name):
        if self.live.get(name):
            self.violations.append(f"two actions of {name} are live at once")
        self.live[name] = True

    def action(self, name, draw):
        kind = draw(st.sampled_from(["plain", "slow", "stubborn", "broken"]))

        def plain():
            self.act(name)
            if kind == "broken":
                raise LookupError

        async def slow():
            self.act(name)
            self.enter(name)
            try:
                await asyncio.sleep(2.0)
            finally:
                try:
                    if kind == "stubborn":
                        await asyncio.sleep(0.7)
                finally:
                    self.live[name] = False

        return plain if kind in {"plain", "broken"} else slow

    def safe(self, name, draw):
        kind = draw(st.sampled_from(["plain", "slow", "broken"]))

        async def slow():
            self.enter(name)
            try:
                await asyncio.sleep(0.5)
            finally:
                self.live[name] = False
            self.make_safe(name)

        def plain():
            self.make_safe(name)
            if kind == "broken":
                raise LookupError

        return slow if kind == "slow" else plain

    def find(self, name):
        return next(ensemble for ensemble in self.ensembles if ensemble.name == name)


STEPS = ["set", "set", "set", "unset", "wait", "wait", "release", "crash", "stop", "start"]


def test_one_that_fails_is_made_safe_once_though_the_program_ends_meanwhile():
    log = Log()
    below = robot(log, "below", safe_action=log.plain("BELOW"))
    top = Ensemble("top", policy=[0], actions={"Below": below}, safe_action=log.slow("TOP", 0.5))

    async def main(runtime):
        await runtime.start(top)
        top.publish_state(0)
        crash(below.action)
        await asyncio.sleep(0.01)  # what is above it is still being made safe
        assert below.failing
        assert log == ["BELOW", "TOP begins"]

    with pytest.raises(ActorFailure):
        run_virtual(main)
    assert log == ["BELOW", "TOP begins", "TOP ends"]


@settings(max_examples=75, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_in_every_hierarchy_nothing_is_decided_while_safe_and_the_outermost_comes_last(data):
    robot = Robot(data.draw)
    steps = data.draw(st.lists(st.tuples(st.sampled_from(STEPS), st.integers(0, 2), st.booleans()), max_size=25))
    active = []

    async def main(runtime):
        await runtime.start(robot.manager)
        await runtime.start(robot.top)
        for step, index, flag in steps:
            ensemble = robot.ensembles[index % len(robot.ensembles)]
            if ensemble.life != "running":
                await asyncio.sleep(1.0)
            elif step == "set":
                robot.sensors[index % len(robot.sensors)].set(flag)
            elif step == "unset":
                robot.sensors[index % len(robot.sensors)].set(None)
            elif step == "crash":
                crash(ensemble.control if flag else ensemble.action)
            elif step in {"release", "stop", "start"}:
                getattr(ensemble if step == "release" else robot.top, step)()
            else:
                await asyncio.sleep(0.3 if flag else 3.0)
        await asyncio.sleep(0.01)
        last = {name: kind for kind, name in robot.log}
        failing = any(each.failing for each in robot.ensembles)  # and those that it made safe do nothing more
        made_safe = [each for each in robot.ensembles if failing and last.get(each.name) == "safe"]
        active.extend(
            each.name for each in robot.ensembles if each.active and each.life == "running" and each not in made_safe
        )
        robot.log.clear()

    try:
        run_virtual(main)
    except ActorFailure:
        active = []
    assert robot.violations == []
    if not active:
        return
    safe = [name for kind, name in robot.log if kind == "safe"]
    assert set(active) <= set(safe)
    assert not any(robot.live.values())
    last = {name: place for place, name in enumerate(safe)}
    assert [name for name in sorted(last, key=last.get) if name in active] == [
        each.name for each in robot.ensembles if each.name in active
    ]
    assert [kind for kind, _ in robot.log] == ["safe"] * len(robot.log)


def test_what_an_action_ends_is_not_started_by_hand_until_it_has_ended():
    log = Log()

    async def main(runtime):
        async def work():
            try:
                await asyncio.sleep(1e6)
            finally:
                await asyncio.sleep(3.0)
                log.append("Work ends")

        below = Ensemble("below", policy=[0], actions={"Work": bind(work, grace=5.0)})
        top = robot(log, actions={"A": below, "B": log.plain("Rest")})
        faults = probe(runtime.faults)
        await runtime.start(top)
        below.publish_state(0)
        top.publish_state(0)
        await asyncio.sleep(1)
        top.publish_state(1)
        for _ in range(2):
            below.start()
            await asyncio.sleep(1)
        refused = "was not started: the action that it is bound to is coming to its end"
        assert [fault.detail for fault in faults] == [refused] * 2
        await asyncio.sleep(2)
        assert log == ["Work ends", "Rest"]
        below.start()
        assert below.action.live == ("Work",)

    run_virtual(main)


def test_an_ensemble_that_has_failed_in_the_same_turn_does_not_keep_its_action_live():
    log = Log()

    async def main(runtime):
        below = Ensemble("below", policy=[0], actions={"Work": log.plain("Work")}, supervision="stop")
        top = robot(log, actions={"A": below, "B": log.plain("Rest")})
        faults = probe(runtime.faults)
        await runtime.start(top)
        crash(below)
        top.publish_state(0)
        assert faults[-1].detail == "action 'A' failed: ensemble 'robot/below' does not run: it has failed"
        top.publish_state(1)
        assert log[-1] == "Rest"

    run_virtual(main)
