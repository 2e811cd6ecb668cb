"""What each adapter of the examples about actions promises: results, errors, pre-emption, feedback."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from importlib import metadata

import blocks
import pytest
from action_lives import told
from errands import FOLDER, STEPS, Scene, errand, libraries, played
from places import ROOT

from mdm import run


@libraries
def test_success(library):
    async def script(scene, helper, runtime):
        await runtime.start(helper.ensemble)
        await scene.until("Fetch succeeded")
        assert helper.ensemble.predicates.value("IsBringing") is False

    scene, lives = played(library, script)
    assert told(lives)[:2] == [("Fetch", "running"), ("Fetch", "succeeded")]  # and once more: it brings no box now
    assert scene.steps[:4] == STEPS


@libraries
def test_failure(library):
    async def script(scene, helper, runtime):
        scene.robot.boxes = 0
        await runtime.start(helper.ensemble)
        await scene.until("Fetch failed")

    scene, lives = played(library, script)
    assert told(lives) == [("Fetch", "running"), ("Fetch", "failed")]
    assert scene.steps == STEPS[:2]
    assert "RuntimeError" in lives[-1].detail
    assert any(word in lives[-1].detail for word in ("take", "no_box", "with failed"))


@libraries
def test_an_exception_is_the_action_s_own(library, capfd):
    async def script(scene, helper, runtime):
        scene.robot.is_jammed = True
        await runtime.start(helper.ensemble)
        await scene.until("Fetch failed")

    scene, lives = played(library, script)
    assert told(lives) == [("Fetch", "running"), ("Fetch", "failed")]
    assert lives[-1].detail.startswith("GripperError: the gripper is jammed")
    assert scene.steps == STEPS[:2]
    output, errors = capfd.readouterr()  # of the library's own there is nothing
    assert output == ""
    assert errors.startswith("mdm: ensemble 'helper': action 'Fetch' failed: GripperError: the gripper is jammed (at ")
    assert errors.count("\n") == 1


@libraries
def test_pre_emption_in_the_middle(library):
    """The action has ended when the robot stands, and the next one begins then."""

    async def script(scene, helper, runtime):
        await runtime.start(helper.ensemble)
        await scene.until("half way to the shelf")
        helper.is_called.set(True)
        await scene.until("Come succeeded")

    scene, lives = played(library, script)
    ends = [("Fetch", "running"), ("Fetch", "preempted"), ("Come", "running"), ("Come", "succeeded")]
    assert told(lives) == ends
    assert scene.steps == STEPS[:1]
    braked, preempted, come = (
        next(index for index, line in enumerate(scene.lines) if line.startswith(start))
        for start in ("braked", "Fetch preempted", "Come running")
    )
    assert braked < preempted < come


@libraries
def test_feedback_is_decided_on(library):
    """The robot brings what it holds, although it was called; and once, not once more for the feedback's decision."""

    async def script(scene, helper, runtime):
        await runtime.start(helper.ensemble)
        await scene.until("step: bring")
        helper.is_called.set(True)
        await scene.until("Come succeeded")

    _, lives = played(library, script)
    assert told(lives) == [("Fetch", "running"), ("Fetch", "succeeded"), ("Come", "running"), ("Come", "succeeded")]


@libraries
def test_feedback_comes_from_outside_of_the_action(library):
    """What an action brings about in its own task counts as its last step."""

    async def main():
        scene, tasks = Scene(library), []
        await scene.fetch(scene.robot, lambda _: tasks.append(asyncio.current_task()))()
        assert tasks == [None] * len(STEPS)

    run(main, virtual=library != "smach")


@libraries
def test_two_runs_of_an_action_have_nothing_in_common(library):
    async def main():
        scene = Scene(library)
        before = asyncio.all_tasks()
        action = scene.fetch(scene.robot, scene.step)
        first, second = (asyncio.ensure_future(action()) for _ in range(2))
        for _ in range(2):
            await scene.until("half way to the shelf")
        first.cancel()
        await second
        assert first.cancelled()
        braked = scene.lines.count("braked")
        assert braked == 1 or (library == "smach" and braked == 0)  # in real time it may be between two drives by then
        assert scene.lines.count("at the dock") == 1
        assert asyncio.all_tasks() == before

    run(main, virtual=library != "smach")


@libraries
@pytest.mark.parametrize("how", ["stop", "end"])
def test_the_end_of_the_ensemble_is_a_pre_emption(library, how):
    async def script(scene, helper, runtime):
        await runtime.start(helper.ensemble)
        await scene.until("half way to the dock")
        if how == "stop":
            helper.ensemble.stop()
            await scene.until("Fetch preempted")

    scene, lives = played(library, script)
    assert told(lives) == [("Fetch", "running"), ("Fetch", "preempted")]
    assert "braked" in scene.lines


@libraries
@pytest.mark.parametrize("when", [*STEPS, "at once", "soon"])
def test_a_cancelled_action_is_cancelled(library, when):
    """Nothing takes the cancellation for its own, and nothing goes on."""

    async def main():
        scene = Scene(library)
        before = asyncio.all_tasks()
        task = asyncio.ensure_future(scene.fetch(scene.robot, scene.step)())
        if when == "soon":
            await asyncio.sleep(0)
        elif when != "at once":
            await scene.until(f"step: {when}")
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        assert asyncio.all_tasks() == before
        assert not scene.robot.is_moving
        steps = scene.steps
        await asyncio.sleep(20 * scene.robot.pace)
        assert scene.steps == steps

    run(main, virtual=library != "smach")


@libraries
def test_an_error_on_the_way_to_the_end_is_a_failure(library):
    """A robot that does not brake has not merely been pre-empted."""

    async def script(scene, helper, runtime):
        async def drive(place):
            scene.tell("drives")
            try:
                await asyncio.sleep(3600)
            finally:
                raise errand.GripperError("the brakes are worn")

        scene.robot.drive = drive
        await runtime.start(helper.ensemble)
        await scene.until("drives")
        helper.ensemble.stop()
        await scene.until("Fetch failed")

    _, lives = played(library, script)
    assert "GripperError: the brakes are worn" in lives[-1].detail


def read_page():
    return (ROOT / "docs" / "actions.md").read_text(encoding="utf-8")


@libraries
def test_the_example_prints_what_the_page_says(library):
    *said, last_said = blocks.texts("docs/actions.md", "text")[0].splitlines()
    done = subprocess.run(
        [sys.executable, "-W", "error", str(FOLDER / f"{library}_action.py")],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (done.returncode, done.stderr) == (0, "")
    *lines, last = done.stdout.splitlines()
    assert lines == said
    assert last == last_said if library == "py_trees" else last.startswith("Fetch failed RuntimeError: ")


def test_the_page_quotes_the_examples():
    _, errand_as_tree, boards, program, deciding = blocks.texts("docs/actions.md", "python")
    assert errand_as_tree in (FOLDER / "py_trees_action.py").read_text(encoding="utf-8")
    assert deciding in (FOLDER / "ensemble_within.py").read_text(encoding="utf-8")
    scope = {}
    exec(program, scope)
    assert asyncio.iscoroutinefunction(scope["dock"])
    exec(boards, scope)
    assert {robot: board.place for robot, board in scope["boards"].items()} == {
        "ada": "the dock of ada",
        "bob": "the dock of bob",
    }
    for board in scope["boards"].values():
        board.unregister()


def test_the_page_names_the_versions_that_are_tested():
    page = read_page()
    for package, name in (
        ("py_trees", "2.6"),
        ("behaviortreepy", "0.1.4"),
        ("python-statemachine", "3.2"),
        ("transitions", "0.9"),
        ("standalone-smach", "0.0.9"),
    ):
        assert metadata.version(package).startswith(name)
        assert f" {name}" in page, package
