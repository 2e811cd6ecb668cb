"""What is judged of a robot that runs, and the same from its record."""

from __future__ import annotations

import asyncio

import msgspec
import numpy as np
import pytest
from decided import ensemble

import mdm
from mdm import Ensemble
from mdm.models import POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.recording import Record
from mdm.snapshots import Event, LiveRun, RecordedRun
from mdm.testing import run_virtual


def compare_spells(live, run):
    """Compare when judgements began, and when they were over, live and from the record, which steps to them."""
    recorded = [msgspec.json.decode(each, type=Event) for each in run.after(0, 10**9)[0]]
    lists = [[(each.source, each.name) for each in events if each.status == "begins"] for events in (live, recorded)]
    assert lists[0] == lists[1]
    for event in recorded:
        if event.kind != "judgement" or event.time > run.last - 6.0:  # of which the end was not seen
            continue
        key = event.source, event.name, event.status, event.life
        (seen,) = [each for each in live if (each.source, each.name, each.status, each.life) == key]
        assert abs(seen.time - event.time) < 1.5  # live it is counted from one look to the next
    begins = sorted({each.time for each in recorded if each.status == "begins"})
    at, found = 0.0, []
    while (after := run.step("judgement", at)) != at:
        found.append(after)
        at = after
    assert found == begins


def named(frame):
    """Return the judgements that last, in words by ensemble."""
    found = {}
    for each in frame.judgements:
        if each.until is None:
            found.setdefault(each.of, []).append(f"{each.text}; {each.evidence}")
    return found


def looked(actors, seconds, path, script=None):
    """Run actors, and return what was judged of each ensemble at each second: live, and from the record."""
    live, lives = {}, []

    async def main(runtime):
        run = LiveRun(runtime)
        run.open()
        lives.append(run)
        for actor in actors:
            await runtime.start(actor)
        task = asyncio.get_running_loop().create_task(script(*actors)) if script else None
        for second in range(seconds):
            for _ in range(5):
                frame = run.frame(())
                await asyncio.sleep(0.2)
            live[second + 1] = named(frame)
        if task is not None:
            task.cancel()

    run_virtual(main, record=path)
    run = RecordedRun(Record(path))
    compare_spells(list(lives[0].ring), run)
    recorded = {second: named(run.frame(second - 0.2)) for second in range(1, seconds)}  # as live, before that look
    return live, recorded


def test_an_action_that_ends_at_once_and_is_decided_again_is_told_live_and_from_the_record(tmp_path):
    async def nothing():
        pass

    robot = Ensemble(
        "robot", policy=DeterministicPolicy([0]), actions={0: mdm.Binding(nothing, then="decide", pause=0.2)}
    )

    async def script(robot):
        robot.publish_state(0)

    live, recorded = looked([robot], 20, tmp_path / "run.mcap", script)
    for told in (live, recorded):
        assert told[1] == {}
        (text,) = told[15]["robot"]
        assert text.startswith("decided 0 7")
        assert "times, each time because it had just ended" in text


def test_decisions_that_begin_an_episode_are_none_of_those_that_repeat(tmp_path):
    async def nothing():
        pass

    again = mdm.Binding(nothing, then="decide", pause=0.21)
    robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={0: again}, horizon=3)

    async def script(robot):
        robot.publish_state(0)

    live, recorded = looked([robot], 20, tmp_path / "run.mcap", script)
    assert live[1] == recorded[1] == {}
    assert live[15] == recorded[15]
    assert live[15]["robot"][0].startswith("decided 0 47 times")


def test_an_action_that_hangs_is_told_live_and_from_the_record(tmp_path):
    spans = iter([2.0, 3.0, 2.0, 1e9])

    async def go():
        await asyncio.sleep(next(spans))

    robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={0: mdm.Binding(go, then="decide", pause=0.2)})

    async def script(robot):
        robot.publish_state(0)

    live, recorded = looked([robot], 40, tmp_path / "run.mcap", script)
    for told in (live, recorded):
        assert told[16] == {}
        assert told[30]["robot"][0].endswith("it usually takes 2.0 s")
    run = RecordedRun(Record(tmp_path / "run.mcap"))
    begins = 7.0 + 3 * 0.2 + 10.0  # the three that ended, the pauses, and five times as long as usual
    assert run.step("judgement", 0.0) == pytest.approx(begins, abs=1e-6)
    assert named(run.frame(begins - 1e-3)) == {}
    assert named(run.frame(begins)) == {"robot": ["0 has lasted for more than 10 s; it usually takes 2.0 s"]}
    assert run.frame(begins).headline == "robot: 0 has lasted for more than 10 s, since 00:07.6"


def test_a_model_that_cannot_tell_states_apart_is_told_live_and_from_the_record(tmp_path):
    deaf = POMDP(
        transitions=[np.eye(2)] * 3,
        observations=[np.array([[0.85, 0.15], [0.85, 0.15]])] * 3,
        rewards=np.zeros((2, 3)),
        discount=0.95,
        states=["tiger-left", "tiger-right"],
        actions=["listen", "open-left", "open-right"],
        observation_names=["hear-left", "hear-right"],
    )
    robot = ensemble(model=deaf, policy=AlphaVectors([[0.0, 0.0], [-9.0, -9.0], [-9.0, -9.0]], [0, 1, 2]))

    async def script(robot):
        for step in range(100):
            await asyncio.sleep(0.5)
            robot.publish_observation("hear-right" if step % 4 == 0 else "hear-left")

    live, recorded = looked([robot], 30, tmp_path / "run.mcap", script)
    for told in (live, recorded):
        assert told[5] == {}
        assert "does not move" in told[25]["robot"][0]
        assert "hear-left" in told[25]["robot"][0]


def test_a_fixed_rate_that_keeps_or_repeats_its_action_is_not_named(tmp_path):
    async def go():
        await asyncio.sleep(1e6)

    async def beep():
        pass

    keeps = Ensemble("keeps", policy=DeterministicPolicy([0, 1]), actions={0: go, 1: go}, drive=10.0)
    calls = Ensemble("calls", policy=DeterministicPolicy([0, 1]), actions={0: beep, 1: lambda: None}, drive=10.0)

    async def script(*robots):
        for step in range(100):
            for robot in robots:
                robot.publish_state(step // 20 % 2)
            await asyncio.sleep(1.0)

    live, recorded = looked([keeps, calls], 60, tmp_path / "run.mcap", script)
    assert set(map(str, live.values())) == set(map(str, recorded.values())) == {"{}"}


def test_a_tiger_heard_well_is_not_named(tmp_path):
    async def script(robot):
        draw = np.random.default_rng(1)
        for _ in range(200):
            await asyncio.sleep(0.3)
            robot.publish_observation("hear-left" if draw.random() < 0.85 else "hear-right")

    live, recorded = looked([ensemble()], 60, tmp_path / "run.mcap", script)
    assert set(map(str, live.values())) == set(map(str, recorded.values())) == {"{}"}


def test_a_robot_that_stands_after_a_failure_says_so_and_one_whose_state_stays_says_in_which(tmp_path):
    async def grips():
        await asyncio.sleep(0.5)
        raise RuntimeError("no grip")

    async def waits():
        await asyncio.sleep(0.5)

    def robot(name, act):
        return Ensemble(name, policy=DeterministicPolicy([0, 0]), actions={0: act})

    async def script(*actors):
        for each in actors:
            each.publish_state(1)
        await asyncio.sleep(100)

    path = tmp_path / "stands.mcap"
    live, recorded = looked([robot("fails", grips), robot("stands", waits)], 35, path, script)
    for told in (live[33], recorded[33]):
        assert "has nothing to do; 0 failed: RuntimeError: no grip" in told["fails"][0]
        assert told["fails"][0].endswith(", in state 1 as before; nothing decides again")
        assert told["stands"] == ["has nothing to do; 0 has ended, in state 1 as before; nothing decides again"]
