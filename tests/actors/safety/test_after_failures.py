"""After an action's end something is decided, or it is told why not: whatever ends, reacts, and makes safe."""

from __future__ import annotations

import asyncio
from itertools import pairwise

import numpy as np
import pytest
from action_lives import Body, lives_of, told
from drives import Robot
from hypothesis import given, settings, strategies as st
from rows_of_rooms import row_of_rooms

from mdm import Ensemble, PredicateManager, StateFactor, bind
from mdm.actors import AbandonedError
from mdm.errors import Error
from mdm.maps import Navigation, Places
from mdm.models import POMDP
from mdm.policies import AlphaVectors, DeterministicPolicy
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


# -- A safe action that is named --------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [lambda: None, Body("Stop", [], 0.5)], ids=["plain", "lasting"])
@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("drive", ["event", 4.0])
def test_behind_a_named_safe_action_it_is_decided_again_when_the_pause_is_over(drive, end, stop):
    """It counted as the action that was chosen, so that the other one's failure was followed by nothing."""
    function, options = ENDS[end]

    async def main(runtime):
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"Go": bind(function, then="decide", **options), "Stop": stop},
            safe_action="Stop",
            drive=drive,
        )
        await runtime.start(robot)
        lives = lives_of(runtime)
        robot.publish_state(0)
        await asyncio.sleep(0.3)
        while robot.mode != "safe":
            await asyncio.sleep(0.1)
        failed = next(life.time / 1e9 for life in lives if life.status in {"failed", "timed_out", "abandoned"})
        assert robot.statistics().waiting[0].startswith("a pause of 1 s, for action 'Go' ")
        await asyncio.sleep(30)
        again = begun(lives)[1]
        assert failed + 1.0 <= again <= failed + 1.25

    run_virtual(main)


def test_a_safe_action_that_is_tried_again_leaves_the_pause_as_it_is():
    """Its second try took the pause with it, so that the robot was safe for ever after."""
    tries = iter([raises])

    def stop():
        next(tries, lambda: None)()

    async def main(runtime):
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0]),
            actions={"Go": bind(break_off, then="decide")},
            safe_action=stop,
        )
        await runtime.start(robot)
        lives = lives_of(runtime)
        robot.publish_state(0)
        await asyncio.sleep(1.5)
        assert robot.mode == "safe"
        assert robot.statistics().waiting == ("a pause of 1 s, for action 'Go' failed",)
        await asyncio.sleep(1.0)
        assert begun(lives) == [0.0, 2.0]

    run_virtual(main)


# -- What has been replaced -------------------------------------------------------------------------------------------


def braking(error):
    """An action that takes half a second to brake, and raises then."""

    async def go():
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(0.5)
            raise error

    return go


@pytest.mark.parametrize("safe", [None, "Stop", lambda: None])
@pytest.mark.parametrize("then", [None, "decide"])
def test_the_cleanup_of_an_action_that_was_replaced_takes_nothing_with_it(then, safe):
    async def main(runtime):
        log = []
        actions = {"Go": bind(braking(OSError("no brake")), then=then), "Turn": Body("Turn", log), "Stop": lambda: None}
        robot = Ensemble("robot", policy=DeterministicPolicy([0, 1, 2]), actions=actions, safe_action=safe)
        await runtime.start(robot)
        faults = probe(runtime.faults)
        robot.publish_state(0)
        await asyncio.sleep(1)
        robot.publish_state(1)
        await asyncio.sleep(60)
        assert (robot.mode, log, robot.action.live) == ("deciding", ["Turn begins"], ("Turn",))
        (fault,) = faults
        assert fault.detail.startswith("action 'Go' failed: OSError: no brake")

    run_virtual(main)


def test_an_action_that_starts_anew_is_not_kept_from_it_by_the_cleanup_of_its_life_before():
    async def main(runtime):
        go = bind(braking(OSError("no brake")), on_repeat="restart", attempts=1)
        robot = Ensemble("robot", policy=[0, 0], actions={"Go": go}, safe_action=lambda: None)
        await runtime.start(robot)
        lives = lives_of(runtime)
        for state in (0, 1, 0):
            robot.publish_state(state)
            await asyncio.sleep(1)
        assert (robot.mode, begun(lives)) == ("deciding", [0.0, 1.5, 2.5])

    run_virtual(main)


@pytest.mark.parametrize("end", ["times out", "is abandoned"])
@pytest.mark.parametrize("stop", [lambda: None, Body("Stop", [], 0.5)], ids=["plain", "lasting"])
def test_what_was_decided_before_a_failure_had_ended_is_decided_again_behind_the_safe_action(end, stop):
    """It was the way back, and had come already: the robot stood until another input came."""
    log = []

    async def slow():
        try:
            await asyncio.sleep(1e6)
        except asyncio.CancelledError:
            await asyncio.sleep(2 if end == "times out" else 1e6)

    async def main(runtime):
        go = bind(slow, timeout=1.0 if end == "times out" else None, grace=3.0)
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1, 2]),
            actions={"Go": go, "Turn": Body("Turn", log), "Stop": stop},
            safe_action="Stop",
        )
        await runtime.start(robot)
        lives = lives_of(runtime)
        robot.publish_state(0)
        await asyncio.sleep(2)
        robot.publish_state(1)
        await asyncio.sleep(60)
        assert (robot.mode, robot.action.live) == ("deciding", ("Turn",))
        assert [action for action, status in told(lives) if status == "running"] == ["Go", "safe action", "Turn"]

    run_virtual(main)


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


@pytest.mark.parametrize(
    ("error", "began"),
    [(Error, ["Go", "Turn"]), (AbandonedError, ["Go", "safe action", "Turn"])],
)
def test_an_action_whose_device_may_go_on_counts_as_abandoned(error, began):
    async def go():
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            await asyncio.sleep(0.5)
            raise error("the base does not answer") from None

    async def main(runtime):
        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1]),
            actions={"Go": go, "Turn": lambda: None},
            safe_action=lambda: None,
        )
        await runtime.start(robot)
        lives, faults = lives_of(runtime), probe(runtime.faults)
        robot.publish_state(0)
        await asyncio.sleep(1)
        robot.publish_state(1)
        await asyncio.sleep(1)
        status = "failed" if error is Error else "abandoned"
        assert [action for action, status in told(lives) if status == "running"] == began
        assert ("Go", status) in told(lives)
        assert faults[0].detail.startswith(f"action 'Go' {status}: {error.__name__}: the base does not answer")
        assert (robot.mode, runtime.abandoned) == ("deciding", [])

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


# -- The promise ------------------------------------------------------------------------------------------------------

BRAKE = 0.5
"""Seconds that a safe action takes which takes time."""
SAFE = {
    "none": None,
    "function": lambda: None,
    "async function": Body("SAFE", [], BRAKE),
    "name": "Stop",
    "name of one that lasts": "Brake",
    "itself": "Go",
}
LIVES = st.sampled_from(["succeeds", *ENDS, "brakes badly"])


async def arrive():
    await asyncio.sleep(1.0)


def go_of(end):
    """Return what `Go` does, and the options by which it comes to that end."""
    more = {"succeeds": (arrive, {}), "brakes badly": (braking(OSError("no brake")), {"timeout": 1.0})}
    return (ENDS | more)[end]


def robot_of(policy, safe, drive, go, reactions):
    actions = {"Go": go, "Stop": lambda: None, "Brake": Body("Brake", [], BRAKE)}
    options = reactions | ({} if SAFE[safe] is None else {"safe_action": SAFE[safe]}) | {"drive": drive}
    if SAFE[safe] is None and options.get("on_failed_action") == "safe":
        options.pop("on_failed_action")
    if policy == "states":
        return Ensemble("robot", policy=DeterministicPolicy([0, 1], 3), actions=actions, **options)
    model = POMDP([np.eye(2)] * 3, [np.ones((2, 1))] * 3, np.zeros((2, 3)), discount=0.9, actions=list(actions))
    vectors = AlphaVectors(np.array([[1.0, 1.0]]), [0], num_actions=3)
    return Ensemble("robot", policy=vectors, model=model, actions=actions, **options)


def stands_untold(robot, faults):
    """Whether it does nothing, and does not say why."""
    if robot.mode == "safe":
        kinds = {fault.kind for fault in faults}
        return not (robot.action.busy or all(cause.kind in kinds for cause in robot.causes))
    statistics, liveness = robot.statistics(), robot.liveness
    stands = robot.control.acted is not None and liveness._end is None  # what a function has set goes on
    ticks = not robot.control.event_driven
    return not (robot.action.busy or statistics.waiting or liveness.since is not None or stands or ticks)


@settings(max_examples=60, deadline=None)
@given(
    policy=st.sampled_from(["states", "beliefs"]),
    end=LIVES,
    then=st.sampled_from(["decide", "decide", None, "wait"]),
    pause=st.sampled_from([0.25, 1.0]),
    attempts=st.sampled_from([None, None, 2]),
    safe=st.sampled_from([*SAFE]),
    reaction=st.sampled_from([None, "safe", "continue", "decide"]),
    drive=st.sampled_from(["event", 4.0, 0.7]),
    replaced=st.booleans(),
)
def test_whatever_ends_it_is_decided_again_or_told_why_not(
    policy, end, then, pause, attempts, safe, reaction, drive, replaced
):
    function, options = go_of(end)
    grace = options.get("grace", 1.0)
    go = bind(function, then=then, pause=pause, attempts=attempts, **options | {"grace": grace})
    own_safe_action_fails = safe == "itself" and end != "succeeds"

    async def main(runtime):
        robot = robot_of(policy, safe, drive, go, {} if reaction is None else {"on_failed_action": reaction})
        lives, faults = lives_of(runtime), probe(runtime.faults)
        await runtime.start(robot)
        if policy == "states":
            robot.publish_state(0)
        if replaced and policy == "states":
            await asyncio.sleep(0.6)
            robot.publish_state(1)
            await asyncio.sleep(0.01)
            robot.publish_state(0)
        for _ in range(120):
            await asyncio.sleep(0.25)
            assert not stands_untold(robot, faults), (robot.mode, robot.causes, told(lives))
        return lives, robot.causes

    lives, causes = run_virtual(main, emergency=lambda: None)
    if then != "decide" or attempts is not None or own_safe_action_fails:
        return
    assert causes == () or end != "succeeds"
    most, failures = 30.0 - BRAKE, 0
    rate = 0.0 if drive == "event" else 1.0 / drive
    for life, nexts in pairwise([*lives, None]):
        if life.action != "Go" or life.status == "running":
            continue
        failures = failures + 1 if life.status in {"failed", "timed_out", "abandoned"} else 0
        latest = life.time / 1e9 + pause * 2.0 ** max(failures - 1, 0) + rate + BRAKE + 0.01
        following = [other for other in lives if other.time >= life.time and other.life > life.life]
        decided = [other for other in following if other.action != "safe action"]
        if latest < most:
            assert decided, (life, nexts)
            assert decided[0].time / 1e9 <= latest, (life, decided[0])


# -- What `mdm check` says of it --------------------------------------------------------------------------------------


def dead_end(key, case, way_out):
    alone = "for only the ensemble's own actions change what it decides on (Rest.succeeded, Work.succeeded)"
    return [
        f"ensembles.guard.{key}: where {case}, nothing but a release leads out of the safe mode, {alone}: {way_out}"
    ]


FAILED = dead_end("actions.Work", "Work has failed", 'say then = "decide" at the action')


@pytest.mark.parametrize(
    ("options", "work", "latch", "told"),
    [
        ({}, {}, "Work.succeeded", FAILED),
        ({"drive": 2.0}, {}, "Work.succeeded", FAILED),
        ({}, {"then": "decide"}, "Work.succeeded", []),
        ({}, {"then": "wait"}, "Work.succeeded", FAILED),
        ({}, {}, "Work.succeeded or Work.failed", []),  # that is heeded
        ({}, {}, "Work.succeeded or Seen", []),  # and that comes from elsewhere
        ({"on_failed_action": "continue"}, {}, "Work.succeeded", []),
        ({"on_failed_action": "decide"}, {}, "Work.succeeded", []),
        ({"safe_action": None}, {}, "Work.succeeded", []),
        (
            {},
            {"then": "decide", "attempts": 2},
            "Work.succeeded",
            dead_end("actions.Work", "Work is given up", "use Work.gave_up, or leave attempts out"),
        ),
        ({}, {"then": "decide", "attempts": 2}, "Work.succeeded or Work.gave_up", []),
        (
            {"deadline": 0.5},
            {"then": "decide"},
            "Work.succeeded",
            dead_end("deadline", "a decision was late", "decide at a fixed rate, or leave the deadline out"),
        ),
        ({"deadline": 0.5, "drive": 2.0}, {"then": "decide"}, "Work.succeeded", []),
    ],
)
def test_safe_modes_that_nothing_leads_out_of_are_noted(options, work, latch, told):
    manager = PredicateManager()
    manager.sensor("Seen")
    manager.latch("Worked", set=latch, reset="Rest.succeeded", initial=False)
    actions = {"Work": bind(forever, timeout=5.0 if "failed" not in latch else None, **work), "Rest": lambda: None}
    guard = Ensemble(
        "guard",
        policy=[0, 1],
        predicates=manager,
        states=[StateFactor("worked", ["Worked"])],
        actions=actions,
        **{"safe_action": lambda: None} | options,
    )
    assert [note for note in guard.notes() if "leads out" in note] == told
    Ensemble("above", policy=[0], actions={"go": guard})
    assert not [note for note in guard.notes() if "leads out" in note]  # what is above may end it


def test_where_only_a_place_is_decided_on_nothing_leads_out_but_a_drive():
    floor, predicates = row_of_rooms("A", "B"), PredicateManager()
    places = Places(floor, predicates)
    navigation = Navigation(floor, Robot(floor, PredicateManager(), 0.0, 0.0), places)

    def noted(**actions):
        robot = Ensemble(
            "robot",
            policy=[0, 0],
            predicates=predicates,
            states=[StateFactor("place", ["A.reached", "B.reached"])],
            actions=actions,
            safe_action=lambda: None,
        )
        return [note.partition(":")[0] for note in robot.notes() if "leads out" in note]

    assert noted(Right=navigation.way("Right")) == []
    assert noted(Right=forever) == ["ensembles.robot.actions.Right"]
    assert noted(Right=navigation.way("Right", then="wait")) == ["ensembles.robot.actions.Right"]
