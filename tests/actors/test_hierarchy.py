"""Ensembles above and below each other: their starts, stops, failures and depth."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import given, strategies as st
from levels import above, forever, leaf
from sentences import refused

from mdm import (
    ActorFailure,
    ConfigError,
    Ensemble,
    Error,
    PredicateManager,
    Restart,
    Runtime,
    StateFactor,
    VirtualClock,
    bind,
    run,
)
from mdm.messages import ActionLife
from mdm.models import POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy
from mdm.testing import capture_decisions, crash, probe, run_virtual


def test_a_child_starts_and_stops_with_its_action_within_the_turn():
    async def main(runtime):
        child = leaf("child")
        top = above("top", child)
        with capture_decisions(runtime) as decisions:
            await runtime.start(top)
            child.publish_state(0)  # its layers live, but it does not decide
            assert decisions == []
            top.publish_state(0)
            assert [decision.ensemble for decision in decisions] == ["top", "top/child"]
            assert child.active
            await asyncio.sleep(1)
            assert child.action.live == ("Work",)
            lives = probe(runtime.channel("top/lives", ActionLife))
            top.publish_state(1)
            assert not child.active
            await asyncio.sleep(0)
            await asyncio.sleep(0.1)
            assert [(life.action, life.status) for life in lives] == [
                ("child", "preempted"),
                ("Idle", "running"),
                ("Idle", "succeeded"),
            ]

    run_virtual(main)


def test_three_levels_stop_from_below():
    log = []

    async def work():
        try:
            await forever()
        finally:
            await asyncio.sleep(0.5)
            log.append("work ended")

    async def main(runtime):
        bottom = leaf("bottom", actions={"Work": work, "Rest": lambda: None})
        middle = above("middle", bottom)
        top = above("top", middle)
        await runtime.start(top)
        bottom.publish_state(0)
        middle.publish_state(0)
        top.publish_state(0)
        await asyncio.sleep(1)
        assert bottom.action.live == ("Work",)
        for ensemble in (middle, top):
            ensemble.when_idle(lambda name=ensemble.name: log.append(name))
        top.stop()
        await asyncio.sleep(1)
        assert log[0] == "work ended"
        assert sorted(log[1:]) == ["middle", "top"]

    run_virtual(main)


@pytest.mark.parametrize("resume", [False, True])
def test_resume_keeps_the_child_s_belief(resume):
    hear, half = [[0.85, 0.15], [0.15, 0.85]], np.full((2, 2), 0.5)
    model = POMDP([np.eye(2), half, half], [hear, half, half], [[-1, -100, 10], [-1, 10, -100]], discount=0.95)
    policy = AlphaVectors([[0.0, 0.0]], [0], 3)

    async def main(runtime):
        child = Ensemble("child", policy=policy, model=model, actions=dict.fromkeys(range(3), lambda: None))
        top = Ensemble(
            "top",
            policy=DeterministicPolicy([0, 1]),
            actions={"Child": bind(child, resume=resume), "Idle": lambda: None},
        )
        await runtime.start(top)
        top.publish_state(0)
        child.publish_observation(0)
        assert child.control.belief[0] == pytest.approx(0.85)
        top.publish_state(1)
        await asyncio.sleep(0.1)
        top.publish_state(0)
        assert child.control.belief[0] == pytest.approx(0.85 if resume else 0.5)

    run_virtual(main)


def test_a_child_that_stops_by_itself_has_succeeded_and_one_that_fails_has_failed():
    async def main(runtime):
        child = leaf("child", supervision="stop")
        top = above("top", child)
        await runtime.start(top)
        lives = probe(runtime.channel("top/lives", ActionLife))
        top.publish_state(0)
        child.stop()
        await asyncio.sleep(0.1)
        top.publish_state(0)
        crash(child.control)
        await asyncio.sleep(0.1)
        top.publish_state(0)
        assert [(life.status, life.detail) for life in lives] == [
            ("running", ""),
            ("succeeded", ""),
            ("running", ""),
            ("failed", "ensemble 'top/child' failed"),
            ("running", ""),
            ("failed", "ensemble 'top/child' does not run: it has failed"),
        ]
        assert top.life == "running"

    run_virtual(main)


@pytest.mark.parametrize("layer", ["control", "action"])
def test_escalation_runs_the_safe_action_of_every_ensemble_then_ends(layer):
    log = []

    async def main(runtime):
        child = leaf("child", safe_action=lambda: log.append("child is safe"))
        top = above("top", child, safe_action=lambda: log.append("top is safe"))
        await runtime.start(top)
        child.publish_state(0)
        top.publish_state(0)
        await asyncio.sleep(1)
        crash(getattr(child, layer), Error("broken"))
        await asyncio.sleep(1e6)

    with refused(ActorFailure):
        run_virtual(main)
    assert sorted(log) == ["child is safe", "top is safe"]


def test_an_ensemble_below_two_parents_is_refused():
    child = leaf("child")
    above("one", child)
    with refused(Error):
        above("two", child)


def test_a_hierarchy_of_too_many_levels_is_refused():
    top = leaf("e")
    for level in range(99):
        top = above(f"e{level}", top)
    with refused(ConfigError):
        above("top", top)


def test_the_tree_can_be_printed():
    tree = above("top", above("middle", leaf("bottom"))).tree()
    assert tree.splitlines() == [
        "top (MDP, 2 states, 2 actions, event-driven)",
        "  middle: middle (MDP, 2 states, 2 actions, event-driven)",
        "    bottom: bottom (MDP, 2 states, 2 actions, event-driven)",
        "      Work: forever()",
        "      Rest: <lambda>()",
        "    Idle: <lambda>()",
        "  Idle: <lambda>()",
    ]


@given(st.data())
def test_random_hierarchies_leave_no_task_behind(data):
    """Whatever ensembles start, stop and fail at random, nothing runs below one that does not, and nothing is left."""

    def grow(name, depth):
        children = [] if depth == 0 else [grow(f"{name}{i}", depth - 1) for i in range(data.draw(st.integers(0, 2)))]
        supervision = data.draw(st.sampled_from(["escalate", "stop", Restart(limit=2, backoff=0.2)]))
        ensemble = above(name, *children, supervision=supervision) if children else leaf(name, supervision=supervision)
        everything.append(ensemble)
        return ensemble

    everything: list[Ensemble] = []

    async def main():
        before = asyncio.all_tasks()
        try:
            async with Runtime(clock=VirtualClock(), log=None) as runtime:
                top = grow("e", data.draw(st.integers(1, 3)))
                await runtime.start(top)
                for _ in range(data.draw(st.integers(1, 15))):
                    ensemble = data.draw(st.sampled_from(everything))
                    step = data.draw(st.sampled_from(["state"] * 6 + ["stop", "start", "crash"]))
                    if step == "state":
                        states = ensemble.controller.policy.num_states
                        ensemble.publish_state(data.draw(st.integers(0, states - 1)))
                    elif step == "crash":
                        crash(data.draw(st.sampled_from([ensemble, ensemble.control, ensemble.action])))
                    elif ensemble is top:
                        getattr(ensemble, step)()
                    await asyncio.sleep(data.draw(st.sampled_from([0, 0.1, 1])))
                    await asyncio.sleep(0.01)
                    for each in everything:
                        for below in each.subensembles:
                            if below.active and each.life == "running":
                                assert below.name in each.action.live
        except ActorFailure:
            pass
        assert asyncio.all_tasks() == before
        assert not any(ensemble.active or ensemble.action.live for ensemble in everything)

    run(main, virtual=True)


@pytest.mark.parametrize("stack", [5, 300, 700])
def test_a_hundred_levels_go_safe_from_a_deep_stack(stack):
    def deep(levels, function):
        if levels:
            deep(levels - 1, function)
        else:
            function()

    predicates, ran, top = PredicateManager(), [], None
    sensor = predicates.sensor("S", initial=True)
    for level in range(100):
        top = Ensemble(
            f"level{level}",
            policy=[0, 1],
            actions={"Stay": lambda: None, "Go": top or (lambda: asyncio.sleep(3600))},
            predicates=predicates,
            states=[StateFactor("s", ["S"])],
            safe_action=lambda level=level: ran.append(level),
            on_unknown="safe" if level == 99 else "continue",
        )

    async def main(runtime):
        await runtime.start(top)
        await asyncio.sleep(1)
        deep(stack, lambda: sensor.set(None))
        await asyncio.sleep(1)
        assert ran == [99]
        assert top.action.live == ()
        ran.clear()

    run_virtual(main)
    assert ran == list(range(100))
