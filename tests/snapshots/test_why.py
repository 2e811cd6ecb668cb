"""Why a decision was made, as a page tells it, against the policy's own values."""

from __future__ import annotations

import asyncio

import pytest
from decided import ensemble

from mdm import Ensemble, PredicateManager, StateFactor
from mdm.policies import DeterministicPolicy
from mdm.problems import tiger
from mdm.recording import Record
from mdm.snapshots import LiveRun, RecordedRun
from mdm.testing import run_virtual


def test_live_and_from_the_record_it_is_the_same(tmp_path):
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot = ensemble()
        await runtime.start(robot)
        live.scene()
        robot.publish_observation("hear-left")
        await asyncio.sleep(1)
        robot.publish_observation("hear-left")
        return await live.explain("robot"), await live.explain("nobody"), robot.controller.belief

    told, nobody, belief = run_virtual(main, record=tmp_path / "run.mcap")
    assert nobody is None
    robot = ensemble()
    assert told.facts.values[0].value == pytest.approx(robot.controller.policy.value(belief))
    assert told.epoch == 2
    assert "hear-left" in told.text
    assert told.heard == (("listen", "hear-left"), ("listen", "hear-left"))
    assert set(told.states) == {"tiger-left", "tiger-right"}
    odds = [1.0, 0.85 / 0.15, (0.85 / 0.15) ** 2]  # by Bayes, of hearing right with .85
    left = [belief[told.states.index("tiger-left")] for belief in told.beliefs]
    assert left == pytest.approx([each / (1 + each) for each in odds], abs=1e-4)
    assert not any("tiger" in sentence for sentence in told.sentences)  # what is drawn is said once
    run = RecordedRun(Record(tmp_path / "run.mcap"), ensembles={"robot": robot})
    assert asyncio.run(run.explain("robot", 1.5)) == told
    assert asyncio.run(run.explain("nobody", 1.5)) is None
    other = RecordedRun(Record(tmp_path / "run.mcap"), ensembles={"robot": ensemble(model=tiger(discount=0.5))})
    assert asyncio.run(other.explain("robot", 1.5)).text == (
        "Nothing tells why: model, policy or options that can be loaded are not those that decided."
    )


def test_before_anything_is_decided_it_says_so():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot = ensemble()
        await runtime.start(robot)
        robot.reset()
        robot.stop()
        robot.control.begin_episode()
        live.scene()
        return await live.explain("robot")

    assert run_virtual(main).text == "Nothing tells why: nothing was decided in this episode yet."


def test_a_policy_without_a_model_has_the_names_of_its_wiring():
    predicates = PredicateManager()
    predicates.sensor("MustCharge", initial=False)
    robot = Ensemble(
        "robot",
        policy=DeterministicPolicy([0, 1]),
        states=[StateFactor("MustCharge", ["MustCharge"])],
        actions={"Patrol": lambda: None, "Charge": lambda: None},
        predicates=predicates,
    )

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(robot)
        live.scene()
        await asyncio.sleep(1)
        return await live.explain("robot")

    told = run_virtual(main)
    assert (told.facts.action_name, told.facts.state) == ("Patrol", "not MustCharge")
    assert "MustCharge instead of not MustCharge, then 'Charge'" in told.text
