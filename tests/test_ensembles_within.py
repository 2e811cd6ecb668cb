"""Ensembles within trees and state machines of other libraries."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest
from action_lives import lives_of, told
from errands import FOLDER, within
from sentences import refused

from mdm import Ensemble
from mdm.policies import DeterministicPolicy
from mdm.testing import run_virtual

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
        with refused(RuntimeError):
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
