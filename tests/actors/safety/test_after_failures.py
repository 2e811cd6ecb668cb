"""After an action's end something is decided, or it is told why not: whatever ends, reacts, and makes safe."""

from __future__ import annotations

import asyncio

import pytest
from action_lives import Body, lives_of, told

from mdm import Ensemble, PredicateManager, StateFactor, bind
from mdm.policies import DeterministicPolicy
from mdm.testing import probe, run_virtual


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


# -- What was abandoned -----------------------------------------------------------------------------------------------


class Stubborn:
    """Does not end before it is let go; counts how many run at once."""

    def __init__(self):
        self.free, self.running, self.most = asyncio.Event(), 0, 0

    async def __call__(self):
        self.running += 1
        self.most = max(self.most, self.running)
        while not self.free.is_set():
            try:
                await self.free.wait()
            except asyncio.CancelledError:
                continue
        self.running -= 1


@pytest.mark.parametrize("reaction", ["continue", "safe", "decide"])
@pytest.mark.parametrize("concurrent", [False, True])
def test_an_abandoned_action_is_not_begun_beside_itself(reaction, concurrent):
    async def main(runtime):
        go, turned = Stubborn(), []
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"Go": bind(go, timeout=1.0, grace=0.5, concurrent=concurrent), "Turn": lambda: turned.append(1)},
            safe_action=lambda: None,
            on_failed_action=reaction,
        )
        await runtime.start(robot)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        robot.publish_state(0)
        await asyncio.sleep(1.6)  # it is abandoned
        for _ in range(2):
            robot.publish_state(1)
            await asyncio.sleep(0.1)
            robot.publish_state(0)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.6)
        assert (go.most, len(turned)) == (1, 2)
        details = [fault.detail for fault in faults]
        again = "action 'Go' failed: still runs since 1.7 s ago, abandoned: it is not begun beside itself"
        assert details.count(again) == 1
        assert details.count("action 'Turn' begins while 'Go', abandoned, still runs") == 2  # each time
        assert robot.mode == ("safe" if reaction == "safe" else "deciding")
        go.free.set()
        await asyncio.sleep(0.01)
        robot.publish_state(1)
        robot.publish_state(0)
        await asyncio.sleep(0.1)
        assert (go.running, told(lives)[-2:]) == (0, [("Go", "running"), ("Go", "succeeded")])
        assert details == [fault.detail for fault in faults][: len(details)]
        assert "still runs" not in "".join(fault.detail for fault in faults[len(details) :])

    run_virtual(main)


def test_an_abandoned_action_that_is_the_safe_action_is_an_emergency():
    called = []

    async def main(runtime):
        stop = Stubborn()
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"Stop": bind(stop, timeout=1.0, grace=0.5), "Go": lambda: None},
            safe_action="Stop",
            on_failed_action="continue",
        )
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(2)
        robot.publish_state(1)
        assert (robot.mode, called) == ("deciding", [])
        faults = probe(runtime.faults)
        robot.safety.endanger("mine", "the bumper", runtime.now())
        assert (robot.mode, stop.most, robot.action.live, called) == ("safe", 1, (), [True])
        assert [fault.detail for fault in faults if fault.kind == "safe_action"] == [
            (
                "the safe action failed twice: action 'safe action' failed: still runs since 2 s ago, abandoned: it is "
                "not begun beside itself"
            )
        ]
        stop.free.set()

    run_virtual(main, emergency=lambda: called.append(True))


def test_a_safe_action_that_was_abandoned_is_not_tried_beside_itself():
    called = []

    async def main(runtime):
        stop = Stubborn()
        robot = Ensemble("robot", policy=[0], actions={"Go": bind(stop, grace=0.5)}, safe_action="Go", safe_timeout=1.0)
        await runtime.start(robot)
        robot.safety.endanger("mine", "the bumper", runtime.now())
        await asyncio.sleep(1.6)
        assert (stop.most, len(called)) == (1, 1)
        stop.free.set()

    run_virtual(main, emergency=lambda: called.append(True))


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
