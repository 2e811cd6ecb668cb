"""Safe modes: what each cause does to the live action, what is decided and the belief; and the ways back."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from mdm import (
    ActorFailure,
    ConfigError,
    Ensemble,
    Error,
    FixedRate,
    ObservationFactor,
    PredicateManager,
    Restart,
    StateFactor,
    VirtualClock,
    bind,
)
from mdm.actors import EnsembleStatistics
from mdm.messages import Mode
from mdm.models import POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.testing import capture_decisions, crash, probe, run_virtual


async def forever():
    await asyncio.sleep(1e6)


class Log(list):
    """Calls, in their order."""

    def plain(self, name):
        return lambda: self.append(name)

    def slow(self, name, seconds=1.0):
        async def work():
            self.append(f"{name} begins")
            try:
                await asyncio.sleep(seconds)
            finally:
                self.append(f"{name} ends")

        return work


def certain(actions=1):
    """A model in which, in the state that is certain after a step, observation 1 is impossible."""
    return POMDP(
        [np.array([[0.0, 1.0], [0.0, 1.0]])] * actions,
        [np.array([[1.0, 0.0], [1.0, 0.0]])] * actions,
        np.zeros((2, actions)),
        discount=0.9,
        initial_belief=[0.75, 0.25],
    )


def robot(log, **options):
    given = {"policy": DeterministicPolicy([0, 1]), "actions": {"A": log.plain("A"), "B": log.plain("B")}}
    return Ensemble("robot", **(given | {"safe_action": log.plain("SAFE")} | options))


def sensed(log, *, max_age=None, supervision="escalate", **options):
    manager = PredicateManager()
    sensor = manager.sensor("S", max_age=max_age)
    factors = [StateFactor("s", ["S"])]
    return robot(log, predicates=manager, states=factors, supervision=supervision, **options), manager, sensor


# -- The safe action and what is decided ---------------------------------------------------------------------------


@pytest.mark.parametrize("safe", ["plain", "async"])
@pytest.mark.parametrize("action", ["plain", "async"])
def test_an_impossible_observation_runs_the_safe_action_to_its_end_before_what_is_decided(safe, action):
    log = Log()

    async def main(runtime):
        one = robot(
            log,
            policy=AlphaVectors([[0.0, 0.0]], [0], 1),
            model=certain(),
            actions={0: log.plain("A") if action == "plain" else log.slow("A", 1e6)},
            safe_action=log.plain("SAFE") if safe == "plain" else log.slow("SAFE", 3.0),
            on_impossible="safe_action",
        )
        await runtime.start(one)
        await asyncio.sleep(0.1)
        log.clear()
        one.publish_observation(1)
        assert "A begins" not in log
        await asyncio.sleep(5)
        runs = ["SAFE"] if safe == "plain" else ["SAFE begins", "SAFE ends"]
        acts = ["A"] if action == "plain" else ["A begins"]
        assert log == [*(["A ends"] if action == "async" else []), *runs, *acts]
        assert one.control.belief[0] == 0.0  # goes on from the prediction
        assert one.mode == "deciding"

    run_virtual(main)


def test_what_was_decided_in_the_same_turn_does_not_start():
    log = Log()

    def broken():
        log.append("B")
        raise LookupError

    async def main(runtime):
        one = robot(log, actions={"A": log.plain("A"), "B": broken})
        await runtime.start(one)

        def both(_):
            one.publish_state(1)
            one.publish_state(0)

        channel = runtime.channel("both", int)
        channel.subscribe(both)
        channel.publish(1)
        assert log == ["B", "SAFE"]
        assert one.action.skipped == 1

    run_virtual(main)


def test_a_tick_with_input_too_old_drives_no_more():
    log = Log()

    async def main(runtime):
        manager = PredicateManager()
        seen = manager.sensor("Seen", max_age=1.0)
        manager.event("E0", "Seen")
        manager.event("E1", "not Seen")
        one = robot(
            log,
            policy=AlphaVectors([[0.0, 0.0]], [0], 1),
            model=certain(),
            actions={0: log.plain("A")},
            predicates=manager,
            observations=[ObservationFactor("o", ["E0", "E1"])],
            drive=FixedRate(1.0),
        )
        await runtime.start(one)
        seen.set(True)
        await asyncio.sleep(0.5)
        log.clear()
        await asyncio.sleep(10)
        assert log.count("SAFE") == 1
        assert log[-1] == "SAFE"
        log.clear()
        seen.set(True)
        await asyncio.sleep(0.9)
        assert log == ["A"]

    run_virtual(main)


@pytest.mark.parametrize("how", ["raises", "raises later", "times out", "is abandoned"])
def test_an_action_that_fails_makes_safe_until_the_next_state(how):
    log = Log()

    async def later():
        await asyncio.sleep(0.1)
        raise LookupError

    async def stubborn():
        while True:
            try:
                await asyncio.sleep(1e6)
            except asyncio.CancelledError:
                log.append("ignored")
                if runtime_ends:
                    raise

    def at_once():
        raise LookupError

    target = {
        "raises": at_once,
        "raises later": later,
        "times out": bind(forever, timeout=1.0),
        "is abandoned": bind(stubborn, timeout=1.0, grace=1.0),
    }[how]
    runtime_ends = []

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": target, "B": log.plain("B")})
        modes = probe(runtime.modes)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(10)
        assert [entry for entry in log if entry != "ignored"] == ["SAFE"]
        assert [cause.kind for cause in one.causes] == ["action"]
        sensor.set(True)
        assert log[-1] == "B"
        assert [mode.mode for mode in modes] == ["deciding", "safe", "deciding"]
        runtime_ends.append(True)
        for work in runtime.abandoned:
            work.cancel()

    run_virtual(main)


def test_an_action_that_fails_is_the_system_s_own_affair_where_its_end_is_used_or_the_option_says_so():
    log = Log()

    def broken():
        raise LookupError

    async def main(runtime):
        manager = PredicateManager()
        sensor = manager.sensor("S")
        manager.latch("Failed", set="A.failed", reset="S")
        one = robot(
            log,
            predicates=manager,
            states=[StateFactor("f", ["Failed"])],
            actions={"A": broken, "B": log.plain("B")},
        )
        await runtime.start(one)
        assert sensor is not None
        assert log == ["B"]
        assert one.mode == "deciding"

    run_virtual(main)
    assert log == ["B", "SAFE"]

    async def goes_on(runtime):
        one, _, sensor = sensed(log, actions={"A": broken, "B": log.plain("B")}, on_failed_action="continue")
        await runtime.start(one)
        sensor.set(False)
        assert one.mode == "deciding"

    run_virtual(goes_on)


def test_a_live_action_that_does_not_end_is_abandoned_and_the_safe_action_runs():
    log = Log()
    free = asyncio.Event()

    async def stubborn():
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                log.append("ignored")

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, actions={"A": bind(stubborn, grace=2.0), "B": log.plain("B")})
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2.5)
        assert log == ["ignored"]
        await asyncio.sleep(1.0)
        assert log == ["ignored", "SAFE"]
        free.set()

    run_virtual(main)


# -- The safe action itself ----------------------------------------------------------------------------------------


def test_a_safe_action_that_fails_is_tried_once_more_then_it_is_an_emergency():
    log = Log()

    def broken():
        log.append("SAFE")
        raise LookupError("no brakes")

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=broken)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        assert log[:3] == ["A", "SAFE", "SAFE"]
        assert log[3] == "motors off"
        assert "failed twice: action 'safe action' failed: LookupError: no brakes" in next(
            fault.detail for fault in faults if fault.kind == "safe_action"
        )
        sensor.set(True)
        assert one.mode == "safe"  # until a person says so
        one.release()
        assert log[-1] == "B"

    run_virtual(main, emergency=log.plain("motors off"))


def test_the_safe_action_has_a_limit_of_its_own():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 1e6), safe_timeout=2.0)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(10)
        assert log == ["A", "SAFE begins", "SAFE ends", "SAFE begins", "SAFE ends"]
        assert [fault.detail for fault in faults if fault.kind == "action"] == ["action 'safe action' timed out"] * 2
        statistics = one.statistics()
        assert isinstance(statistics, EnsembleStatistics)
        assert (statistics.mode, statistics.safe_actions) == ("safe", 2)
        assert {cause.kind for cause in statistics.causes} == {"stale_input", "safe_action"}

    run_virtual(main)


def test_an_async_safe_action_runs_to_its_end_at_the_end_of_the_runtime():
    log = Log()

    async def main(runtime):
        one = robot(log, safe_action=log.slow("SAFE", 9.0))
        await runtime.start(one)
        one.publish_state(0)

    run_virtual(main)
    assert log == ["A", "SAFE begins", "SAFE ends"]


@pytest.mark.parametrize("broken", [None, "bottom", "middle", "top"])
def test_at_the_end_the_outermost_has_the_last_word_and_one_failure_stops_no_other(broken):
    log = Log()

    def safe(name):
        async def make_safe():
            await asyncio.sleep(0.5)
            log.append(name)
            if name == broken:
                raise LookupError

        return make_safe

    async def main(runtime):
        below = Ensemble("bottom", policy=[0], actions={"Work": forever}, safe_action=safe("bottom"))
        middle = Ensemble("middle", policy=[0], actions={"Below": below}, safe_action=safe("middle"))
        top = Ensemble("top", policy=[0], actions={"Below": middle}, safe_action=safe("top"))
        await runtime.start(top)
        for each in (below, middle, top):
            each.publish_state(0)
        assert below.action.live == ("Work",)

    run_virtual(main)
    assert list(dict.fromkeys(log)) == ["bottom", "middle", "top"]
    assert log == sorted(log, key=["bottom", "middle", "top"].index)


def two_levels(log, *actions, safe_action, cleanup=0.0):
    """An ensemble whose sensor grows old after a second, one below it that works, and that sensor."""
    manager = PredicateManager()
    sensor = manager.sensor("S", max_age=1.0)

    async def work():
        log.append("Work begins")
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(cleanup)
            log.append("Work ends")

    below = Ensemble("below", policy=[0], actions={"Work": bind(work, grace=5.0)})
    top = Ensemble(
        "top",
        policy=DeterministicPolicy([0, 0], 2),
        actions={action: below if action == "Below" else log.plain(action) for action in actions},
        predicates=manager,
        states=[StateFactor("s", ["S"])],
        safe_action=safe_action,
    )
    return top, below, sensor


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


@pytest.mark.parametrize("how", ["release", "input"])
def test_while_it_ends_there_is_no_way_back(how):
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Rest", "Below", safe_action=log.plain("TOP"), cleanup=3.0)
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(2)
        assert log == ["Rest", "Work begins", "TOP"]
        ending = asyncio.create_task(runtime.stop(top))
        await asyncio.sleep(1)
        if how == "release":
            top.release()
        else:
            sensor.set(False)
        await ending

    run_virtual(main)
    assert log == ["Rest", "Work begins", "TOP", "Work ends", "TOP"]


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
        assert faults[-1].detail == "was not started: ensemble 'top' above it is safe"
        await asyncio.sleep(5)
        sensor.set(False)
        await asyncio.sleep(0.5)
        assert log[3:] == ["TOP ends", "Work begins"]

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


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
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
        active.extend(each.name for each in robot.ensembles if each.active and each.life == "running")
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


# -- Input ---------------------------------------------------------------------------------------------------------


def test_a_state_that_turns_unknown_makes_safe_until_it_is_known():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": log.slow("A", 1e6), "B": log.plain("B")})
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1)
        sensor.set(None)
        await asyncio.sleep(1)
        assert log == ["A begins", "A ends", "SAFE"]
        assert [(fault.kind, fault.detail) for fault in faults] == [("unknown_input", "the state turned unknown: S")]
        sensor.set(True)
        assert log[-1] == "B"

    run_virtual(main)


@pytest.mark.parametrize("options", [{"on_unknown": "continue"}, {"safe_action": None}])
def test_with_continue_or_without_a_safe_action_the_old_action_goes_on_and_waiting_is_told(options):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": log.slow("A", 1e6), "B": log.plain("B")}, **options)
        faults = probe(runtime.faults)
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1)
        sensor.set(None)
        await asyncio.sleep(2)
        assert one.action.live == ("A",)
        assert [(fault.kind, fault.detail) for fault in faults] == [("waiting", "cannot decide: unknown is S")]

    run_virtual(main)


def test_old_input_is_a_cause_of_its_own():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, on_unknown="continue")
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        assert [cause.kind for cause in one.causes] == ["stale_input"]
        sensor.set(True)
        assert (one.mode, log) == ("deciding", ["A", "SAFE", "B"])

    run_virtual(main)


# -- Deadlines and beliefs -----------------------------------------------------------------------------------------


class Behind(VirtualClock):
    """A clock that a slow policy moves on."""

    behind = 0

    def now(self):
        return super().now() + self.behind


class Slow(AlphaVectors):
    """Takes 0.2 s for the decisions whose numbers are given."""

    clock = None
    late = ()
    count = 0

    def action(self, belief):
        if self.count in self.late:
            self.clock.behind += 200_000_000
        self.count += 1
        return self.count - 1 if self.count < 3 else 2


def moving():
    """Three actions that move the belief each in its own way."""
    stay, half, flip = np.eye(2), np.full((2, 2), 0.5), np.array([[0.0, 1.0], [1.0, 0.0]])
    blind = np.ones((2, 1))
    return POMDP([stay, half, flip], [blind] * 3, np.zeros((2, 3)), discount=0.9, initial_belief=[0.9, 0.1])


@pytest.mark.parametrize(
    ("safe", "after", "belief"),
    [
        ("2", "reset", [0.1, 0.9]),  # one of the model's: the belief goes by it
        (None, "keep", [0.9, 0.1]),  # else by what was done before the late decision
        (None, "reset", [0.9, 0.1]),  # or it starts anew
    ],
)
def test_a_late_decision_does_not_move_the_belief_by_what_was_not_done(safe, after, belief):
    log = Log()

    async def main(runtime):
        policy = Slow([[0.0, 0.0]], [0], 3)
        policy.clock, policy.late = runtime.clock, (1,)
        one = robot(
            log,
            policy=policy,
            model=moving(),
            actions={str(index): log.plain(str(index)) for index in range(3)},
            safe_action=log.plain("SAFE") if safe is None else safe,
            deadline=0.1,
            after_safe=after,
        )
        await runtime.start(one)
        with capture_decisions(runtime) as decisions:
            one.publish_observation(0)
            assert log == ["0", "SAFE" if safe is None else "2"]
            assert decisions == []
            assert one.mode == "safe"
            one.publish_observation(0)
            assert one.mode == "deciding"
        assert decisions[0].belief == pytest.approx(belief)
        assert decisions[0].epoch == (0 if safe is None and after == "reset" else 2)

    run_virtual(main, clock=Behind())


# -- Release -------------------------------------------------------------------------------------------------------


def test_release_waits_for_the_safe_action_and_no_longer():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 3.0), on_unknown="continue")
        told = probe(runtime.channel("robot/mode", Mode, retain=True))
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(2)
        one.release()
        assert one.mode == "safe"
        await asyncio.sleep(3)
        assert one.mode == "deciding"
        assert [(mode.mode, [cause.kind for cause in mode.causes], mode.time) for mode in told] == [
            ("deciding", [], 0),
            ("safe", ["stale_input"], 10**9),
            ("safe", [], 2 * 10**9),
            ("deciding", [], 4 * 10**9),
        ]
        late = probe(runtime.channel("robot/mode", Mode, retain=True))
        assert [mode.mode for mode in late] == ["deciding"]

    run_virtual(main)


def test_a_stop_lets_the_safe_action_end_and_a_start_begins_anew():
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log, max_age=1.0, safe_action=log.slow("SAFE", 3.0))
        await runtime.start(one)
        sensor.set(False)
        await asyncio.sleep(1.5)
        one.stop()
        idle = []
        one.when_idle(lambda: idle.append(runtime.clock.now()))
        await asyncio.sleep(5)
        assert (one.mode, idle, log[-1]) == ("stopped", [4 * 10**9], "SAFE ends")
        sensor.set(True)
        assert log[-1] == "SAFE ends"
        one.start()
        assert log[-1] == "B"

    run_virtual(main)


# -- Failures, restarts and fresh input ----------------------------------------------------------------------------


@pytest.mark.parametrize("layer", ["control", "action", "state"])
def test_a_failing_layer_latches_within_its_turn(layer):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log)
        await runtime.start(one)
        sensor.set(False)
        crash(getattr(one, layer), Error("broken"))
        assert log == ["A", "SAFE"]
        sensor.set(True)
        assert log == ["A", "SAFE"]
        await asyncio.sleep(1)

    with pytest.raises(ActorFailure, match="broken"):
        run_virtual(main)
    assert log == ["A", "SAFE"]


@pytest.mark.parametrize("shared", [True, False])
def test_after_a_restart_nothing_old_is_decided_on(shared):
    log = Log()

    async def main(runtime):
        one, manager, sensor = sensed(log, max_age=0.5, supervision=Restart(backoff=1.0))
        if shared:
            await runtime.start(manager)
        await runtime.start(one)
        sensor.set(False)
        crash(one.state)
        await asyncio.sleep(3)
        assert one.life == "running"
        assert log == ["A", "SAFE"]
        sensor.set(True)
        assert log == ["A", "SAFE", "B"]

    run_virtual(main)


def test_initial_values_do_not_come_back_and_what_sensors_are_told_meanwhile_does():
    log = Log()

    async def main(runtime):
        manager = PredicateManager()
        first = manager.sensor("P", initial=False)
        second = manager.sensor("Q", initial=False)
        one = robot(
            log,
            policy=DeterministicPolicy([0, 1, 1, 1]),
            predicates=manager,
            states=[StateFactor("p", ["P"]), StateFactor("q", ["Q"])],
            supervision=Restart(backoff=1.0),
        )
        await runtime.start(one)
        assert log == ["A"]
        crash(one.state)
        await asyncio.sleep(0.5)
        first.set(True)
        await asyncio.sleep(2)
        assert manager.values() == {"P": True, "Q": None}
        assert log == ["A", "SAFE"]
        second.set(False)
        assert log == ["A", "SAFE", "B"]

    run_virtual(main)


def test_a_new_ensemble_of_the_same_name_knows_no_old_state():
    log = Log()

    async def main(runtime):
        one = robot(log)
        await runtime.start(one)
        one.publish_state(0)
        await runtime.stop(one)
        log.clear()
        await runtime.start(robot(log))
        await asyncio.sleep(1)
        assert log == []

    run_virtual(main)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"on_lost_input": "panic"}, "on_lost_input is 'safe' or 'continue', not 'panic'"),
        ({"on_unknown": "safe", "safe_action": None}, "on_unknown asks for the safe action, but there is none"),
        ({"on_failed_action": "safe", "safe_action": None}, "on_failed_action asks for the safe action"),
        ({"after_safe": "predict"}, "after_safe is 'reset' or 'keep', not 'predict'"),
        ({"safe_timeout": 0}, "safe_timeout is a number of seconds above 0"),
        ({"on_lost": "safe"}, "there is no option 'on_lost'"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        robot(Log(), **options)
