"""The recipe of statistics.md, with steps of 1, 5 and 10 s: the deployed policy is better in the true world."""

from __future__ import annotations

import numpy as np
import pytest
from estimated import nothing

import mdm as library
from mdm.models import MDP
from mdm.testing import run_virtual

NAMES = {"states": ["worn", "good"], "actions": ["run", "repair"]}
RATES = np.array([[1 / 2000, 1 / 400], [1 / 20, 1 / 400]])
"""How often a second the state changes in the true world: actions x states."""
EARNED = np.array([[0.1, -0.4], [0.3, -0.3]])
"""What a second earns there: states x actions."""


def after(rates, step):
    """Return where a step leads: the exponential of a generator of two states."""
    away = (1 - np.exp(-rates.sum() * step)) * rates / rates.sum()
    return [[1 - away[0], away[0]], [away[1], 1 - away[1]]]


def assumed(step):
    """Return a model that says that what is worn is good again by itself, in some 20 s, and has the rest right."""
    hopeful = np.array([1 / 20, RATES[0, 1]])
    return MDP([after(hopeful, step), after(RATES[1], step)], EARNED * step, discount=0.97 ** (step / 10), **NAMES)


def lived(policy, seconds, seed, record=None):
    """Return what a second has earned in the true world, on the average."""
    random, earned = np.random.default_rng(seed), 0.0

    async def main(runtime):
        nonlocal earned
        actions = dict.fromkeys(NAMES["actions"], nothing)
        robot = library.Ensemble("robot", policy=policy, model=assumed(10), actions=actions)
        await runtime.start(robot)
        state, began = 0, runtime.now()
        while (runtime.now() - began) / 1e9 < seconds:
            robot.publish_state(state)
            await runtime.clock.sleep(0)
            action = robot.controller.last_action
            lasts = random.exponential(1 / RATES[action, state])
            await runtime.clock.sleep(lasts)
            earned += lasts * EARNED[state, action]
            state = 1 - state
        robot.stop()

    async def recorded():
        async with library.Runtime(record=record, log=False) as runtime:
            await main(runtime)

    if record is None:
        run_virtual(main)
    else:
        library.run(recorded, virtual=True)
    return earned / seconds


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("step", [1, 5, 10])
def test_the_deployed_policy_is_better_in_the_true_world(mdm, facts, tmp_path, step, timed, seed):
    old, new, times, better = (tmp_path / name for name in ("old.mdp", "new.npz", "times.npz", "better.npz"))
    library.save_model(assumed(step), old)
    facts("solve", old, "-o", tmp_path / "old.npz")
    policy = library.load_policy(tmp_path / "old.npz")
    assert [policy.action(state) for state in (0, 1)] == [0, 0]
    before = lived(policy, 40_000, seed, tmp_path / "run.mcap")
    counted = ("statistics", tmp_path / "run.mcap", "--model", old, "--step", step, "-o", new)
    assert mdm(*counted, "--durations", times)[0] == 0
    assert facts("info", new)["discount_of"] == f"a step of {step} s"
    durations = ("--durations", times) if timed else ()
    facts("solve", new, *durations, "-o", better)
    assert facts("info", better)["discount_of"] == f"a step of {step} s"
    found = facts("compare", new, tmp_path / "old.npz", better, *durations, "--seed", "1", "--episodes", "100")
    assert found[1]["exact"] > found[0]["exact"]
    deployed = library.load_policy(better)
    assert [deployed.action(state) for state in (0, 1)] == [1, 0]
    assert lived(deployed, 40_000, seed + 10) > 1.5 * before
