"""The end of ensembles: every one is made safe, the outermost last, with no way back."""

from __future__ import annotations

import asyncio
import sys
from contextlib import nullcontext, suppress

import pytest
from action_lives import lives_of, told
from safe_robots import Log, forever, robot, sensed, two_levels

from mdm import Actor, ActorFailure, Ensemble, PredicateManager, Restart, Runtime, StateFactor, bind, run
from mdm.testing import crash, run_virtual


def test_an_async_safe_action_runs_to_its_end_at_the_end_of_the_runtime():
    log = Log()

    async def main(runtime):
        one = robot(log, safe_action=log.slow("SAFE", 9.0))
        await runtime.start(one)
        one.publish_state(0)

    run_virtual(main)
    assert log == ["A", "SAFE begins", "SAFE ends"]


@pytest.mark.parametrize("broken", [None, "bottom", "middle", "top"])
def test_at_the_end_the_outermost_has_the_last_word_and_one_failure_stops_no_other(broken):
    log = Log()

    def safe(name):
        async def make_safe():
            await asyncio.sleep(0.5)
            log.append(name)
            if name == broken:
                raise LookupError

        return make_safe

    async def main(runtime):
        below = Ensemble("bottom", policy=[0], actions={"Work": forever}, safe_action=safe("bottom"))
        middle = Ensemble("middle", policy=[0], actions={"Below": below}, safe_action=safe("middle"))
        top = Ensemble("top", policy=[0], actions={"Below": middle}, safe_action=safe("top"))
        await runtime.start(top)
        for each in (below, middle, top):
            each.publish_state(0)
        assert below.action.live == ("Work",)

    run_virtual(main)
    assert list(dict.fromkeys(log)) == ["bottom", "middle", "top"]
    assert log == sorted(log, key=["bottom", "middle", "top"].index)


@pytest.mark.parametrize("how", ["runtime", "ensemble"])
def test_what_is_below_ends_with_what_is_above_and_has_not_succeeded(how):
    async def main():
        below = Ensemble("below", policy=[0], actions={"Work": forever})
        top = Ensemble("top", policy=[0], actions={"Below": below})
        async with Runtime(log=None) as runtime:
            lives = lives_of(runtime, "top")
            await runtime.start(top)
            for each in (below, top):
                each.publish_state(0)
            assert below.action.live == ("Work",)
            if how == "ensemble":
                await runtime.stop(top)
        assert told(lives) == [("Below", "running"), ("Below", "preempted")]

    run(main, virtual=True)


@pytest.mark.parametrize("how", ["release", "input"])
def test_while_it_ends_there_is_no_way_back(how):
    log = Log()

    async def main(runtime):
        top, below, sensor = two_levels(log, "Rest", "Below", safe_action=log.plain("TOP"), cleanup=3.0)
        await runtime.start(top)
        below.publish_state(0)
        below.start()  # by hand
        sensor.set(True)
        await asyncio.sleep(2)
        assert log == ["Rest", "Work begins", "TOP"]
        ending = asyncio.create_task(runtime.stop(top))
        await asyncio.sleep(1)
        if how == "release":
            top.release()
        else:
            sensor.set(False)
        await ending

    run_virtual(main)
    assert log == ["Rest", "Work begins", "TOP", "Work ends", "TOP"]


@pytest.mark.parametrize("how", ["exit", "signal", "failure", "return"])
def test_when_the_runtime_ends_all_of_it_goes_safe_at_once(how):
    log = Log()

    async def main():
        async with Runtime(log=None) as runtime:
            first = robot(log, safe_action=log.plain("FIRST"))
            second = Ensemble("second", policy=[0], actions={"C": log.plain("C")}, safe_action=log.slow("SECOND"))
            await runtime.start(first)
            await runtime.start(second)
            words = runtime.channel("words", str)

            def end(_):
                words.publish("rest of the turn")
                if how == "exit":
                    sys.exit(3)
                elif how == "signal":
                    runtime.abort(KeyboardInterrupt())
                elif how == "failure":
                    crash(second.control)

            words.subscribe(lambda word: end(word) if word == "end" else first.publish_state(1), second)
            first.publish_state(0)
            second.publish_state(0)
            if how != "return":
                words.publish("end")
                assert runtime.ending
                await asyncio.sleep(10)

    raised = {"exit": SystemExit, "signal": KeyboardInterrupt, "failure": ActorFailure}.get(how)
    with pytest.raises(raised) if raised else nullcontext():
        run(main, virtual=True)
    assert sorted(log[:4]) == ["A", "C", "FIRST", "SECOND begins"]
    assert log[4:] == ["SECOND ends"]


def test_at_the_end_what_lives_ends_at_once_however_long_what_is_below_takes():
    log = Log()

    async def main(runtime):
        below = Ensemble("below", policy=[0], actions={"Work": forever}, safe_action=log.slow("BELOW", 5.0))
        top = robot(log, actions={"A": log.slow("Drive", 100.0), "B": below}, safe_action=log.plain("TOP"))
        await runtime.start(top)
        top.publish_state(0)
        below.publish_state(0)
        below.start()  # by hand
        await asyncio.sleep(1)
        stopping = asyncio.create_task(runtime.stop(top))
        await asyncio.sleep(1)
        assert log == ["Drive begins", "Drive ends", "BELOW begins"]
        await stopping

    run_virtual(main)
    assert log[3:] == ["BELOW ends", "TOP"]


def test_what_a_safe_action_brings_about_at_the_end_starts_nothing_elsewhere():
    log, manager = Log(), PredicateManager()
    sensor = manager.sensor("S", initial=False)

    async def main(runtime):
        first = robot(log, predicates=manager, safe_action=lambda: sensor.set(True))
        moved = robot(log, "second", predicates=manager, states=[StateFactor("s", ["S"])])
        await runtime.start(first)
        await runtime.start(moved)

    run_virtual(main)
    assert log == ["A", "SAFE"]


def test_a_stop_that_comes_behind_the_end_does_not_spare_the_safe_action():
    log = Log()

    async def main(runtime):
        one = Actor("one")
        await runtime.start(one)
        below = Ensemble("below", policy=[0], actions={"Work": forever}, safe_action=log.slow("BELOW"))
        top = Ensemble("top", policy=[0], actions={"Below": below}, safe_action=log.plain("TOP"))
        await runtime.start(top)
        below.publish_state(0)
        top.publish_state(0)
        turn = runtime.channel("turn", str)

        def leave(_):
            top.stop()
            sys.exit(3)

        turn.subscribe(leave, one)
        turn.publish("leave")
        await asyncio.sleep(9)

    with pytest.raises(SystemExit):
        run_virtual(main)
    assert log == ["BELOW begins", "BELOW ends", "TOP"]


def _end_by(how, runtime, one):
    if how == "stop":
        one.interrupt()
    elif how == "failure":
        one.fail(LookupError("gear"))
    else:
        runtime.abort(LookupError("gear"))


@pytest.mark.parametrize("made_safe", ["plain", "slow"])
@pytest.mark.parametrize("how", ["failure", "abort"])
@pytest.mark.parametrize("then", ["returns", "raises", "goes on"])
def test_an_action_that_ends_what_decides_returns_before_the_safe_action_and_starts_nothing(made_safe, how, then):
    log = Log()

    async def main(runtime):
        def go():
            _end_by(how, runtime, one)
            log.append("rest of Go")
            if then == "raises":
                raise ValueError
            return log.slow("Drive")() if then == "goes on" else None

        one = robot(log, actions={"A": go, "B": forever}, safe_action=getattr(log, made_safe)("SAFE"))
        await runtime.start(one)
        one.publish_state(0)
        await asyncio.sleep(10)

    with pytest.raises(ActorFailure):
        run_virtual(main)
    assert log == ["rest of Go", *(["SAFE"] if made_safe == "plain" else ["SAFE begins", "SAFE ends"])]


def test_what_an_action_returns_that_has_stopped_its_ensemble_does_not_start():
    log = Log()

    async def main(runtime):
        def go():
            _end_by("stop", runtime, one)
            one.when_idle(lambda: log.append("idle"))
            log.append("rest of Go")
            return log.slow("Drive")()

        one = robot(log, actions={"A": go, "B": forever})
        await runtime.start(one)
        one.publish_state(0)
        await asyncio.sleep(10)
        assert (one.mode, one.action.ended) == ("stopped", {"preempted": 1})

    run_virtual(main)
    assert log == ["rest of Go", "idle", "SAFE"]


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt, asyncio.CancelledError])
@pytest.mark.parametrize("how", ["return", "failure"])
def test_a_safe_action_below_that_leaves_the_program_keeps_none_above_from_its_own(kind, how):
    log = Log()

    def leave():
        log.append("BELOW")
        raise kind

    async def main(runtime):
        below = robot(log, "below", safe_action=leave)
        top = Ensemble("top", policy=[0], actions={"Below": below}, safe_action=log.plain("TOP"))
        await runtime.start(top)
        top.publish_state(0)
        below.publish_state(1)
        if how == "failure":
            crash(below.control)
            await asyncio.sleep(10)

    raised = ActorFailure if how == "failure" else kind if kind is not asyncio.CancelledError else None
    with pytest.raises(raised) if raised else nullcontext():
        run_virtual(main)
    assert log == ["B", "BELOW", "BELOW", "TOP"]


@pytest.mark.parametrize("since", ["an action", "nothing", "the safe action"])
def test_at_the_end_what_has_stopped_runs_its_safe_action_where_an_action_has_begun_since_it_last_did(since):
    log = Log()

    async def main(runtime):
        one, _, sensor = sensed(log)
        await runtime.start(one)
        if since != "nothing":
            sensor.set(False)
        if since == "the safe action":
            sensor.set(None)
        one.stop()
        assert (one.mode, log) == ("stopped", {"an action": ["A"], "nothing": []}.get(since, ["A", "SAFE"]))

    run_virtual(main)
    assert log == ([] if since == "nothing" else ["A", "SAFE"])


@pytest.mark.parametrize("broken", [False, True])
def test_what_an_ensemble_above_has_left_is_made_safe_when_nothing_lives_there(broken):
    log = Log()

    async def stay():
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(2)
            log.append("Stay ends")

    async def main(runtime):
        below = robot(log, "below", safe_action=log.slow("BELOW"))
        top = Ensemble("top", policy=[0, 1], actions={"Below": below, "Stay": stay}, safe_action=log.plain("TOP"))
        await runtime.start(top)
        top.publish_state(0)
        below.publish_state(0)
        top.publish_state(1)
        await asyncio.sleep(1)
        assert (below.mode, top.action.live) == ("stopped", ("Stay",))
        if broken:
            crash(top.action)
            await asyncio.sleep(60)

    with pytest.raises(ActorFailure) if broken else nullcontext():
        run_virtual(main)
    assert log == ["A", "Stay ends", "BELOW begins", "BELOW ends", "TOP"]


def test_an_action_layer_that_fails_while_it_makes_safe_keeps_the_limit_of_what_is_to_end():
    log = Log()

    async def deaf():
        while True:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(100.0)
                return

    async def main(runtime):
        one, _, sensor = sensed(log, actions={"A": bind(deaf, grace=0.5), "B": log.plain("B")})
        await runtime.start(one)
        sensor.set(False)
        sensor.set(None)
        crash(one.action)
        await asyncio.sleep(1.0)
        assert log == ["SAFE"]

    with pytest.raises(ActorFailure):
        run_virtual(main)


def test_below_what_has_failed_and_comes_to_its_end_nothing_is_started_by_hand():
    log = Log()

    async def stay():
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(2)

    async def main(runtime):
        below = robot(log, "below")
        top = Ensemble(
            "top",
            policy=[0, 1],
            actions={"Below": below, "Stay": stay},
            safe_action=log.plain("TOP"),
            supervision=Restart(backoff=5.0),
        )
        await runtime.start(top)
        top.publish_state(0)
        below.publish_state(0)
        top.publish_state(1)
        await asyncio.sleep(1)
        log.clear()
        crash(top.action)
        await asyncio.sleep(0.1)
        below.start()
        await asyncio.sleep(3)
        assert log == ["SAFE", "TOP"]

    run_virtual(main)


def left(log, **options):
    """An ensemble, one that it has left for an action that takes two seconds to end, and a sensor of the first."""

    async def stay():
        try:
            await asyncio.sleep(1e6)
        finally:
            await asyncio.sleep(2)
            log.append("Stay ends")

    below = options.pop("below")
    actions = {"Below": below, "Stay": stay}
    return sensed(log, name="top", actions=actions, supervision=Restart(backoff=60.0), **options)


async def leave(top, below, sensor, runtime):
    await runtime.start(top)
    sensor.set(False)
    below.publish_state(0)
    sensor.set(True)
    await asyncio.sleep(1)


def test_what_was_started_by_hand_has_no_way_back_where_one_far_above_it_comes_to_its_end():
    log = Log()

    async def main(runtime):
        bottom, _, sight = sensed(log, name="bottom")
        below = robot(log, "below", actions={"Bottom": bottom, "B": log.plain("B")}, safe_action=log.plain("BELOW"))
        top, _, sensor = left(log, below=below, safe_action=log.plain("TOP"))
        await leave(top, below, sensor, runtime)
        bottom.start()
        sight.set(False)
        sight.set(None)
        assert (below.mode, bottom.mode, log) == ("stopped", "safe", ["A", "SAFE"])
        crash(top.action)
        sight.set(False)
        await asyncio.sleep(3)
        assert log == ["A", "SAFE", "Stay ends", "SAFE", "BELOW", "TOP"]

    run_virtual(main)


def test_what_was_left_is_made_safe_as_soon_as_a_plain_safe_action_has_run_above_it():
    log = Log()

    async def main(runtime):
        below = robot(log, "below", safe_action=log.plain("BELOW"))
        top, _, sensor = left(log, below=below, safe_action=log.plain("TOP"))
        await leave(top, below, sensor, runtime)
        sensor.set(None)
        crash(top.action)
        await asyncio.sleep(3)
        assert log == ["A", "Stay ends", "TOP", "BELOW", "TOP"]

    run_virtual(main)


def test_what_fails_when_the_runtime_ends_keeps_the_limit_after_which_what_it_has_left_is_made_safe():
    log = Log()

    async def main(runtime):
        below = robot(log, "below", actions={"A": bind(log.plain("A"), grace=1.0)}, policy=[0])
        top, _, sensor = left(log, below=below, safe_action=log.slow("TOP", 60.0), safe_timeout=90.0)
        await leave(top, below, sensor, runtime)
        sensor.set(None)
        await asyncio.sleep(3)
        runtime.abort(KeyboardInterrupt())
        crash(top.action)

    with pytest.raises(KeyboardInterrupt):
        run_virtual(main)
    assert log[:5] == ["A", "Stay ends", "TOP begins", "SAFE", "TOP ends"]
