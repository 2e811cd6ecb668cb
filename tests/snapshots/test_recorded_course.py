"""The course of a record's decisions: which of them stand for all, and what is told of each."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from decided import ensemble
from hypothesis import given, strategies as st

import mdm
from mdm.beliefs import Support
from mdm.messages import Decision
from mdm.models import Factor, Space
from mdm.recording import Record
from mdm.snapshots import RecordedRun
from mdm.snapshots.recorded import POINTS, course_of, sampled
from mdm.testing import run_virtual


@given(
    st.lists(st.integers(0, 1_000), max_size=80).map(sorted),
    st.integers(0, 1_000),
    st.integers(0, 1_000),
    st.integers(2, 40),
)
def test_each_part_of_the_time_has_its_last_decision_and_the_time_before_one(times, one, other, most):
    first, last = sorted((one, other))
    places, count = sampled(times, first, last, most)
    within = [place for place, time in enumerate(times) if first <= time <= last]
    before = [place for place, time in enumerate(times) if time < first][-1:]
    assert count == len(within)
    assert len(places) <= most
    assert places == sorted(set(places))
    assert set(places) <= {*before, *within}
    assert places[: len(before)] == before
    if len(within) + len(before) <= most:
        assert places == before + within
        return
    assert places[-1] == within[-1]
    width = (last - first) / (most - len(before))
    for place in within:  # what is known in the end of each part is known within a part's width
        assert any(0 <= times[each] - times[place] <= width for each in places)


def test_a_course_has_the_likeliest_states_with_their_chances_of_dense_and_sparse_beliefs():
    rng = np.random.default_rng(3)
    beliefs = list(rng.dirichlet(np.full(50, 0.1), size=20))
    given_ = [
        Support(np.flatnonzero(each), each[each > 0]) if place % 2 else each for place, each in enumerate(beliefs)
    ]
    decisions = [Decision(10 * n, "robot", n, "tick", None, None, None, 0, "go", float(n)) for n in range(20)]
    course = course_of(
        *(decisions, 999, float),
        lambda decision: given_[decision.epoch],
        lambda decision, current: float(decision.epoch) if current is not None else None,
        "s{}".format,
        Space([Factor("lit", ["no", "yes"]), Factor("place", 25)]),
    )
    order = np.argsort(-np.sum(beliefs, axis=0))[:5]
    assert course.states == tuple(f"s{state}" for state in order)
    assert np.allclose(course.beliefs, np.array(beliefs)[:, order].T, atol=1e-4)
    assert course.times == tuple(10.0 * n for n in range(20))
    assert course.rewards == course.values == tuple(map(float, range(20)))
    assert course.decisions == 999
    assert np.allclose(course.entropies, [-sum(p * np.log2(p) for p in each if p > 0) for each in beliefs], atol=1e-3)
    assert course.shares == ()  # of 27 values
    few = course_of(
        *(decisions[:1], 1, float, lambda _: np.array([0.1, 0.2, 0.3, 0.4]), lambda *_: None, str),
        Space([Factor("lit", ["no", "yes"]), Factor("x", 2)]),
    )
    assert {name: each for name, (each,) in few.shares} == pytest.approx(
        {"lit no": 0.3, "lit yes": 0.7, "x 0": 0.4, "x 1": 0.6}
    )


def test_a_record_tells_the_course_of_all_of_it_and_of_a_part(tmp_path):
    robot, seen = ensemble(), []

    async def main(runtime):
        await runtime.start(robot)
        for number in range(1_000):
            await asyncio.sleep(1)
            robot.publish_observation("hear-left" if number % 5 else "hear-right")
            seen.append(
                (robot.controller.decided_by.copy(), robot.controller.policy.value(robot.controller.decided_by))
            )

    run_virtual(main, record=tmp_path / "run.mcap")
    run = RecordedRun(Record(tmp_path / "run.mcap"), robot, ensembles={"robot": robot})
    course = asyncio.run(run.course("robot", run.first, run.last))
    assert course.decisions == 1_001
    assert POINTS - 2 <= len(course.times) <= POINTS
    assert course.times[-1] == pytest.approx(run.last)
    left = course.states.index("tiger-left")
    for time, chance, value in zip(course.times[1:], course.beliefs[left][1:], course.values[1:], strict=True):
        belief, worth = seen[round(time) - 1]
        assert chance == pytest.approx(belief[0], abs=1e-4)
        assert value == pytest.approx(worth, abs=1e-6)
    part = asyncio.run(run.course("robot", 100.5, 110.5))
    assert part.times == pytest.approx([100.0, *range(101, 111)])
    assert part.decisions == 10
    assert asyncio.run(run.course("nobody", 0.0, 1.0)) is None
    detail = run.frame(500.5, {"robot"}).details["robot"]
    assert detail.value == pytest.approx(seen[499][1], abs=1e-6)


def test_the_return_is_not_told_by_a_policy_that_has_not_decided(tmp_path):
    async def main(runtime):
        await runtime.start(ensemble())
        await asyncio.sleep(1)

    run_virtual(main, record=tmp_path / "run.mcap")
    model = mdm.problems.tiger(discount=0.5)
    other = mdm.Ensemble(
        "robot", policy=mdm.solve(model, gap=0.1).policy, model=model, actions=dict.fromkeys(range(3), lambda: None)
    )
    run = RecordedRun(Record(tmp_path / "run.mcap"), other, ensembles={"robot": other})
    assert asyncio.run(run.course("robot", 0.0, 1.0)).values == (None,)
