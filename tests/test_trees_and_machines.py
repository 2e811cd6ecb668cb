"""Trees and state machines of other libraries as actions: what is each library's own."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import py_trees
import pytest
import smach
from action_lives import robot
from errands import ADAPTERS, TREES
from patience import PATIENCE
from py_trees.common import Status
from sentences import refused
from statemachine import State, StateMachine
from statemachine.statemachine import StateChart
from transitions.extensions.asyncio import AsyncMachine

from mdm import Runtime, bind, run
from mdm.messages import ActionLife


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
        with refused(LookupError):
            await watched(library, {"Stay": stay, "Watch": watch, "Leave": leave})()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert log == ["stay ends"]


@pytest.mark.parametrize("library", TREES)
def test_work_that_is_cancelled_elsewhere_has_not_failed(library):
    """It is no failure that another leaf could make good."""

    async def watch():
        raise asyncio.CancelledError

    async def leave():
        log.append("leave begins")

    async def stay():
        await asyncio.sleep(3600)

    log = []

    async def main():
        with pytest.raises(asyncio.CancelledError):
            await watched(library, {"Stay": stay, "Watch": watch, "Leave": leave})()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert log == []


@pytest.mark.parametrize("library", TREES)
@pytest.mark.parametrize("result", [None, True, 0, 1, ""])
def test_what_work_returns_is_success_but_for_false(library, result):
    log = []

    async def watch():
        return result

    async def leave():
        log.append("leave begins")

    async def main():
        await watched(library, {"Stay": watch, "Watch": watch, "Leave": leave})()

    run(main, virtual=True)
    assert log == []


@pytest.mark.parametrize("library", TREES)
def test_an_error_of_work_that_was_halted_is_not_lost(library):
    """The tree is elsewhere by then, and comes to a good end."""

    async def stay():
        try:
            await asyncio.sleep(3600)
        finally:
            raise LookupError("the brakes are worn")

    async def watch():
        await asyncio.sleep(1)
        return False

    async def leave():
        await asyncio.sleep(5)

    async def main():
        with refused(LookupError):
            await watched(library, {"Stay": stay, "Watch": watch, "Leave": leave})()
        assert asyncio.get_running_loop().time() == 6.0

    run(main, virtual=True)


def test_work_begins_when_all_that_was_cancelled_has_ended():
    """Also what was cancelled while it waited."""
    log = []

    async def end(name, seconds):
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(seconds)
            log.append(name)

    async def begin():
        log.append("begins")

    async def main():
        tasks = ADAPTERS["py_trees"].Tasks()
        first, second = (tasks.begin(lambda name=name: end(name, 2)) for name in ("first", "second"))
        await asyncio.sleep(0)
        first.cancel()
        third = tasks.begin(begin)
        await asyncio.sleep(1)
        second.cancel()
        await third
        assert asyncio.get_running_loop().time() == 3.0

    run(main, virtual=True)
    assert log == ["first", "second", "begins"]


def in_cpp(tree, **work):
    """Return an action: a tree of BehaviorTree.CPP."""
    text = f"""<root BTCPP_format="4"><BehaviorTree ID="tree">{tree}</BehaviorTree></root>"""
    return ADAPTERS["behaviortree_cpp"].tree_action(text, work)


@pytest.mark.parametrize("names", [("one", "other"), ("both", "both")])
def test_leaves_of_one_kind_have_work_of_their_own(names):
    seconds, log = [1, 5], []

    async def work():
        took = seconds.pop(0)
        await asyncio.sleep(took)
        log.append(took)

    async def main():
        leaves = "".join(f"""<Work name="{name}"/>""" for name in names)
        await in_cpp(f"<Parallel>{leaves}</Parallel>", Work=work)()
        assert asyncio.get_running_loop().time() == 5.0
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert log == [1, 5]


@pytest.mark.parametrize("names", [("a", "c"), ("a", "a")])
def test_a_leaf_of_one_kind_is_halted_alone(names):
    begun, log = [], []

    async def work():
        number = len(begun)
        begun.append(number)
        try:
            await asyncio.sleep([10, 20][number])
            log.append(f"{number} has ended")
        finally:
            log.append(f"{number} is over at {asyncio.get_running_loop().time():g}")

    async def fail():
        await asyncio.sleep(1)
        return False

    async def main():
        one, other = (f"""<Work name="{name}"/>""" for name in names)
        halted = f"""<Parallel failure_count="1">{one}<Fail name="fail"/></Parallel>"""
        await in_cpp(f"<Parallel><ForceSuccess>{halted}</ForceSuccess>{other}</Parallel>", Work=work, Fail=fail)()

    run(main, virtual=True)
    assert log == ["0 is over at 1", "1 has ended", "1 is over at 20"]


def test_the_leaves_that_failed_last_are_named():
    """One that did better when it was tried again has not failed."""
    results = [False, True]

    async def attempt():
        return results.pop(0)

    async def fail():
        return False

    tree = """<Sequence><RetryUntilSuccessful num_attempts="2"><Try name="try"/></RetryUntilSuccessful>
      <Fail name="fail"/></Sequence>"""
    with refused(RuntimeError):
        run(in_cpp(tree, Try=attempt, Fail=fail), virtual=True)
    with refused(RuntimeError):
        run(in_cpp("<AlwaysFailure/>"), virtual=True)


def test_an_error_is_raised_though_the_tree_makes_good_for_it():
    async def fail():
        raise LookupError("lost sight")

    with refused(LookupError):
        run(in_cpp("""<Fallback><Fail name="fail"/><AlwaysSuccess/></Fallback>""", Fail=fail), virtual=True)


class Counting(py_trees.behaviour.Behaviour):
    """Succeeds in its fifth tick."""

    ticks = 0

    def update(self):
        self.ticks += 1
        return Status.SUCCESS if self.ticks == 5 else Status.RUNNING

    def terminate(self, new_status):
        self.end = new_status

    def shutdown(self):
        self.is_shut_down = True


def test_leaves_of_every_kind_are_told_of_a_pre_emption():
    counting = Counting("count")

    async def main():
        task = asyncio.ensure_future(ADAPTERS["py_trees"].tree_action(lambda: counting, period=1.0)())
        await asyncio.sleep(2.5)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()

    run(main, virtual=True)
    assert (counting.ticks, counting.end, counting.is_shut_down) == (3, Status.INVALID, True)


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
        with refused(RuntimeError):
            asyncio.run(ADAPTERS[library].tree_action(*arguments)())


def repeated(library, work):
    """Return an action that does work until the third time, with a leaf beside it that takes an hour."""
    adapter = ADAPTERS[library]
    if library == "behaviortree_cpp":
        text = """<root BTCPP_format="4"><BehaviorTree ID="tree"><Parallel success_count="1" failure_count="2">
          <ForceSuccess><KeepRunningUntilFailure><Try name="try"/></KeepRunningUntilFailure></ForceSuccess>
          <Stay name="stay"/></Parallel></BehaviorTree></root>"""
        return adapter.tree_action(text, work)

    def make():
        once = adapter.Work("try", work["Try"])
        again = py_trees.decorators.Inverter("until it fails", py_trees.decorators.Repeat("again", once, -1))
        both = py_trees.composites.Parallel("both", policy=py_trees.common.ParallelPolicy.SuccessOnOne())
        both.add_children([again, adapter.Work("stay", work["Stay"])])
        return both

    return adapter.tree_action(make)


@pytest.mark.parametrize("library", TREES)
def test_work_is_repeated_as_soon_as_it_has_ended(library):
    times = []

    async def once():
        await asyncio.sleep(1)
        times.append(asyncio.get_running_loop().time())
        return len(times) < 3

    async def stay():
        await asyncio.sleep(3600)

    async def main():
        await repeated(library, {"Try": once, "Stay": stay})()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(main, virtual=True)
    assert times == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("period", [0, -1.0, float("nan")])
def test_a_period_of_no_time_is_refused(period):
    action = ADAPTERS["py_trees"].tree_action(lambda: Counting("count"), period=period)
    with refused(ValueError):
        run(action, virtual=True)


def test_a_machine_that_keeps_its_errors_is_refused():
    class Chart(StateChart):
        one = State(initial=True)
        two = State(final=True)
        go = one.to(two)

    with refused(TypeError):
        asyncio.run(ADAPTERS["statemachine"].machine_action(Chart)())


def test_a_machine_without_async_callbacks_is_refused():
    class Switch(StateMachine):
        off = State(initial=True)
        on = State(final=True)
        turn = off.to(on)

    with refused(TypeError):
        asyncio.run(ADAPTERS["statemachine"].machine_action(Switch)())


@pytest.mark.parametrize("queued", [False, True, "model"])
def test_a_machine_of_transitions_that_does_not_begin_fails(queued):
    def make():
        machine = AsyncMachine(states=["ready", "busy"], initial="ready", auto_transitions=False, queued=queued)
        machine.add_transition("begin", "ready", "busy", conditions=lambda: False)
        return machine

    with refused(RuntimeError):
        run(ADAPTERS["transitions"].machine_action(make), virtual=True)


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
def test_a_machine_of_transitions_may_wait_for_events_from_outside(queued):
    """And its feedback comes when a state is entered, before what that does first."""
    told, machines = [], []

    async def unlock():
        await asyncio.sleep(2)

    def make():
        states = ["ready", {"name": "closed", "on_enter": [unlock]}, {"name": "opened", "final": True}]
        machine = AsyncMachine(states=states, initial="ready", auto_transitions=False, queued=queued)
        machine.add_transition("begin", "ready", "closed")
        machine.add_transition("open", "closed", "opened")
        machines.append(machine)
        return machine

    async def main():
        def feedback(name):
            told.append((name, asyncio.get_running_loop().time()))

        action = ADAPTERS["transitions"].machine_action(make, feedback, succeeds=("opened",))
        task = asyncio.ensure_future(action())
        await asyncio.sleep(10)
        assert not task.done()
        await machines[0].open()
        await task
        task = asyncio.ensure_future(action())
        await asyncio.sleep(10)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()

    run(main, virtual=True)
    assert told == [("closed", 0.0), ("closed", 10.0)]


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


def test_machines_of_smach_keep_no_thread_from_others():
    """Each waits for the other, and those of the event loop would be too few."""
    adapter = ADAPTERS["smach"]

    async def main():
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(1))
        here, there = asyncio.Event(), asyncio.Event()

        async def meet(mine, other):
            mine.set()
            await other.wait()
            await asyncio.to_thread(int)

        pairs = ((here, there), (there, here))
        actions = [
            adapter.machine_action(lambda pair=pair: smach_machine(adapter.Work(lambda: meet(*pair)))) for pair in pairs
        ]
        async with asyncio.timeout(PATIENCE):
            await asyncio.gather(*(action() for action in actions))

    asyncio.run(main())


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


def test_a_state_of_smach_that_does_not_look_is_abandoned():
    begun, leave = threading.Event(), threading.Event()

    class Deaf(smach.State):
        def __init__(self):
            super().__init__(outcomes=["succeeded"])

        def execute(self, userdata):
            begun.set()
            leave.wait()
            return "succeeded"

    async def main():
        action = ADAPTERS["smach"].machine_action(lambda: smach_machine(Deaf()))
        ensemble = robot({"A": bind(action, grace=0.01)})
        async with Runtime(log=None) as runtime:
            await runtime.start(ensemble)
            lives = runtime.channel("robot/lives", ActionLife).stream()
            ensemble.publish_state(0)
            await asyncio.to_thread(begun.wait)
            ensemble.stop()
            try:
                assert [(await anext(lives)).status for _ in range(2)] == ["running", "abandoned"]
            finally:
                leave.set()

    asyncio.run(main())


def test_a_machine_of_smach_that_is_not_consistent_fails(caplog):
    state = smach.State(outcomes=["succeeded"])
    action = ADAPTERS["smach"].machine_action(lambda: smach_machine(state, {"succeeded": "nowhere"}))
    with refused(RuntimeError):
        asyncio.run(action())
    assert "consistency check failed" in caplog.text
