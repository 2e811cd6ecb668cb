"""Input from outside: as if users' code had said it."""

from __future__ import annotations

import asyncio

import pytest

import mdm
from mdm.messages import Control, SensorUpdate, State
from mdm.replay.input import give
from mdm.testing import capture_decisions, run_virtual


def robot():
    predicates = mdm.PredicateManager("predicates")
    predicates.sensor("Near", initial=False)
    return mdm.Ensemble(
        "robot",
        policy=[0, 1],
        predicates=predicates,
        states=[mdm.StateFactor("near", ["Near"])],
        actions={"go": lambda: None, "stay": lambda: None},
    )


def decided(*inputs):
    """Return what is decided on pairs of a channel and a message, a second each."""
    ensemble = robot()

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(ensemble)
            for channel, message in inputs:
                await asyncio.sleep(1)
                give(runtime, channel, message(runtime.now()))
        return [(each.time // 10**9, each.cause, each.action_name) for each in decisions], ensemble.mode

    return run_virtual(main)


def test_a_message_begins_a_turn_on_its_channel():
    made, mode = decided(("robot/predicates/sensed", lambda now: SensorUpdate(now, (("Near", True),))))
    assert made == [(0, "start", "go"), (1, "state", "stay")]
    assert mode == "deciding"


@pytest.mark.parametrize(("command", "mode"), [("stop", "stopped"), ("reset", "deciding")])
def test_a_command_is_given_to_its_ensemble(command, mode):
    assert decided(("robot/control", lambda now: Control(now, command)))[1] == mode


def test_a_stopped_ensemble_resumes_where_it_was():
    stop, resume = (lambda now, each=each: Control(now, each) for each in ("stop", "resume"))
    made, mode = decided(("robot/control", stop), ("robot/control", resume))
    assert [time for time, *_ in made] == [0, 2]
    assert mode == "deciding"


def test_on_a_channel_that_there_is_not_nobody_hears_anything():
    assert len(decided(("nobody/state", lambda now: State(now, 0, (0,))))[0]) == 1
