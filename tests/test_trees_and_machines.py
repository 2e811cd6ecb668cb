"""Trees and state machines of other libraries as actions, and ensembles within them: the examples' adapters."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import threading
from contextlib import contextmanager
from importlib import import_module, metadata

import py_trees
import pytest
import smach
from action_lives import lives_of, told
from places import EXAMPLES, ROOT
from py_trees.common import Status
from statemachine import State, StateMachine
from statemachine.statemachine import StateChart
from transitions.extensions.asyncio import AsyncMachine

from mdm import Ensemble, Runtime, run
from mdm.messages import ActionLife
from mdm.policies import DeterministicPolicy
from mdm.testing import run_virtual

FOLDER = EXAMPLES / "actions"


@contextmanager
def importable():
    sys.path.insert(0, str(FOLDER))
    try:
        yield
    finally:
        sys.path.remove(str(FOLDER))


NAMES = ("py_trees", "behaviortree_cpp", "statemachine", "transitions", "smach")
TREES = NAMES[:2]
with importable():
    errand = import_module("errand")
    within = import_module("ensemble_within")
    ADAPTERS = {name: import_module(f"{name}_action") for name in NAMES}

libraries = pytest.mark.parametrize("library", NAMES)
STEPS = ("approach", "take", "bring", "put_down")


class Scene:
    """A robot whose errand is done by one library, in virtual time where the library knows none of its own."""

    def __init__(self, library):
        self.library = library
        self.virtual = library != "smach"  # which waits in a thread for what takes time
        self.lines = []
        self.told = asyncio.Queue()
        self.robot = errand.Robot(pace=1.0 if self.virtual else 0.002, tell=self.tell)
        self.fetch = ADAPTERS[library].fetch

    def tell(self, line):
        self.lines.append(line)
        self.told.put_nowait(line)

    def step(self, name):
        self.tell(f"step: {name}")

    @property
    def steps(self):
        return tuple(line.removeprefix("step: ") for line in self.lines if line.startswith("step"))

    async def until(self, line):
        while not (await self.told.get()).startswith(line):
            pass


def played(library, script):
    """Run a script beside the errand; return the scene and the lives, when all tasks and threads have ended."""
    threads = set(threading.enumerate())

    async def main():
        scene = Scene(library)
        before = asyncio.all_tasks()
        helper = errand.Helper(scene.robot, scene.fetch)
        async with Runtime(log=None) as runtime:
            lives = lives_of(runtime, "helper")
            runtime.channel("helper/lives", ActionLife).subscribe(
                lambda life: scene.tell(f"{life.action} {life.status} {life.detail}")
            )
            await script(scene, helper, runtime)
        assert asyncio.all_tasks() == before
        assert not scene.robot.is_moving
        return scene, lives

    scene, lives = run(main, virtual=library != "smach")
    assert set(threading.enumerate()) <= threads
    return scene, lives


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
    assert "GripperError: the gripper is jammed" in lives[-1].detail
    assert scene.steps == STEPS[:2]
    assert capfd.readouterr() == ("", "")


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
    *said, last_said = read_page().partition("```text\n")[2].partition("```")[0].splitlines()
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
    errand_as_tree, boards, deciding = re.findall(r"```python\n(.*?)```", read_page(), re.DOTALL)
    assert errand_as_tree in (FOLDER / "py_trees_action.py").read_text(encoding="utf-8")
    assert deciding in (FOLDER / "ensemble_within.py").read_text(encoding="utf-8")
    scope = {}
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


# -- Trees -----------------------------------------------------------------------------------------------------------


def watched(library, work):
    """Return an action: the leaf Stay beside the leaf Watch, and where one of them fails the leaf Leave."""
    adapter = ADAPTERS[library]
    if library == "behaviortree_cpp":
        text = """<root BTCPP_format="4"><BehaviorTree ID="tree"><Fallback>
          <Parallel failure_count="1"><Stay name="stay"/><Watch name="watch"/></Parallel><Leave name="leave"/>
        </Fallback></BehaviorTree></root>"""
        return adapter.tree_action(text, work)

    def make():
        leaves = {name: adapter.Work(name, function) for name, function in work.items()}
        both = py_trees.composites.Parallel("both", policy=py_trees.common.ParallelPolicy.SuccessOnAll())
        both.add_children([leaves["Stay"], leaves["Watch"]])
        root = py_trees.composites.Selector("root", memory=True)
        root.add_children([both, leaves["Leave"]])
        return root

    return adapter.tree_action(make)


@pytest.mark.parametrize("library", TREES)
@pytest.mark.parametrize("cut", [False, True])
def test_a_leaf_begins_when_what_was_halted_has_ended(library, cut):
    """Also where it is cut off while it waits for that."""
    log = []

    async def stay():
        log.append("stay begins")
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(2)
            log.append("stay ends")

    async def watch():
        await asyncio.sleep(5)
        return False

    async def leave():
        log.append("leave begins")

    async def main():
        task = asyncio.ensure_future(watched(library, {"Stay": stay, "Watch": watch, "Leave": leave})())
        await asyncio.sleep(6)
        if cut:
            task.cancel()
        await asyncio.wait([task])
        assert task.cancelled() is cut
        assert asyncio.get_running_loop().time() == 7.0
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert log == ["stay begins", "stay ends", "leave begins"][: 2 if cut else 3]


@pytest.mark.parametrize("library", TREES)
def test_an_error_of_one_leaf_ends_those_beside_it(library):
    log = []

    async def stay():
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(1)
            log.append("stay ends")

    async def watch():
        await asyncio.sleep(1)
        raise LookupError("lost sight")

    async def leave():
        log.append("leave begins")

    async def main():
        with pytest.raises(LookupError, match="lost sight"):
            await watched(library, {"Stay": stay, "Watch": watch, "Leave": leave})()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert log == ["stay ends"]


class Counting(py_trees.behaviour.Behaviour):
    """Succeeds in its fifth tick."""

    ticks = 0

    def update(self):
        self.ticks += 1
        return Status.SUCCESS if self.ticks == 5 else Status.RUNNING


def test_leaves_that_look_at_something_are_ticked_by_the_period():
    adapter = ADAPTERS["py_trees"]

    async def main():
        await adapter.tree_action(lambda: Counting("count"), period=0.5)()
        assert asyncio.get_running_loop().time() == 2.0

    run(main, virtual=True)
    asyncio.run(ADAPTERS["behaviortree_cpp"].tree_action(SLEEP.format(5), {}, period=0.002)())


SLEEP = """<root BTCPP_format="4"><BehaviorTree ID="tree"><Sleep msec="{}"/></BehaviorTree></root>"""


def test_a_tree_that_would_wait_for_ever_says_so():
    for library, tree in (("py_trees", lambda: Counting("count")), ("behaviortree_cpp", SLEEP.format(3600000))):
        arguments = (tree, {}) if library == "behaviortree_cpp" else (tree,)
        with pytest.raises(RuntimeError, match="none of its leaves waits for work: give it a period"):
            asyncio.run(ADAPTERS[library].tree_action(*arguments)())


# -- State machines --------------------------------------------------------------------------------------------------


def test_a_machine_that_keeps_its_errors_is_refused():
    class Chart(StateChart):
        one = State(initial=True)
        two = State(final=True)
        go = one.to(two)

    with pytest.raises(TypeError, match="keeps errors to itself: it needs catch_errors_as_events = False"):
        asyncio.run(ADAPTERS["statemachine"].machine_action(Chart)())


def test_a_machine_may_wait_for_events_from_outside():
    class Door(StateMachine):
        closed = State(initial=True)
        opened = State(final=True)
        open = closed.to(opened)

        async def on_enter_closed(self):
            self.has_begun = True

    doors = []

    def make():
        doors.append(Door())
        return doors[-1]

    async def main():
        task = asyncio.ensure_future(ADAPTERS["statemachine"].machine_action(make, succeeds=("opened",))())
        await asyncio.sleep(10)
        assert not task.done()
        await doors[0].open()
        await task
        task = asyncio.ensure_future(ADAPTERS["statemachine"].machine_action(make, succeeds=("opened",))())
        await asyncio.sleep(10)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()

    run(main, virtual=True)


@pytest.mark.parametrize("queued", [False, True, "model"])
def test_a_trigger_of_transitions_swallows_no_cancellation(queued):
    log = []

    class Machine(AsyncMachine):
        def __init__(self):
            states = ["waiting", "first", "second", {"name": "done", "final": True}]
            super().__init__(states=states, initial="waiting", queued=queued)
            self.add_transition("begin", "waiting", "first")
            self.add_transition("on", "first", "second")
            self.add_transition("on", "second", "done")

        async def on_enter_first(self):
            await self.on()

        async def on_enter_second(self):
            log.append("begins")
            try:
                await asyncio.sleep(10)
            finally:
                await asyncio.sleep(1)
                log.append("ends")
            await self.on()

    async def main():
        action = ADAPTERS["transitions"].machine_action(Machine)
        task = asyncio.ensure_future(action())
        await asyncio.sleep(5)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        assert asyncio.get_running_loop().time() == 6.0
        await action()

    run(main, virtual=True)
    assert log == ["begins", "ends"] * 2


def smach_machine(state, transitions=None):
    machine = smach.StateMachine(outcomes=["succeeded", "failed", "preempted"])
    with machine:
        smach.StateMachine.add("only", state, transitions)
    return machine


def test_a_state_of_smach_that_polls_ends_when_asked():
    begun, ended = threading.Event(), threading.Event()

    class Polling(smach.State):
        def __init__(self):
            super().__init__(outcomes=["succeeded", "preempted"])
            self.tick = threading.Event()

        def execute(self, userdata):
            begun.set()
            while not self.preempt_requested():
                self.tick.wait(0.001)
            self.service_preempt()
            ended.set()
            return "preempted"

    async def main():
        action = ADAPTERS["smach"].machine_action(lambda: smach_machine(Polling()))
        task = asyncio.ensure_future(action())
        await asyncio.to_thread(begun.wait)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        assert ended.is_set()

    asyncio.run(main())


def test_a_machine_of_smach_that_is_not_consistent_fails(caplog):
    state = smach.State(outcomes=["succeeded"])
    action = ADAPTERS["smach"].machine_action(lambda: smach_machine(state, {"succeeded": "nowhere"}))
    with pytest.raises(RuntimeError, match="the machine ended with None"):
        asyncio.run(action())
    assert "consistency check failed" in caplog.text


# -- Ensembles within trees and machines -----------------------------------------------------------------------------

MAKERS = pytest.mark.parametrize("make", [within.as_leaf, within.as_state])
CLEANED = ["searches", "cleans", "searches", "cleans", "searches", "brushes off", "docks"]


def test_the_example_with_an_ensemble_within():
    done = subprocess.run(
        [sys.executable, "-W", "error", str(FOLDER / "ensemble_within.py")],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = [f"  {line}" for line in CLEANED]
    assert done.stdout.splitlines() == ["as part of a tree:", *lines, "as part of a state machine:", *lines]


@MAKERS
def test_an_ensemble_within_achieves_something(make):
    lines = []

    async def main(runtime):
        cleaner = within.Cleaner(lines.append)
        await runtime.start(cleaner.predicates)
        await make(runtime, cleaner)()
        assert lines == CLEANED
        assert cleaner.ensemble.life == "stopped"
        await make(runtime, cleaner)()  # nothing is left to do but this
        assert lines == [*CLEANED, "docks"]
        cleaner.rooms.append("cellar")
        cleaner.is_done.set(False)
        await make(runtime, cleaner)()
        assert lines[len(CLEANED) + 1 :] == CLEANED[:2] + CLEANED[-3:]
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run_virtual(main)


@MAKERS
def test_an_ensemble_within_that_goes_safe_fails(make):
    lines = []

    async def main(runtime):
        cleaner = within.Cleaner(lines.append)

        async def fail():
            await asyncio.sleep(1)
            raise LookupError("the broom is gone")

        cleaner.clean = fail
        cleaner.ensemble = Ensemble(
            "cleaner",
            policy=DeterministicPolicy([0, 1]),
            predicates=cleaner.predicates,
            states=cleaner.ensemble.state.factors,
            actions={"Search": cleaner.search, "Clean": fail},
            safe_action=lambda: lines.append("brushes off"),
        )
        await runtime.start(cleaner.predicates)
        with pytest.raises(RuntimeError, match="failed at rooms|ended in stuck"):
            await make(runtime, cleaner)()
        assert lines[:2] == ["searches", "brushes off"]
        assert cleaner.ensemble.life == "stopped"
        cleaner.is_dirty.set(False)
        cleaner.rooms = ["office"]
        await make(runtime, cleaner)()  # what was safe then is nothing to this run
        assert lines[-1] == "docks"

    run_virtual(main)


@MAKERS
@pytest.mark.parametrize("seconds", [0.0, 0.5, 2.5, 4.0, 30.0])
@pytest.mark.parametrize("how", ["decision", "end"])
def test_an_ensemble_within_an_action_is_pre_empted_with_it(make, seconds, how):
    """A tree or machine is the action of an ensemble, and has one within: below ends first."""
    lines = []

    async def main(runtime):
        cleaner = within.Cleaner(lines.append)
        await runtime.start(cleaner.predicates)
        top = Ensemble(
            "top",
            policy=DeterministicPolicy([0, 1]),
            actions={"CleanUp": make(runtime, cleaner), "Rest": lambda: lines.append("rests")},
        )
        await runtime.start(top)
        lives = lives_of(runtime, "top")
        below = lives_of(runtime, "cleaner")
        top.publish_state(0)
        await asyncio.sleep(seconds)
        if how == "end":
            await runtime.stop(top)
        else:
            top.publish_state(1)
            await asyncio.sleep(1)
        end = "succeeded" if seconds == 30.0 else "preempted"
        assert told(lives)[:2] == [("CleanUp", "running"), ("CleanUp", end)]
        assert {status for _, status in told(below)[-1:]} <= {"preempted", "succeeded"}
        assert cleaner.ensemble.life in ({"created", "stopped"} if seconds == 0.0 else {"stopped"})
        assert seconds == 0.0 or lines[-1] == (
            "rests" if how == "decision" else "docks" if seconds == 30.0 else "brushes off"
        )
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run_virtual(main)
