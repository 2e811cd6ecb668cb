"""Ensembles: hierarchy, supervision, safe actions, the whole loop."""

from __future__ import annotations

import ast
import asyncio
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pytest
from levels import forever, leaf
from sentences import refused

import mdm
from mdm import (
    Actor,
    ConfigError,
    Ensemble,
    ObservationFactor,
    OnEvent,
    PredicateManager,
    Restart,
    Runtime,
    StateFactor,
    VirtualClock,
    bind,
    problems,
    run,
)
from mdm.policies import DeterministicPolicy
from mdm.solvers import solve
from mdm.testing import capture_decisions, crash, probe, replay, run_virtual

PACKAGE = Path(mdm.__file__).parent


def test_an_ensemble_that_restarts_decides_again():
    async def main(runtime):
        manager = PredicateManager()
        a = manager.sensor("A", initial=False)
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"X": lambda: None, "Y": lambda: None},
            predicates=manager,
            states=[StateFactor("a", ["A"])],
            supervision=Restart(backoff=0.5),
        )
        await runtime.start(manager)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            crash(robot.state)
            await asyncio.sleep(1)
            a.set(True)
        assert [decision.action for decision in decisions] == [0, 0, 1]

    run_virtual(main)


@pytest.mark.parametrize("actor", ["robot", "robot/action", "robot/control"])
@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("command", ["start", "stop"])
def test_what_is_told_to_an_ensemble_while_its_layers_start_holds_when_they_have_started(actor, restarts, command):
    async def main(runtime):
        calls = []
        robot = Ensemble("robot", policy=[0], actions={"A": lambda: calls.append("A")}, supervision=Restart())

        def tell(change):
            if (change.actor, change.state) == (actor, "starting") and (
                not restarts or robot.control.life != "created"
            ):
                getattr(robot, command)()

        if not restarts:
            runtime.lives.subscribe(tell)
        await runtime.start(robot)
        if restarts:
            runtime.lives.subscribe(tell)
            crash(robot.control)
            await asyncio.sleep(1)
        robot.publish_state(0)
        if command == "stop":
            assert (robot.mode, calls) == ("stopped", [])
            robot.start()
        assert (robot.mode, calls, robot.action.skipped) == ("deciding", ["A"], 0)

    run_virtual(main)


def test_stale_input_runs_the_safe_action():
    log = []

    async def main(runtime):
        manager = PredicateManager()
        sensor = manager.sensor("A", max_age=1)
        manager.define("B", "not A")
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"X": forever, "Y": lambda: log.append("Y")},
            predicates=manager,
            states=[StateFactor("b", ["B"])],
            safe_action=lambda: log.append("safe"),
        )
        faults = probe(runtime.faults)
        await runtime.start(robot)
        sensor.set(True)
        await asyncio.sleep(1.5)
        assert log == ["safe"]
        assert [(fault.kind, fault.source, fault.detail) for fault in faults] == [
            ("stale", "robot/predicates", "predicate 'A' was not refreshed for 1 s"),
            ("stale_input", "robot", "input is too old: A"),
        ]
        sensor.set(False)
        assert log == ["safe", "Y"]  # and it goes on

    run_virtual(main)
    assert log == ["safe", "Y", "safe"]  # at the end of the runtime


@pytest.mark.parametrize("how", ["return", "error", "cancel"])
def test_the_end_of_a_runtime_ends_actions_then_runs_the_safe_action(how):
    log = []

    async def work():
        try:
            await forever()
        finally:
            await asyncio.sleep(0.2)
            log.append("work ended")

    async def safe():
        log.append("safe begins")
        await asyncio.sleep(0.3)
        log.append("safe ends")

    async def program():
        async with Runtime(clock=VirtualClock(), log=None) as runtime:
            robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={"Work": work}, safe_action=safe)
            await runtime.start(robot)
            robot.publish_state(0)
            await asyncio.sleep(1)
            if how == "error":
                raise LookupError
            if how == "cancel":
                await forever()

    async def main():
        before = asyncio.all_tasks()
        if how == "cancel":
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(program(), 5)
        elif how == "error":
            with pytest.raises(LookupError):
                await program()
        else:
            await program()
        assert asyncio.all_tasks() == before

    run(main, virtual=True)
    assert log == ["work ended", "safe begins", "safe ends"]


def test_callbacks_may_command_their_own_ensemble_in_their_own_turn():
    log = []

    async def main(runtime):
        manager = PredicateManager()
        a = manager.sensor("A", initial=False)

        def first():
            log.append("first")
            a.set(True)
            log.append("set")  # the next decision comes after this call, not within it

        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"First": first, "Second": lambda: (log.append("second"), robot.stop(), a.set(False))},
            predicates=manager,
            states=[StateFactor("a", ["A"])],
        )
        await runtime.start(robot)
        assert log == ["first", "set", "second"]
        assert not robot.active

    run_virtual(main)


def test_statistics_of_the_whole_tree():
    async def main(runtime):
        robot = leaf("robot")
        await runtime.start(robot)
        for state in (1, 1, 1, 0):
            robot.publish_state(state)
            await asyncio.sleep(1)
        control, action = robot.control.statistics(), robot.action.statistics()
        assert (control.decisions, control.latency.count, control.received, control.state) == (4, 4, 5, "running")
        assert (action.started, action.ended, action.live, action.work) == (4, {"succeeded": 3}, ("Work",), 1)
        assert action.latency.count == 4
        whole = runtime.statistics()
        assert [actor.path for actor in whole.actors] == ["robot", "robot/action", "robot/control"]
        states = next(channel for channel in whole.channels if channel.name == "robot/state")
        assert (states.published, states.last, states.subscribers) == (4, 3_000_000_000, 1)
        with pytest.raises(AttributeError):
            control.decisions = 0

    run_virtual(main)


def test_factors_without_a_predicate_manager_are_refused():
    with refused(ConfigError):
        leaf("leaf", states=[StateFactor("a", ["A"])])
    with refused(ConfigError):
        leaf("leaf", observations=[ObservationFactor("a", ["A", "B"])])


def test_state_factors_must_make_the_policy_s_states():
    async def main(runtime):
        manager = PredicateManager()
        for name in "AB":
            manager.sensor(name)
        with refused(ConfigError):
            await runtime.start(
                leaf("leaf", predicates=manager, states=[StateFactor("a", ["A"]), StateFactor("b", ["B"])])
            )

    run_virtual(main)


def test_what_nothing_gives_and_what_nothing_takes_is_noted():
    manager = PredicateManager()
    for name in "AB":
        manager.sensor(name)
        manager.event(f"{name}Seen")
    states = [StateFactor("a", ["A"])]
    observations = [ObservationFactor("seen", ["ASeen", "BSeen"])]
    actions = {"Work": lambda: None, "Rest": lambda: None}  # which take no time: nothing is to follow their ends
    assert list(leaf("leaf", predicates=manager, states=states, actions=actions).notes()) == []
    both = leaf("leaf", predicates=manager, states=states, observations=observations, actions=actions)
    assert list(both.notes()) == ["ensemble 'leaf' has observations, but its policy decides on states"]
    assert list(leaf("leaf", actions=actions).notes()) == [
        "ensemble 'leaf' has no states: it waits for code that publishes what it decides on"
    ]


def test_the_same_input_gives_the_same_bytes():
    def encode(value):
        return value.tolist() if isinstance(value, np.ndarray) else str(value)

    async def main(runtime):
        seen = []
        manager = PredicateManager()
        for name in "ABC":
            manager.sensor(name, initial=False, max_age=2.0)
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1, 2, 0, 1, 2, 0, 1]),
            actions={"X": forever, "Y": lambda: None, "Z": bind(forever, timeout=0.7)},
            predicates=manager,
            states=[StateFactor(name, [name]) for name in "ABC"],
        )
        await runtime.start(manager)
        await runtime.start(robot)
        for channel in runtime.channels:
            channel.subscribe(lambda message, name=channel.name: seen.append((name, message)))
        random = np.random.default_rng(5)
        for _ in range(300):
            manager.sense("ABC"[random.integers(3)], bool(random.integers(2)))
            await asyncio.sleep(float(random.exponential(0.5)))
        return msgspec.json.encode(seen, enc_hook=encode)

    first, second = run_virtual(main), run_virtual(main)
    assert first == second
    assert first.count(b"running") > 100


def test_a_callback_that_raises_a_cancellation_leaves_other_ensembles_alone():
    """Reading the result of a cancelled future raises `CancelledError` in a plain function, which nobody cancelled."""
    decided = {"first": 0, "second": 0}

    def act(name):
        decided[name] += 1
        if name == "first" and decided[name] == 2:
            raise asyncio.CancelledError

    async def main(runtime):
        ensembles = [
            Ensemble(name, policy=[0], actions={0: lambda name=name: act(name)}, drive=10.0) for name in decided
        ]
        for ensemble in ensembles:
            await runtime.start(ensemble)
            ensemble.publish_state(0)
        await asyncio.sleep(5.05)

    run_virtual(main)
    assert decided in ({"first": 51, "second": 51}, {"first": 50, "second": 50})


def test_a_timer_that_raises_a_cancellation_leaves_those_of_its_instant_alone():
    """The age of a sensor, and the grace of an action, end at the instants of such timers, behind them."""
    log = []

    def broken():
        log.append("broken")
        raise asyncio.CancelledError

    async def stubborn():
        while "over" not in log:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(1e6)

    async def main(runtime):
        for seconds in (1, 2):
            actor = Actor(f"actor{seconds}", supervision="stop")
            await runtime.start(actor)
            actor.call_later(seconds, broken)
        manager = PredicateManager()
        sensor = manager.sensor("S", max_age=1.0)
        robot = Ensemble(
            "robot",
            policy=[0, 0],
            actions={0: bind(stubborn, grace=1.0)},
            predicates=manager,
            states=[StateFactor("s", ["S"])],
            safe_action=lambda: log.append("SAFE"),
        )
        await runtime.start(robot)
        sensor.set(True)
        await asyncio.sleep(1.5)
        assert (robot.mode, log) == ("safe", ["broken"])
        await asyncio.sleep(1)
        assert log == ["broken", "broken", "SAFE"]
        log.append("over")
        for work in runtime.abandoned:
            work.cancel()

    run_virtual(main)


def test_an_ensemble_prints_what_it_is_and_its_mode():
    assert repr(leaf("robot")) == "<Ensemble 'robot': MDP, 2 states, 2 actions, event-driven, stopped>"


def test_an_ensemble_whose_construction_failed_still_prints():
    """Its repr stands in tracebacks and debuggers, and must not raise an error of its own."""
    half = Ensemble.__new__(Ensemble)
    half.name = "robot"
    assert repr(half) == "<Ensemble 'robot'>"


def test_the_control_layer_is_reached_by_its_ensemble_s_own_objects_and_set_running_in_its_folder_alone():
    reached, sets = set(), set()
    for file in PACKAGE.rglob("*.py"):
        place = file.relative_to(PACKAGE).as_posix()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                of = getattr(node.value, "attr", getattr(node.value, "id", ""))
                if node.attr == "control" and of.removeprefix("_") == "ensemble" and not place.startswith("cli/ros1/"):
                    reached.add(place)
                if node.attr == "running" and of.endswith("control") and isinstance(node.ctx, ast.Store):
                    sets.add(place)
    assert reached == {"actors/safety/safety.py", "actors/safety/liveness.py"}
    assert sets == {"actors/control/source.py"}


def test_a_status_says_how_an_ensemble_is_and_was_declared():
    async def main(runtime):
        robot = Ensemble(
            "leaf", policy=DeterministicPolicy([0, 1]), actions={"A": lambda: None, "B": lambda: None}, deadline=1.0
        )
        before = robot.status()
        await runtime.start(robot)
        robot.publish_state(1)
        await asyncio.sleep(0.001)
        return before, robot.status()

    before, after = run_virtual(main)
    assert (before.mode, before.action, before.action_name, before.decisions, before.cause) == (
        "stopped",
        None,
        "",
        0,
        "",
    )
    assert (after.mode, after.action, after.action_name, after.decisions, after.cause) == (
        "deciding",
        1,
        "B",
        1,
        "state",
    )
    assert (after.drive, after.deadline, after.on_no_observation, after.searches) == (OnEvent(), 1.0, "predict", False)


@pytest.mark.parametrize("kind", ["state", "belief"])
def test_it_decides_again_on_what_it_knows_and_a_replay_does_too(kind, tmp_path):
    def robot():
        if kind == "state":
            return Ensemble("robot", policy=[1, 0], actions={"a": lambda: None, "b": lambda: None})
        model = problems.tiger()
        policy = solve(model, horizon=3).policy
        return Ensemble("robot", policy=policy, model=model, actions=dict.fromkeys(model.action_space.names, print))

    async def main(runtime):
        one = robot()
        with capture_decisions(runtime) as decisions:
            await runtime.start(one)
            one.decide_again()
            if kind == "state":
                one.publish_state(0)
            await asyncio.sleep(1)
            one.decide_again()
            await asyncio.to_thread(one.decide_again)
            await asyncio.sleep(1)
            one.stop()
            one.decide_again()
            await asyncio.sleep(1)
            one.start()
            await asyncio.sleep(1)
        return [(decision.cause, decision.action) for decision in decisions]

    decided = run_virtual(main, record=tmp_path / "run.mcap")
    causes = [cause for cause, _ in decided]
    if kind == "state":  # before it knew its state, and after it was stopped, nothing was decided
        assert decided == [("state", 1), ("again", 1), ("again", 1), ("start", 1)]
    else:
        assert causes == ["start", "again", "again", "again", "start"]
        assert len({action for _, action in decided}) == 1
    assert replay(tmp_path / "run.mcap", robot()) == len(decided)


@pytest.mark.parametrize("mode", ["safe", "ticking"])
def test_it_decides_nothing_again_while_it_is_safe_or_at_a_fixed_rate(mode):
    options = {"drive": 0.5} if mode == "ticking" else {}
    one = Ensemble("robot", policy=[0], actions={"a": lambda: None}, safe_action=lambda: None, **options)

    async def main(runtime):
        await runtime.start(one)
        one.publish_state(0)
        if mode == "safe":
            one.safety.endanger("mine", "", 0)
        await asyncio.sleep(2.5)
        with capture_decisions(runtime) as decisions:
            one.decide_again()
            await asyncio.sleep(0.1)
        return len(decisions)

    assert run_virtual(main) == 0


def test_asked_again_and_again_it_decides_once_each_and_pauses_count_on():
    """A decision for each request, and one after the pause of an action's end only where none came meanwhile."""
    done = []
    one = Ensemble("robot", policy=[0], actions={"a": bind(lambda: done.append(1), then="decide", pause=1.0)})

    async def main(runtime):
        await runtime.start(one)
        with capture_decisions(runtime) as decisions:
            one.publish_state(0)
            for pause in (0.25, 0.5, 0.0, 0.9, 0.2):
                await asyncio.sleep(pause)
                one.decide_again()
            await asyncio.sleep(1.5)
        first = decisions[0].time
        return [round((decision.time - first) / 1e9, 3) for decision in decisions]

    assert run_virtual(main) == [0.0, 0.25, 0.75, 0.75, 1.65, 1.85, 2.85]
    assert len(done) == 7


def test_a_team_s_ensemble_is_not_asked_to_decide_again():
    class Team:
        absence = ""

    one = Ensemble("robot", policy=[0], actions={"a": lambda: None})
    one.follow(Team(), ())
    with refused(mdm.Error):
        one.decide_again()
