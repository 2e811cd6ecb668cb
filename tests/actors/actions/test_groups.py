"""Actions of a group: the next begins before the last is cancelled, and never past the latch."""

from __future__ import annotations

import asyncio

import pytest
from safe_robots import Log

from mdm import Ensemble, bind
from mdm.policies import DeterministicPolicy
from mdm.testing import run_virtual


def drives(log, **others):
    """An ensemble with three drives of a group, that take a second to end, and other actions."""

    def drive(name):
        async def work():
            log.append(f"{name} on")
            try:
                await asyncio.sleep(1e6)
            finally:
                await asyncio.sleep(1)
                log.append(f"{name} off")

        return bind(work, group="wheels")

    actions = {name: drive(name) for name in "ABC"} | others
    policy = DeterministicPolicy(list(range(len(actions))), len(actions))
    return Ensemble("robot", policy=policy, actions=actions, safe_action=log.plain("SAFE"))


def choose(robot, *actions):
    """Decide on actions within one step of the event loop."""
    for action in actions:
        robot.publish_state("ABCD".index(action))


@pytest.mark.parametrize("chosen", ["BA", "BCA", "BC", "B"])
@pytest.mark.parametrize("how", ["endanger", "stop", "end"])
def test_what_was_replaced_before_its_first_step_does_not_begin_behind_the_latch(chosen, how):
    log = Log()

    async def main(runtime):
        robot = drives(log)
        await runtime.start(robot)
        choose(robot, "A")
        await asyncio.sleep(1)
        choose(robot, *chosen)
        match how:
            case "endanger":
                robot.safety.endanger("mine", "", 0)
            case "stop":
                robot.stop()
            case "end":
                runtime.abort(SystemExit(3))
                await asyncio.sleep(5)
        await asyncio.sleep(5)
        assert [line for line in log if line != "SAFE"] == ["A on", "A off"]
        assert robot.mode == ("stopped" if how == "stop" else "safe")

    with pytest.raises(SystemExit) if how == "end" else pytest.MonkeyPatch.context():
        run_virtual(main)
    assert log[:2] == ["A on", "A off"]
    assert set(log[2:]) == {"SAFE"}


def test_what_is_replaced_before_its_first_step_never_begins():
    log = Log()

    async def main(runtime):
        robot = drives(log)
        await runtime.start(robot)
        choose(robot, "A")
        await asyncio.sleep(1)
        choose(robot, *"BCA")
        await asyncio.sleep(0.5)
        assert log == ["A on", "A on"]
        await asyncio.sleep(1)
        assert log == ["A on", "A on", "A off"]

    run_virtual(main)


def test_a_replaced_action_takes_no_further_step_behind_the_latch():
    log = Log()

    async def patrol():
        while True:
            log.append("step")
            await asyncio.sleep(0)

    async def main(runtime):
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"Patrol": bind(patrol, group=1), "Drive": bind(log.slow("Drive"), group=1)},
            safe_action=log.plain("SAFE"),
        )
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(0)
        robot.publish_state(1)
        robot.safety.endanger("mine", "", 0)
        before = len(log)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert "step" not in log[before:]

    run_virtual(main)


@pytest.mark.parametrize(
    ("pause", "before"), [(0.0, ["A on", "A off"]), (0.2, ["A on", "B on", "A off", "B off"])], ids=["at once", "later"]
)
@pytest.mark.parametrize("plain", [True, False])
def test_an_action_of_no_group_begins_when_all_that_were_replaced_have_ended(plain, pause, before):
    log = Log()

    async def main(runtime):
        robot = drives(log, D=log.plain("D begins") if plain else log.slow("D"))
        await runtime.start(robot)
        choose(robot, "A")
        await asyncio.sleep(1)
        choose(robot, "B")
        if pause:
            await asyncio.sleep(pause)
        choose(robot, "D")
        await asyncio.sleep(1.5)
        assert log == [*before, "D begins"]

    run_virtual(main)


def test_what_waits_for_the_replaced_gives_way_to_one_of_their_group():
    log = Log()

    async def main(runtime):
        robot = drives(log, D=log.plain("D"))
        await runtime.start(robot)
        choose(robot, "A")
        await asyncio.sleep(1)
        choose(robot, "B", "D")  # B never begins, so that D waits for A alone
        await asyncio.sleep(0.1)
        choose(robot, "C")
        await asyncio.sleep(3)
        assert log == ["A on", "C on", "A off"]
        assert robot.action.statistics().skipped == 1

    run_virtual(main)
