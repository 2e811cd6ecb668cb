"""Tools for tests: what disturbs an actor."""

from __future__ import annotations

import asyncio

import pytest
from recorded import Fragile, tell

from mdm import Ensemble
from mdm.policies import DeterministicPolicy
from mdm.testing import block, delay, run_virtual


def test_disturbances():
    log = []

    async def main(runtime):
        actor = Fragile("actor", log)
        await runtime.start(actor)
        with block(actor) as held:
            tell(runtime, 2)
            tell(runtime, 4)
            assert len(held) == 2
            assert log == [("start", "actor")]
        await asyncio.sleep(0.1)
        assert log[1:] == [("handled", 2), ("handled", 4)]
        with delay(actor, 5):
            tell(runtime, 6)
        await asyncio.sleep(4.9)
        assert ("handled", 6) not in log
        await asyncio.sleep(0.2)
        assert ("handled", 6) in log

    run_virtual(main)


@pytest.mark.parametrize(("options", "told"), [({}, 1), ({"log": False}, 0)])
def test_an_action_that_fails_in_a_test_is_printed_once(options, told, capsys):
    robot = Ensemble("robot", policy=DeterministicPolicy([0], 1), actions={"0": lambda: {}["gone"]})

    async def main(runtime):
        await runtime.start(robot)
        for _ in range(3):
            robot.publish_state(0)
            await asyncio.sleep(1)

    run_virtual(main, **options)
    assert capsys.readouterr().err.count("KeyError: 'gone'") == told
