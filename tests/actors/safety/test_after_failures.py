"""After an action's end something is decided, or it is told why not: whatever ends, reacts, and makes safe."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import Body

from mdm import Ensemble, PredicateManager, StateFactor, bind
from mdm.testing import run_virtual


async def swallow():
    """Go on whatever is asked."""
    while True:
        try:
            await asyncio.sleep(1e6)
        except asyncio.CancelledError:
            continue


async def break_off():
    await asyncio.sleep(1.0)
    raise OSError("the way is blocked")


async def forever():
    await asyncio.sleep(1e6)


def raises():
    raise OSError("the way is blocked")


ENDS = {
    "raises": (break_off, {}),
    "raises at once": (raises, {}),
    "times out": (forever, {"timeout": 1.0}),
    "is abandoned": (swallow, {"timeout": 1.0, "grace": 0.5}),
}


def begun(lives, action="Go"):
    """Return when lives of an action began, in seconds."""
    return [life.time / 1e9 for life in lives if (life.action, life.status) == (action, "running")]


# -- A stimulus between the last step and the end ---------------------------------------------------------------------


@pytest.mark.parametrize("soon", [False, True])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"on_repeat": "restart"},
        {"group": "wheels"},
        {"concurrent": True},
        {"concurrent": True, "on_repeat": "restart"},
    ],
    ids=str,
)
def test_what_an_action_sets_with_its_last_step_begins_it_once_more(options, soon):
    """Set behind that step, but before the end had come back, it was taken for one that goes on: nothing was begun."""

    async def main(runtime):
        manager = PredicateManager()
        odd = manager.sensor("Odd", initial=False)
        count = []

        async def go():
            await asyncio.sleep(1)
            count.append(len(count) % 2 == 0)
            if len(count) < 11:
                if soon:
                    asyncio.get_running_loop().call_soon(odd.set, count[-1])
                else:
                    odd.set(count[-1])

        robot = Ensemble(
            "robot",
            policy=[0, 0],
            actions={"Go": bind(go, **options)},
            predicates=manager,
            states=[StateFactor("odd", ["Odd"])],
        )
        await runtime.start(robot)
        await asyncio.sleep(20)
        assert (robot.control.decisions, len(count), robot.action.started) == (11, 11, 11)
        assert robot.action.ended == {"succeeded": 11}

    run_virtual(main)


def test_a_drive_that_has_ended_when_another_of_its_group_is_chosen_has_succeeded():
    async def main(runtime):
        manager = PredicateManager()
        at = manager.sensor("At", initial=False)
        manager.latch("Done", set="Go.succeeded", reset="Go.preempted", initial=False)

        async def go():
            await asyncio.sleep(1)
            asyncio.get_running_loop().call_soon(at.set, True)

        robot = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"Go": bind(go, group="wheels"), "Back": bind(Body("Back", []), group="wheels")},
            predicates=manager,
            states=[StateFactor("at", ["At"])],
        )
        await runtime.start(robot)
        await asyncio.sleep(2)
        assert (manager.value("Done"), robot.action.live) == (True, ("Back",))
        assert robot.action.ended == {"succeeded": 1}

    run_virtual(main)
