"""Searches in a process of their own: who answers, when, and that nothing is delayed or left behind."""

from __future__ import annotations

import asyncio
import os
import select
import signal
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_dangers import HIDDEN
from patience import PATIENCE
from places import EXAMPLES
from programs import python
from sentences import refused
from shielded import Kept

import mdm
from mdm.actors import ControlLayer
from mdm.actors.control.planner import SearchProcess
from mdm.config.rebuilt import rebuilt
from mdm.messages import Action, Answer, Belief, Observation, Question, State
from mdm.recording import Record
from mdm.replay import replay
from mdm.snapshots.why import why_recorded
from mdm.testing import capture_decisions, probe, run_virtual

TIGER = EXAMPLES / "tiger.pomdp"
LISTEN = mdm.policies.AlphaVectors([[0.0, 0.0]], [0], 3)


def nothing():
    pass


@pytest.fixture(scope="module")
def tiger():
    model = mdm.load_model(TIGER)
    mdm.solvers.TreeSearch(model, expansions=1).prepare()  # compiles, so that no process has to
    return model


def ensemble(model, *, drive=None, deadline=None, horizon=None, safe_action=None, **options):
    return mdm.Ensemble(
        "tiger",
        model=model,
        policy=mdm.solvers.TreeSearch(model, **options),
        actions={"listen": nothing, "open-left": nothing, "open-right": nothing},
        drive=drive,
        deadline=deadline,
        horizon=horizon,
        safe_action=safe_action,
    )


def live(main, patience=60, log=None, **options):
    """Run a coroutine function with a runtime in real time, within so many seconds."""

    async def program():
        async with asyncio.timeout(patience), mdm.Runtime(log=log, **options) as runtime:
            return await main(runtime)

    return asyncio.run(program())


def is_gone(pid):
    """Wait for the end of a process that may be nobody's child any more."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([descriptor], [], [], 30)[0])
    finally:
        os.close(descriptor)


@pytest.mark.slow
@pytest.mark.compiled("search", where_possible=True)
def test_the_search_decides_and_the_loop_goes_on(tiger):
    """While a search of 0.3 s goes on, another ensemble goes on to decide, 100 times a second."""
    searching = ensemble(tiger, seconds=0.3)
    beside = mdm.Ensemble(
        "beside", policy=mdm.policies.QTable([[0.0]]), actions={"stay": nothing}, drive=mdm.FixedRate(100.0)
    )

    async def main(runtime):
        await runtime.start(beside)
        beside.publish_state(0)
        await runtime.start(searching)
        decisions = probe(searching.channel("action", mdm.messages.Action))
        counts = []
        answers = searching.channel("answer", Answer).stream()
        async for answer in answers:  # the first waits for the process
            assert answer.source == "search"
            counts.append(beside.control.statistics().decisions)
            if len(counts) == 4:
                break
            searching.publish_observation(0)
        pid = searching.control.planner.pid
        return decisions, counts, searching.control.planner.statistics(), pid

    decisions, counts, statistics, pid = live(main)
    assert [(action.epoch, action.index) for action in decisions][:3] == [(0, 0), (1, 0), (2, 2)]
    # 30 where nothing else runs; a search that holds the loop lets one pass, for those that it missed are one
    assert all(after - before >= 3 for before, after in pairwise(counts))
    assert (statistics.asked, statistics.searched, statistics.fallbacks, statistics.late) == (4, 4, 0, 0)
    assert statistics.expansions > 0
    assert is_gone(pid)


def test_decisions_are_those_of_the_search_itself(tiger):
    async def main(runtime):
        one = ensemble(tiger, expansions=200, seed=3)
        with capture_decisions(runtime) as decisions:
            await runtime.start(one)
            async for _ in one.channel("answer", Answer).stream():
                if len(decisions) == 6:
                    break
                one.publish_observation(0)
        return decisions

    decisions = live(main)
    policy = mdm.solvers.TreeSearch(tiger, expansions=200, seed=3)
    assert [d.action for d in decisions] == [policy.action(d.belief) for d in decisions]
    assert [d.epoch for d in decisions] == list(range(6))
    assert [d.cause for d in decisions] == ["start", *["observation"] * 5]
    assert all(d.time > 0 for d in decisions)


def test_the_fallback_decides_until_the_process_is_ready_and_by_the_deadline(tiger):
    async def main(runtime):
        one = ensemble(tiger, seconds=30.0, deadline=0.05, fallback=LISTEN)
        faults = probe(runtime.faults)
        await runtime.start(one)
        answers = runtime.channel("tiger/answer", Answer).stream()
        one.publish_observation(0)
        first = await anext(answers)
        assert first.source == "fallback"
        assert faults == []
        await one.ready()
        one.publish_observation(0)
        second = await anext(answers)
        assert second.source == "fallback"
        assert [fault.kind for fault in faults] == ["deadline"]
        assert "no answer after 0.05 s: the fallback decides" in faults[0].detail
        # The next question makes the process answer the last one, which nobody waits for any more.
        while not one.control.planner.statistics().late:
            one.publish_observation(0)
            assert (await anext(answers)).source == "fallback"
        return one.control.planner.statistics(), one.controller.epoch

    statistics, epoch = live(main)
    assert statistics.fallbacks == epoch == statistics.asked
    assert statistics.searched == 0


def test_a_stimulus_meanwhile_is_taken_in_and_asked_about_anew(tiger):
    async def main(runtime):
        one = ensemble(tiger, expansions=300)
        with capture_decisions(runtime) as decisions:
            await runtime.start(one)
            answers = runtime.channel("tiger/answer", Answer).stream()
            await anext(answers)
            one.publish_observation(0)
            one.publish_observation(0)
            await anext(answers)
        return decisions, one.control.planner.statistics()

    decisions, statistics = live(main)
    assert [decision.epoch for decision in decisions] == [0, 1]
    np.testing.assert_allclose(decisions[1].belief, [0.85**2 / (0.85**2 + 0.15**2), 0.15**2 / (0.85**2 + 0.15**2)])
    assert decisions[1].action_name == "open-right"
    assert statistics.superseded == 1


def test_what_was_asked_before_a_reset_decides_nothing(tiger):
    async def main(runtime):
        one = ensemble(tiger, drive=mdm.FixedRate(20.0), seconds=0.01)
        made = runtime.decisions.stream()
        with capture_decisions(runtime) as decisions:
            questions = runtime.channel("tiger/question", Question).stream()
            await runtime.start(one)
            asked = (await anext(questions)).number  # nothing answers before there is a process
            one.reset()
            runtime.channel("tiger/answer", Answer).publish(Answer(runtime.clock.now(), asked, 1, "search"))
            assert not decisions
            await one.ready()
            await anext(made)
        assert (decisions[0].epoch, decisions[0].cause, decisions[0].action) == (0, "tick", 0)

    live(main)


def test_at_a_fixed_rate_what_was_asked_is_asked_anew_from_a_belief_from_outside(tiger):
    async def main(runtime):
        one = ensemble(tiger, drive=mdm.FixedRate(20.0), seconds=0.01)
        with capture_decisions(runtime) as decisions:
            questions = runtime.channel("tiger/question", Question).stream()
            await runtime.start(one)
            asked = (await anext(questions)).number  # nothing answers before there is a process
            one.publish_belief([1.0, 0.0])
            runtime.channel("tiger/external_belief", Belief).publish(Belief(0, np.array([np.nan, 0.0])))
            for number in (asked, asked + 1):
                runtime.channel("tiger/answer", Answer).publish(Answer(runtime.clock.now(), number, 0, "search"))
        return decisions, one.control.planner.statistics()

    decisions, statistics = live(main)
    assert [(tuple(d.belief), d.epoch, d.cause) for d in decisions] == [((1.0, 0.0), 0, "tick")]
    assert (statistics.asked, statistics.superseded) == (2, 1)


def test_a_process_that_dies_is_reported_and_started_anew(tiger):
    async def main(runtime):
        one = ensemble(tiger, seconds=30.0, deadline=20.0, fallback=LISTEN)
        faults = probe(runtime.faults)
        await runtime.start(one)
        answers = runtime.channel("tiger/answer", Answer).stream()
        await one.ready()
        one.publish_observation(0)
        before = one.control.planner.pid
        os.kill(before, signal.SIGKILL)  # while it searches
        answer = await anext(answers)
        while answer.number < 2:
            answer = await anext(answers)
        await one.ready()
        return answer, faults, before, one.control.planner.pid, one.control.planner.statistics()

    # a busy machine may hold the loop for a second, and that would be a fault, too
    answer, faults, before, after, statistics = live(main, watchdog=None)
    assert answer.source == "fallback"
    assert [fault.kind for fault in faults] == ["search"]
    assert "has ended by itself, with status -9" in faults[0].detail
    assert before != after
    assert statistics.processes == 2
    assert is_gone(before)
    assert is_gone(after)


@pytest.mark.parametrize("fallback", [None, LISTEN])
def test_a_process_that_cannot_live(tiger, fallback, monkeypatch):
    async def fail(_):
        raise OSError("no more processes")

    monkeypatch.setattr(SearchProcess, "start", fail)

    async def main(runtime):
        one = ensemble(tiger, seconds=0.1, fallback=fallback)
        given_up = asyncio.Event()
        faults = probe(runtime.faults)
        runtime.faults.subscribe(lambda fault: "not started any more" in fault.detail and given_up.set())
        await runtime.start(one)
        await (given_up.wait() if fallback else runtime.wait())
        one.publish_observation(0)
        return faults, one.controller.epoch

    if fallback is None:
        with refused(mdm.ActorFailure):
            live(main)
        return
    faults, epoch = live(main)
    assert epoch == 2
    assert len(faults) == 5


def test_without_a_fallback_a_missed_deadline_is_for_the_safe_action(tiger):
    made_safe = asyncio.Event()

    async def main(runtime):
        one = ensemble(tiger, seconds=30.0, deadline=0.05, safe_action=made_safe.set)
        faults = probe(runtime.faults)
        await runtime.start(one)
        await made_safe.wait()
        return faults, one.controller.epoch

    faults, epoch = live(main)
    assert faults[0].kind == "deadline"
    assert epoch == 0


@pytest.mark.parametrize("searches", [True, False])
def test_nothing_is_done_that_is_decided_long_after_the_deadline(tiger, searches, monkeypatch):
    made_safe = asyncio.Event()

    async def fail(_):
        raise OSError("no more processes")

    if not searches:
        monkeypatch.setattr(SearchProcess, "start", fail)

    async def main(runtime):
        one = ensemble(tiger, seconds=30.0, deadline=20.0, fallback=LISTEN, safe_action=made_safe.set)
        faults = probe(runtime.faults)
        await runtime.start(one)
        if searches:
            await one.ready()
        with capture_decisions(runtime) as decisions:
            held = runtime.clock.now() - 30 * 10**9  # as if the loop had not turned since
            runtime.channel("tiger/observation", Observation).publish(Observation(held, 0, (0,), (True,)))
            await made_safe.wait()
        assert not decisions
        assert (one.mode, [cause.kind for cause in one.causes]) == ("safe", ["deadline"])
        return [fault.detail for fault in faults if fault.source == "tiger/control"]

    (late,) = live(main)
    assert late.endswith("after its stimulus; the deadline is 20.0 s")


@pytest.mark.parametrize(("fallback", "source"), [(LISTEN, "fallback"), (None, "nothing")])
def test_what_the_search_finds_after_the_deadline_decides_nothing_though_the_loop_comes_late(tiger, fallback, source):
    async def main(runtime):
        one = ensemble(tiger, seconds=30.0, deadline=20.0, fallback=fallback)
        await runtime.start(one)
        await one.ready()
        planner = one.control.planner
        answers, faults = probe(runtime.channel("tiger/answer", Answer)), probe(runtime.faults)
        asked = runtime.clock.now() - 20_001_000_000  # as if the loop had not turned since, a millisecond too long
        runtime.channel("tiger/observation", Observation).publish(Observation(asked, 0, (0,), (True,)))
        runtime.dispatcher.deliver(planner._found, (planner._open.number, SimpleNamespace(action=2, expansions=10)))
        return [answer.source for answer in answers], faults, planner.statistics()

    sources, faults, statistics = live(main)
    assert sources == [source]
    assert {fault.kind for fault in faults} == {"deadline"}
    assert (statistics.searched, statistics.late) == (0, 1)


def test_stopping_while_it_searches(tiger):
    async def main(runtime):
        one = ensemble(tiger, seconds=30.0)
        await runtime.start(one)
        await one.ready()
        pid = one.control.planner.pid
        one.stop()
        one.start()
        await runtime.stop(one)
        return pid, one.controller.epoch

    pid, epoch = live(main)
    assert is_gone(pid)
    assert epoch == 0


PROGRAM = """
import asyncio, mdm, signal, os, sys
model = mdm.load_model({path!r})
async def main():
    async with mdm.Runtime(log=None) as runtime:
        one = mdm.Ensemble("one", model=model, policy=mdm.solvers.TreeSearch(model, seconds=30.0),
                           actions=dict.fromkeys(range(3), print))
        await runtime.start(one)
        await one.ready()
        print(one.control.planner.pid, flush=True)
        await runtime.wait()
mdm.run(main)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.usefixtures("tiger")
def test_the_process_ends_with_the_program(number):
    with python("-W", "error", "-c", PROGRAM.format(path=str(TIGER))) as program:
        pid = int(program.stdout.readline())
        os.killpg(program.pid, number)
        _, errors = program.communicate()
        assert is_gone(pid)
    assert "solvers/online/worker" not in errors
    assert {signal.SIGINT: "KeyboardInterrupt" in errors, signal.SIGTERM: errors == "", signal.SIGKILL: True}[number]


def test_in_virtual_time_the_search_runs_in_the_turn(tiger):
    def decisions():
        async def main(runtime):
            one = ensemble(tiger, expansions=100, seconds=1e-9, seed=1, drive=mdm.FixedRate(2.0))
            await one_world(runtime, one)
            with capture_decisions(runtime) as decided:
                await runtime.clock.sleep(9.9)
            return [(d.time, d.epoch, d.action, tuple(d.belief)) for d in decided], one.control.planner.pid

        async def one_world(runtime, one):
            await runtime.start(mdm.World(one, seed=5))
            await runtime.start(one)

        return run_virtual(main)

    first, _ = decisions()
    assert decisions() == (first, None)
    assert [time for time, *_ in first] == [500_000_000 * tick for tick in range(20)]
    assert len({action for _, _, action, _ in first}) > 1


def test_what_is_refused(tiger):
    with refused(mdm.ConfigError):
        run_virtual(lambda runtime: runtime.start(ensemble(tiger, seconds=0.1)))
    with refused(mdm.ConfigError):
        ensemble(tiger, seconds=0.5, drive=mdm.FixedRate(10.0))
    with refused(mdm.ConfigError):
        ControlLayer(mdm.solvers.TreeSearch(tiger.with_false_negatives(0), expansions=1), tiger)
    with refused(mdm.ModelError):
        mdm.solvers.TreeSearch(tiger, expansions=1, fallback=mdm.solvers.TreeSearch(tiger, expansions=1))


def test_states_of_an_mdp():
    chain = mdm.models.MDP(
        [[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]],
        [[0.0, 0.0], [1.0, 0.0]],
        discount=0.9,
        actions=["stay", "go"],
    )

    async def main(runtime):
        one = mdm.Ensemble(
            "one",
            model=chain,
            policy=mdm.solvers.TreeSearch(chain, expansions=50),
            actions={"stay": nothing, "go": nothing},
        )
        faults = probe(runtime.faults)
        with capture_decisions(runtime) as decisions:
            await runtime.start(one)
            for state in (0, 1):
                one.publish_state(state)
            one.channel("state", State, retain=True).publish(State(0, 7, (7,)))
        return [(d.state, d.action_name) for d in decisions], one.control.planner.statistics(), faults

    decisions, statistics, faults = run_virtual(main)
    assert decisions == [(0, "go"), (1, "stay")]
    assert (statistics.asked, statistics.searched) == (2, 2)  # the loop has not searched itself
    assert "there is no symbol 7" in faults[0].detail


def test_a_process_that_is_stopped_has_the_newest_question_alone_waiting(tiger):
    policy = mdm.solvers.TreeSearch(tiger, expansions=1)
    question = policy.belief_of(np.array([0.5, 0.5]))

    async def main():
        process = SearchProcess(policy)
        try:
            await process.start()
            os.kill(process.pid, signal.SIGSTOP)
            for number in range(5000):
                process.ask(number, *question)
            kept = process._process.stdin.transport.get_write_buffer_size()
            os.kill(process.pid, signal.SIGCONT)
            numbers = [(await process.answer())[0]]
            while numbers[-1] < 4999:
                numbers.append((await process.answer())[0])
            return kept, numbers
        finally:
            await process.end()

    kept, numbers = asyncio.run(asyncio.wait_for(main(), PATIENCE))
    assert kept < 1000
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 2000  # as many as a pipe holds


def test_a_process_that_is_stopped_is_told_where_nothing_else_decides(tiger, monkeypatch):
    monkeypatch.setattr("mdm.actors.control.planner._SILENCE", 0.2)

    async def main(runtime):
        one = ensemble(tiger, expansions=100)
        await runtime.start(one)
        answers = runtime.channel("tiger/answer", Answer).stream()
        await one.ready()
        await anext(answers)
        faults, told = probe(runtime.faults), runtime.faults.stream()
        os.kill(one.control.planner.pid, signal.SIGSTOP)
        try:
            one.publish_observation(0)
            await anext(told)
            one.publish_observation(0)
            count = len(faults)
        finally:
            os.kill(one.control.planner.pid, signal.SIGCONT)
        await anext(answers)
        return count, faults[0]

    told, fault = live(main)
    assert told == 1
    assert (fault.source, fault.kind) == ("tiger/control/planner", "search")
    assert fault.detail.startswith("a question is open for 0.2 s: the process that searches does not answer")


@pytest.mark.parametrize("run", [run_virtual, live])
def test_what_a_shielded_search_wanted_is_told_and_a_replay_and_an_explanation_agree(tmp_path, run):
    """Its fallback opens the left door, and so would the search: allowed is to listen first."""
    make, avoid, goal = HIDDEN["tiger"]
    model = make()
    opens = mdm.policies.AlphaVectors([[0.0] * 4], [1], 3)
    safe = mdm.shield(mdm.solvers.TreeSearch(model, expansions=2, fallback=opens), model, avoid=avoid, keep=goal)
    one = mdm.Ensemble("tiger", model=model, policy=safe, actions=dict.fromkeys(["listen", "left", "right"], nothing))
    told, kept = {}, Kept()

    async def main(runtime):
        actions = probe(runtime.channel("tiger/action", Action))
        answers = runtime.channel("tiger/answer", Answer).stream()
        with capture_decisions(runtime) as decisions:
            await runtime.start(one)
            sources = [(await anext(answers)).source]
            await one.ready()
            for seen in ("nothing", "tiger left"):
                one.publish_observation(seen)
                sources.append((await anext(answers)).source)
        told["why"] = str(runtime.explain("tiger"))
        return [(each.index, each.wanted) for each in actions], [each.wanted_name for each in decisions], sources

    actions, names, sources = run(main, record=tmp_path / "run.mcap", log=kept)
    assert actions == [(0, 1), (0, 1), (2, 1)]
    assert names == ["left"] * 3
    assert sources == ["search" if run is run_virtual else "fallback", "search", "search"]
    lines = [fields for _, event, fields in kept.lines if event == "shielded"]
    assert {("listen", "left", "eaten"), ("right", "left", "eaten")} == {
        (each["action"], each["wanted"], each["avoids"]) for each in lines
    }
    record = Record(tmp_path / "run.mcap")
    assert [(each.message.action, each.message.wanted) for each in record.messages(["decisions"])] == actions
    system = rebuilt(record, tmp_path / "laid")
    assert replay(record, system.actors).same
    why = "The policy wanted 'left', which may lead to eaten: next eaten (1); the shield took 'right' in its place."
    assert why in told["why"]
    assert why in why_recorded(record, rebuilt(record, tmp_path / "again").ensembles["tiger"], 1e9).text


@pytest.mark.parametrize("planted", [True, False])
def test_a_fallback_without_a_shield_is_a_fault_of_a_running_ensemble(planted):
    make, avoid, goal = HIDDEN["tiger"]
    model, opens = make(), mdm.policies.AlphaVectors([[0.0] * 4], [1], 3)
    safe = mdm.shield(mdm.solvers.TreeSearch(model, expansions=2, fallback=opens), model, avoid=avoid, keep=goal)
    safe.fallback = opens if planted else safe.fallback
    one = mdm.Ensemble("tiger", model=model, policy=safe, actions=dict.fromkeys(["listen", "left", "right"], nothing))

    async def main(runtime):
        faults = probe(runtime.faults)
        await runtime.start(one)
        await runtime.clock.sleep(1)
        return [(fault.source, fault.kind, "not shielded" in fault.detail) for fault in faults]

    assert run_virtual(main) == [("tiger/control/planner", "shield", True)] * planted
