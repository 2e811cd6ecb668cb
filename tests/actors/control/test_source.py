"""Sources: what a team does with a control layer, against the same layer on its own channels."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import given, strategies as st
from safe_robots import Log, robot
from sentences import refused

from mdm import problems
from mdm.actors.control.source import OwnChannels
from mdm.actors.ensemble import Ensemble
from mdm.errors import ModelError
from mdm.messages import Action, Control, Observation, State
from mdm.policies import AlphaVectors
from mdm.testing import probe, run_virtual


class Team:
    absence = ""

    def __init__(self):
        self.asked = []

    def command(self, command):
        self.asked.append(command)


def shared(ensemble):
    team = Team()
    return team, ensemble.follow(team, ())


def state(index, time=0):
    return State(time, index, (index,))


async def begin(runtime, ensemble, process, *messages):
    """Start an ensemble, and have its team say something within a turn."""

    def say():
        for message in (Control(0, "start"), *messages):
            ensemble.show(message)
            process.take(message)

    await runtime.start(ensemble)
    ensemble.call_later(1e-6, say)
    await asyncio.sleep(0.01)


def test_an_agent_alone_stops_deciding_in_a_safe_mode_and_one_of_a_team_goes_on():
    decided = {}

    async def main(runtime):
        alone, together = (robot(Log(), name, safe_action=lambda: None) for name in ("alone", "together"))
        _, process = shared(together)
        assert isinstance(alone.control.source, OwnChannels)
        await runtime.start(alone)
        await begin(runtime, together, process)
        for ensemble in (alone, together):
            actions = probe(ensemble.channel("action", Action))
            ensemble.safety.endanger("mine", "", 0)
            if ensemble is alone:
                ensemble.publish_state(1)
            else:
                ensemble.call_later(1e-6, lambda: process.take(state(1)))
            await asyncio.sleep(0.01)
            assert ensemble.mode == "safe"
            decided[ensemble.name] = [action.index for action in actions]

    run_virtual(main)
    assert decided == {"alone": [], "together": [1]}


def test_what_is_asked_of_an_ensemble_of_a_team_is_asked_of_the_team():
    async def main(runtime):
        ensemble = robot(Log())
        team, _ = shared(ensemble)
        await runtime.start(ensemble)
        ensemble.start()
        ensemble.stop()
        await asyncio.sleep(0.01)
        assert team.asked == ["start", "stop"]
        assert ensemble.mode == "stopped"

    run_virtual(main)


def test_what_others_decided_long_ago_is_decided_and_not_done_until_that_is_over():
    log = Log()

    async def main(runtime):
        ensemble = robot(log)
        _, process = shared(ensemble)
        await begin(runtime, ensemble, process)

        def behind():
            process.catch_up(0, over=False)
            for index in (1, 0, 1):
                process.take(state(index))

        ensemble.call_later(1e-6, behind)
        await asyncio.sleep(0.01)
        assert (log, ensemble.controller.epoch) == ([], 3)
        ensemble.call_later(1e-6, lambda: process.catch_up(0, over=True))
        await asyncio.sleep(0.01)
        assert log == ["B"]

    run_virtual(main)


def tiger():
    model = problems.tiger()
    actions = dict.fromkeys(model.action_space.names, lambda: None)
    return Ensemble("tiger", policy=AlphaVectors(np.eye(3, 2), [0, 1, 2]), model=model, actions=actions)


def test_a_copy_goes_on_from_a_snapshot_of_another():
    async def main(runtime):
        one, other = tiger(), tiger()
        other.name = "other"
        processes = [shared(ensemble)[1] for ensemble in (one, other)]
        heard = [Observation(0, index, (index,), (True,)) for index in (0, 1, 1)]
        await begin(runtime, one, processes[0], *heard)
        await begin(runtime, other, processes[1])
        before = processes[1].snapshot()
        processes[1].restore(processes[0].snapshot())
        assert processes[1].snapshot() == processes[0].snapshot() != before
        assert (one.control.belief == other.control.belief).all()
        with refused(ModelError):
            processes[0].restore(processes[0].snapshot()[:-1])

    run_virtual(main)


@given(st.binary(max_size=40))
def test_what_is_no_snapshot_changes_nothing(data):
    _, process = shared(tiger())
    before = process.snapshot()
    with pytest.raises(ModelError):
        process.restore(data)
    assert process.snapshot() == before
