"""Tools for tests: what disturbs an actor, and replays."""

from __future__ import annotations

import asyncio

import pytest
from recorded import Fragile, tell
from sentences import refused

import mdm
from mdm import Ensemble
from mdm.config.recorded import attach_configuration
from mdm.policies import DeterministicPolicy
from mdm.recording import Recorder
from mdm.testing import block, delay, replay, run_virtual


def test_disturbances():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log)
        await runtime.start(actor)
        with block(actor) as held:
            tell(runtime, 2)
            tell(runtime, 4)
            assert len(held) == 2
            assert log == [("start", "actor")]
        await asyncio.sleep(0.1)
        assert log[1:] == [("handled", 2), ("handled", 4)]
        with delay(actor, 5):
            tell(runtime, 6)
        await asyncio.sleep(4.9)
        assert ("handled", 6) not in log
        await asyncio.sleep(0.2)
        assert ("handled", 6) in log

    run_virtual(main)


def _switched(path, policy):
    """Record a robot that goes or stays by one sensor; return one built anew, by another policy."""
    made = [_robot([0, 1]), _robot(policy)]
    sensor, robot = made[0]

    async def main(runtime):
        await runtime.start(robot)
        for value in (True, False, True):
            await asyncio.sleep(1)
            sensor.set(value)

    run_virtual(main, record=path)
    return made[1][1]


def _robot(policy):
    predicates = mdm.PredicateManager()
    sensor = predicates.sensor("Ahead", initial=False)
    return sensor, mdm.Ensemble(
        "robot",
        policy=policy,
        predicates=predicates,
        states=[mdm.StateFactor("ahead", ["Ahead"])],
        actions={"go": lambda: None, "stay": lambda: None},
    )


def test_a_replay_of_the_same_robot_returns_how_many_decisions_there_are(tmp_path):
    robot = _switched(tmp_path / "run.mcap", [0, 1])
    assert replay(tmp_path / "run.mcap", robot) == 4
    assert replay(tmp_path / "run.mcap") == 4  # by what the record holds of it


def test_a_replay_of_another_robot_raises_the_first_difference(tmp_path):
    robot = _switched(tmp_path / "run.mcap", [1, 0])
    with pytest.raises(AssertionError) as caught:
        replay(tmp_path / "run.mcap", robot)
    told = str(caught.value)
    assert "decision 0, of 'robot' at 0.000000 s: action 'go', now 'stay'" in told
    assert "began actor robot, step run" in told


def test_a_replay_takes_the_file_that_the_record_has_or_another(tmp_path):
    text = (
        "[predicates]\nAhead = { initial = false, max_age = 1.0 }\n[ensembles.robot]\npolicy = [0, 1]\n"
        "on_lost_input = 'continue'\n[ensembles.robot.states]\nahead = ['Ahead']\n"
        "[ensembles.robot.actions]\ngo = 'builtins:print'\nstay = 'builtins:print'\n"
    )
    (tmp_path / "robot.toml").write_text(text)
    system = mdm.load_system(tmp_path / "robot.toml")
    recorder = Recorder(tmp_path / "run.mcap")
    attach_configuration(recorder, tmp_path / "robot.toml")

    async def main(runtime):
        await runtime.start(system)
        system.predicates.sense("Ahead", True)
        await asyncio.sleep(0.5)

    run_virtual(main, record=recorder)
    (tmp_path / "robot.toml").write_text(text.replace("[0, 1]", "[1, 1]"))
    assert replay(tmp_path / "run.mcap") == 2
    with pytest.raises(AssertionError, match="decision 0, of 'robot' at .* action 'go', now 'stay'"):
        replay(tmp_path / "run.mcap", config=tmp_path / "robot.toml")


def test_a_replay_that_cannot_be_is_refused(tmp_path):
    robot = _switched(tmp_path / "run.mcap", [0, 1])
    with refused(mdm.Error):
        replay(tmp_path / "run.mcap", robot, config="robot.toml")
    with pytest.raises(mdm.Error, match="takes config, and no actors: each agent has its own"):
        replay(tmp_path, robot)
    (tmp_path / "none").mkdir()
    with pytest.raises(mdm.Error, match="there are no records in this folder"):
        replay(tmp_path / "none")


@pytest.mark.parametrize(("options", "told"), [({}, 1), ({"log": False}, 0)])
def test_an_action_that_fails_in_a_test_is_printed_once(options, told, capsys):
    robot = Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={"0": lambda: {}["gone"]})

    async def main(runtime):
        await runtime.start(robot)
        for _ in range(3):
            robot.publish_state(0)
            await asyncio.sleep(1)

    run_virtual(main, **options)
    assert capsys.readouterr().err.count("KeyError: 'gone'") == told


@pytest.mark.parametrize(("options", "printed"), [({}, 1), ({"log": False}, 0)])
def test_the_first_fault_of_each_kind_in_a_test_is_printed(options, printed, capsys):
    predicates = mdm.PredicateManager()
    battery = predicates.sensor("BatteryLow", max_age=1.0)

    async def main(runtime):
        await runtime.start(predicates)
        for _ in range(3):
            battery.set(False)
            await asyncio.sleep(2)

    run_virtual(main, **options)
    told = "mdm: predicates: stale: predicate 'BatteryLow' was not refreshed for 1 s\n"
    assert capsys.readouterr().err == told * printed
