"""At a fixed rate a belief has exactly the steps that were taken, whether a false negative is declared or not.

Beliefs are compared with sums over all states of the model's own numbers.
"""

from __future__ import annotations

import asyncio
import itertools
import warnings

import numpy as np
import pytest
from estimated import nothing
from hypothesis import given, settings, strategies as st
from random_models import dense
from team_robots import over_beliefs, started

import mdm
from mdm import estimation
from mdm.errors import ModelWarning
from mdm.estimation.hidden import Matrices, moves, passes
from mdm.models import POMDP, Factor, Space
from mdm.team import Team
from mdm.team.transport.network import Network
from mdm.testing import capture_decisions, run_virtual

PARTS = (2, 2)
MISSED = st.none() | st.integers(0, 3)


def pair(seed, *, events=False, told=1.0):
    """Return a model of two agents with an observation of two symbols each."""
    random = np.random.default_rng(seed)
    seen = random.dirichlet(np.ones(4), (4, 3, 3) if events else (4, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # events may leave a part to no observation
        return POMDP(
            random.dirichlet(np.ones(3), (4, 3)),
            np.moveaxis(seen, -1, 1) * told if events else seen,
            random.normal(size=(3, 4)),
            discount=0.9,
            actions=Space([Factor("left", ["l0", "l1"]), Factor("right", ["r0", "r1"])]),
            observation_names=Space([Factor("left", ["x", "y"]), Factor("right", ["x", "y"])]),
            event_observations=events,
        )


def agreeing(seen):
    """Return the joint observations that agree with some components; with nothing, all."""
    seen = (None, None) if seen is None else seen
    every = enumerate(itertools.product(*map(range, PARTS)))
    return [index for index, joint in every if all(c in (None, x) for c, x in zip(seen, joint, strict=True))]


def after(model, belief, action, seen):
    """Return the belief one step later, and the probability of what was observed; None where it is 0."""
    if seen is None:
        return belief @ dense(model.transition_matrix(action)), 1.0
    joint = belief @ sum(dense(model.joint_matrix(action, symbol)) for symbol in agreeing(seen))
    return joint / joint.sum(), joint.sum()


def lived(model, stream, rate=1.0, **options):
    """Return what a robot decides that observes so much before each of its ticks."""

    async def main(runtime):
        actions = dict.fromkeys(["l0", "l1"], nothing)
        robot = mdm.Ensemble("robot", policy=CYCLE, model=model, actions=actions, drive=rate, **options)
        monitor = mdm.DriftMonitor(robot)
        await runtime.start(monitor)
        with capture_decisions(runtime) as decisions:
            await runtime.start(robot)
            await asyncio.sleep(1.5 / rate)
            for seen in stream:
                if seen is not None:
                    robot.publish_observation(seen)
                await asyncio.sleep(1 / rate)
        return decisions, monitor.test

    return run_virtual(main)


class Cycle(mdm.policies.BeliefPolicy):
    """Acts by where the likeliest state is, so that actions vary."""

    num_states, num_actions = 3, 4

    def action(self, belief):
        return int(np.argmax(belief)) + int(belief[0] > 0.3)


CYCLE = Cycle()
SEEN = st.tuples(*(st.none() | st.integers(0, size - 1) for size in PARTS))
STREAMS = st.lists(st.none() | SEEN.filter(lambda seen: seen != (None, None)), max_size=6)


@pytest.mark.parametrize("events", [False, True])
@settings(max_examples=12)
@given(st.integers(0, 10_000), STREAMS, MISSED, st.sampled_from([1.0, 4.0]), st.sampled_from([1.0, 0.7]))
def test_a_robot_a_record_of_it_and_its_drift_count_the_steps_that_were(events, seed, stream, missed, rate, told):
    model = pair(seed, events=events, told=told)
    declared = model if missed is None else model.with_false_negatives(missed)
    options = {} if missed is None else {"false_negative": missed}
    decisions, test = lived(model, stream, rate, **options)
    assert len(decisions) >= len(stream) + 1
    first = len(decisions) - len(stream)
    belief = decisions[first - 1].belief
    total = 0.0
    for before, decision, seen in zip(decisions[first - 1 :], decisions[first:], stream, strict=False):
        belief, probability = after(model, belief, before.action, seen)
        np.testing.assert_allclose(decision.belief, belief, atol=1e-9)
        total += np.log(probability)
    _, plain = lived(model, stream, rate)
    for action in range(4):
        assert test.odds(action) == plain.odds(action)
    evidence = estimation.evidence_of(declared.step_by_step(), estimation.chains_of(decisions[first - 1 :]).chains)
    matrices = Matrices.of(model)
    assert passes(evidence, moves(matrices, evidence.masks))[1] == pytest.approx(total)


@pytest.mark.parametrize("missed", [0, 3])
def test_statistics_take_such_a_record_and_keep_what_is_declared(missed):
    model = pair(5)
    stream = [(0, 1), None, (1, 1), (None, 0), (1, 0)]
    decisions, _ = lived(model, stream, false_negative=missed)
    report = estimation.statistics(decisions, model.with_false_negatives(missed))
    expected = estimation.statistics(decisions, model)
    assert (report.fit, report.rows) == (expected.fit, expected.rows)
    assert (report.model.false_negative, expected.model.false_negative) == (missed, None)


@settings(max_examples=10)
@given(st.integers(0, 10_000), st.lists(SEEN, max_size=4), MISSED)
def test_a_recollection_counts_the_steps_that_were(seed, stream, missed):
    model = pair(seed)
    declared = model if missed is None else model.with_false_negatives(missed)
    recollection = mdm.team.Recollection(mdm.Controller(CYCLE, declared), agent=0)
    recollection.start()
    belief = model.initial_belief
    for step, (own, other) in enumerate(stream, 1):
        did = recollection.decide().action
        recollection.observe(own)
        if other is not None:
            recollection.hear(1, mdm.team.Experience(step, did % 2, other))
        belief, _ = after(model, belief, did, None if own is other is None else (own, other))
        np.testing.assert_allclose(recollection.belief, belief, atol=1e-9)


@settings(max_examples=5)
@given(st.integers(0, 10_000), st.lists(SEEN, min_size=1, max_size=4), MISSED)
@pytest.mark.parametrize("mode", ["replicated", "communicating"])
def test_a_team_counts_the_steps_that_were(mode, seed, stream, missed):
    model = pair(seed)
    options = {} if missed is None else {"false_negative": missed}

    async def main(runtime):
        network = Network(runtime.clock, team="pair")
        team = Team("pair", ["left", "right"], mode=mode, period=1.0)
        robots = await started(runtime, team, network, over_beliefs(model, CYCLE, **options))
        while not all(robot.commits for robot in robots):
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.25 - runtime.clock.now() / 1e9 % 1)
        told = [[robot.ensemble.controller.belief, robot.ensemble.controller.last_action] for robot in robots]
        for seen in stream:
            for place, robot in enumerate(robots):
                if seen[place] is not None:
                    robot.observe(*(value if place == own else None for own, value in enumerate(seen)))
            await asyncio.sleep(1.0)
            told += [[robot.ensemble.controller.belief, robot.ensemble.controller.last_action] for robot in robots]
        return told

    told = run_virtual(main)
    for place, (belief, action) in enumerate(told[:-2]):
        seen = stream[place // 2]
        expected, _ = after(model, belief, action, None if seen == (None, None) else seen)
        np.testing.assert_allclose(told[place + 2][0], expected, atol=1e-9)


def test_a_detection_a_second_is_one_of_a_step():
    """What was found: .357 and .587."""
    model = POMDP(
        [[[0.9, 0.1], [0, 1]]],
        [[[0.2, 0.8], [0.2, 0.8]]],
        [[0], [0]],
        discount=0.9,
        observation_names=["seen", "none"],
        initial_belief=[1, 0],
    )
    beliefs = []
    for options in ({}, {"false_negative": "none"}):

        async def main(runtime, options=options):
            robot = mdm.Ensemble(
                "robot",
                policy=mdm.policies.AlphaVectors([[0, 0]], [0]),
                model=model,
                drive=1.0,
                actions={0: nothing},
                **options,
            )
            with capture_decisions(runtime) as decisions:
                await runtime.start(robot)
                for _ in range(3):
                    await asyncio.sleep(0.5)
                    robot.publish_observation("seen")
                    await asyncio.sleep(0.5)
            return [each.belief[1] for each in decisions]

        beliefs.append(run_virtual(main))
    assert beliefs[0] == pytest.approx(beliefs[1])
    assert beliefs[1][1:3] == pytest.approx([0.1, 0.19])


@pytest.mark.parametrize("missed", [None, 1])
def test_a_world_tells_a_robot_of_each_step(missed):
    """What nobody detected is an observation there, too: silence that depends on the state would be false."""
    model = pair(7)
    declared = model.with_false_negatives(missed)
    actions = dict.fromkeys(["l0", "l1"], nothing)

    async def main(runtime):
        robot = mdm.Ensemble("robot", policy=CYCLE, model=declared, actions=actions, drive=1.0)
        with capture_decisions(runtime) as decisions:
            await runtime.start(mdm.World(robot, declared, seed=3))
            await runtime.start(robot)
            await asyncio.sleep(20)
        return [decision.observation for decision in decisions[1:]]

    seen = run_virtual(main)
    assert None not in seen
    assert 1 in seen
