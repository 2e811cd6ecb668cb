"""Tasks that may say that they have succeeded though they were asked to end."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import lives_of, told
from hypothesis import example, given, settings, strategies as st

from mdm import Ensemble, P, PredicateManager, bind
from mdm.policies import DeterministicPolicy
from mdm.recording import Record
from mdm.testing import capture_decisions, replay, run_virtual

NAMES = "ABC"


class Task:
    """An async action; cancelled, it brakes for a while, and then returns, raises, or ends as cancelled."""

    def __init__(self, ends, seconds=3600.0):
        self.ends, self.seconds, self.said = list(ends), seconds, []

    async def __call__(self):
        try:
            await asyncio.sleep(self.seconds)
        except asyncio.CancelledError:
            brakes, how = self.ends.pop(0) if self.ends else (0.0, "cancelled")
            await asyncio.sleep(brakes)
            self.said.append(how)
            if how == "raises":
                raise ValueError("no brakes") from None
            if how == "cancelled":
                raise


def robot(tasks, *, may_succeed=True, predicates=None, timeout=None, **options):
    actions = {
        name: bind(task, may_succeed=may_succeed, timeout=timeout, then="decide", pause=0.5, attempts=2, grace=2.0)
        for name, task in zip(NAMES, tasks, strict=False)
    }
    policy = DeterministicPolicy(list(range(len(actions))), len(actions))
    return Ensemble("robot", policy=policy, actions=actions, predicates=predicates, **options)


def arrived():
    """Return a manager with a latch that a success of A sets."""
    predicates = PredicateManager()
    predicates.sensor("Left", initial=False)
    predicates.latch("Arrived", set=P("A.succeeded"), reset=P("Left"))
    return predicates


@pytest.mark.parametrize(
    ("how", "may", "status"),
    [("returns", True, "succeeded"), ("returns", False, "preempted"), ("cancelled", True, "preempted")],
)
def test_what_returns_after_its_cancellation_has_succeeded_where_it_may(how, may, status):
    predicates = arrived()
    both = robot([Task([(0.2, how)]), Task([])], may_succeed=may, predicates=predicates)

    async def main(runtime):
        await runtime.start(both)
        lives = lives_of(runtime)
        with capture_decisions(runtime) as decisions:
            both.publish_state(0)
            await asyncio.sleep(1)
            both.publish_state(1)
            await asyncio.sleep(60)
        assert told(lives) == [("A", "running"), ("A", status), ("B", "running")]
        assert len(decisions) == 2  # none because of the end, though it says decide
        return predicates.value("Arrived")

    assert run_virtual(main) == (status == "succeeded")


def test_a_success_that_comes_while_it_times_out_is_followed_as_any():
    alone = robot([Task([(0.2, "returns")] * 9)], timeout=1.0)

    async def main(runtime):
        await runtime.start(alone)
        lives = lives_of(runtime)
        with capture_decisions(runtime) as decisions:
            alone.publish_state(0)
            await asyncio.sleep(2.5)
        assert told(lives) == [("A", "running"), ("A", "succeeded"), ("A", "running")]
        first, second = decisions
        assert second.time - first.time == 1_700_000_000  # the time-out, its braking, and the pause

    run_virtual(main)


def test_a_safe_action_that_is_told_to_end_may_have_succeeded():
    still = bind(Task([(0.0, "returns")]), may_succeed=True)
    policy = DeterministicPolicy([0], 1)
    safe = Ensemble("robot", policy=policy, actions={"Rest": still}, safe_action="Rest", safe_timeout=1.0)

    async def main(runtime):
        await runtime.start(safe)
        safe.safety.endanger("mine", "", 0)
        await asyncio.sleep(5)
        return safe.action.statistics().safe_ended

    assert run_virtual(main) == {"succeeded": 1}


def test_one_that_was_replaced_by_its_group_is_preempted_whatever_it_says():
    tasks = [Task([(0.2, "returns")]), Task([])]
    actions = {name: bind(task, may_succeed=True, group="wheels") for name, task in zip(NAMES, tasks, strict=False)}
    grouped = Ensemble("robot", policy=DeterministicPolicy([0, 1], 2), actions=actions)

    async def main(runtime):
        await runtime.start(grouped)
        lives = lives_of(runtime)
        grouped.publish_state(0)
        await asyncio.sleep(1)
        grouped.publish_state(1)
        await asyncio.sleep(60)
        return told(lives)

    assert run_virtual(main) == [("A", "running"), ("A", "preempted"), ("B", "running")]
    assert tasks[0].said == ["returns"]


pauses = st.sampled_from([0.0, 0.01, 0.05, 0.3, 1.0, 3.0])
steps = st.lists(st.tuples(st.integers(0, 2), pauses), min_size=1, max_size=12)
ends = st.lists(st.tuples(st.sampled_from([0.0, 0.1, 1.0, 5.0]), st.sampled_from(["returns", "raises", "cancelled"])))
BESIDE = [(1, 0.0), (0, 3.0), (1, 0.0), (0, 0.0), (1, 0.0)]
"""The last decision finds the task of A over, and that of B, which was abandoned, not."""


@settings(deadline=None, max_examples=12)
@given(steps, st.tuples(ends, ends, ends), st.booleans(), st.booleans())
@example(BESIDE, ([], [(5.0, "returns")], []), True, False)
def test_each_life_ends_as_its_task_says_and_is_replayed_so(tmp_path_factory, steps, ends, may_succeed, safe):
    """Nothing is decided but on the states that are told, whatever the tasks say; and a replay has the same lives."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    tasks = [Task(each) for each in ends]

    def made(tasks):
        return robot(tasks, may_succeed=may_succeed, on_failed_action="continue", predicates=arrived())

    async def main(runtime):
        one = made(tasks)
        await runtime.start(one)
        lives = lives_of(runtime)
        with capture_decisions(runtime) as decisions:
            for state, seconds in steps:
                one.publish_state(state)
                await asyncio.sleep(seconds)
            if safe:
                one.safety.endanger("mine", "", 0)
            await asyncio.sleep(20)
        return told(lives), len(decisions), [tuple(task.said) for task in tasks]

    lives, decisions, said = run_virtual(main, record=path, log=False)
    expected = {"returns": "succeeded" if may_succeed else "preempted", "raises": "failed", "cancelled": "preempted"}
    for name, ways in zip(NAMES, said, strict=True):
        own = [status for action, status in lives if action == name and status not in {"running", "abandoned"}]
        if "abandoned" not in [status for action, status in lives if action == name]:
            # A cancellation before the first step ends a task that has nothing to say.
            assert [status for status in own if status != "preempted"] == [
                expected[how] for how in ways if expected[how] != "preempted"
            ]
    if "abandoned" not in {status for _, status in lives}:  # else one is not begun beside itself, and is decided again
        assert decisions <= len(steps)
    assert replay(path, made([Task([]) for _ in NAMES])) == decisions
    recorded = [each.message for each in Record(path).messages(["lives"])]
    assert [(life.action, life.status) for life in recorded][: len(lives)] == lives


@pytest.mark.slow
@settings(deadline=None, max_examples=100)
@given(steps, st.tuples(ends, ends, ends), st.booleans(), st.booleans())
def test_many_more_lives_end_as_their_tasks_say(tmp_path_factory, steps, ends, may_succeed, safe):
    test_each_life_ends_as_its_task_says_and_is_replayed_so.hypothesis.inner_test(
        tmp_path_factory, steps, ends, may_succeed, safe
    )
