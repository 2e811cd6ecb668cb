"""The system of a file: its tasks, and how many ensembles may lie below each other."""

from __future__ import annotations

import asyncio

import pytest
from loading import written
from robot_file import CALLBACKS, GOOD
from sentences import refused

from mdm import (
    ActorFailure,
    ConfigError,
    load_system,
)
from mdm.testing import probe, run_virtual


def test_a_task_that_fails_is_named(folder):
    async def main(runtime):
        await runtime.start(load_system(written(folder, GOOD, "robot.toml")))
        await runtime.wait()

    (folder / "robot_code.py").write_text(CALLBACKS.replace('system.predicates.sense("A", True)', "1 / 0"))
    with refused(ActorFailure):
        run_virtual(main)


def test_a_task_that_returns_is_told(folder):
    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(load_system(written(folder, GOOD, "robot.toml")))
        await asyncio.sleep(1)
        return [fault.detail for fault in faults if fault.kind == "task"]

    (told,) = run_virtual(main)
    assert told.startswith(
        "task 'sense' has returned: the predicates that it set are told nothing more, and are unknown"
    )


def test_the_emergency_of_a_file_is_called_besides_that_of_the_program(folder):
    called = []

    async def main(runtime):
        system = load_system(written(folder, f'emergency = "robot_code:rest"\n{GOOD}', "robot.toml"))
        await runtime.start(system)
        runtime.emergency("the hand")
        return system.tasks[0].__globals__["calls"]

    assert "rest" in run_virtual(main, emergency=lambda: called.append("program"))
    assert called == ["program"]


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [("", {}, 1.0), ("starved_after = 0.25\n", {}, 0.25), ("starved_after = 0.25\n", {"starved_after": 3}, 3)],
)
def test_a_file_says_how_long_a_turn_may_starve_others_where_the_runtime_does_not(folder, text, options, expected):
    async def main(runtime):
        await runtime.start(load_system(written(folder, f"{text}{GOOD}", "robot.toml")))
        return runtime.dispatcher.starved_after

    assert run_virtual(main, **options) == expected


def chain(levels):
    text = ""
    for level in range(levels):
        below = f"{{ ensemble = 'e{level + 1}' }}" if level < levels - 1 else "'robot_code:rest'"
        text += f"[ensembles.e{level}]\npolicy = [0]\n[ensembles.e{level}.actions]\ngo = {below}\n"
    return text


def test_a_hierarchy_of_a_hundred_levels_runs_and_deeper_ones_are_refused(folder):
    system = load_system(written(folder, chain(100), "robot.toml"))

    async def main(runtime):
        await runtime.start(system)
        for ensemble in system.ensembles.values():
            ensemble.publish_state(0)
        assert system.ensembles["e99"].action.ended == {"succeeded": 1}

    run_virtual(main)
    for levels in (101, 121, 1200):
        with refused(ConfigError):
            load_system(written(folder, chain(levels), "robot.toml"))


def test_ensembles_begin_with_the_system_unless_another_starts_them(folder):
    system = load_system(written(folder, chain(3), "robot.toml"))
    assert [ensemble.name for ensemble in system.top] == ["e0"]
    assert list(system.ensembles) == ["e0", "e1", "e2"]
    assert [child.name for child in system.children] == ["predicates", "e0"]
    assert [line.split(" (")[0] for line in system.tree().splitlines()] == [
        "e0",
        "  go: e1",
        "    go: e2",
        "      go: rest()",
    ]

    async def main(runtime):
        await runtime.start(system)
        return [channel.name for channel in runtime.channels]

    assert "e0/action" in run_virtual(main)  # not system/e0/action
