"""An ensemble that decides has a live action, or waits for something that it names, or is idle and says so."""

from __future__ import annotations

import asyncio
import itertools
import math

import numpy as np
import pytest
from action_lives import Body, robot
from sentences import refused
from team_robots import decider, started

from mdm import ConfigError, Ensemble, FixedRate, PredicateManager, StateFactor, bind
from mdm.messages import State
from mdm.policies import AlphaVectors
from mdm.problems import dec_tiger, tiger
from mdm.team import Team
from mdm.team.transport.network import Network
from mdm.testing import probe, run_virtual

HOUR = 3600.0


class Drive:
    """An action of two seconds, which fails while its way is blocked."""

    def __init__(self, blocked_until=0.0):
        self.blocked_until = blocked_until
        self.begun = []

    async def __call__(self):
        now = asyncio.get_running_loop().time()
        self.begun.append(now)
        await asyncio.sleep(2)
        if now < self.blocked_until:
            raise OSError("the way is blocked")


def idle_faults(faults):
    return [(fault.time / 1e9, fault.detail) for fault in faults if fault.kind == "idle"]


def test_an_ended_action_is_decided_again_after_its_pause():
    async def main(runtime):
        drive = Drive()
        ensemble = robot({"Go": bind(drive, then="decide", pause=3.0)})
        await runtime.start(ensemble)
        decisions = probe(runtime.decisions)
        ensemble.publish_state(0)
        await asyncio.sleep(HOUR + 1)
        assert drive.begun == [5.0 * n for n in range(721)]
        assert [decision.cause for decision in decisions][:3] == ["state", "again", "again"]
        assert [decision.epoch for decision in decisions] == list(range(len(decisions)))

    run_virtual(main)


def test_a_blocked_patrol_goes_on_when_the_way_is_free():
    """The one way was blocked once, for 90 seconds: by now it stood for ever."""

    async def main(runtime):
        drive = Drive(blocked_until=90.0)
        ensemble = robot({"Up": drive, "Down": Drive()}, on_failed_action="decide")
        await runtime.start(ensemble)
        faults = probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(1000)
        assert drive.begun == [0.0, 3.0, 7.0, 13.0, 23.0, 41.0, 75.0, 137.0]
        assert idle_faults(faults) == [
            (149.0, "idle for 10 s: action 'Up' succeeded, and nothing has been decided since")
        ]

    run_virtual(main)


@pytest.mark.parametrize("other", [lambda: None, Drive()], ids=["a function", "one that is pre-empted"])
def test_another_action_ends_a_row_of_failures(other):
    async def main(runtime):
        drive = Drive(blocked_until=HOUR)
        ensemble = robot({"Up": bind(drive, then="decide"), "Other": other})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(30)
        ensemble.publish_state(1)
        await asyncio.sleep(1)
        ensemble.publish_state(0)
        await asyncio.sleep(15)
        assert drive.begun == [0.0, 3.0, 7.0, 13.0, 23.0, 31.0, 34.0, 38.0, 44.0]

    run_virtual(main)


@pytest.mark.parametrize("safe_action", [None, lambda: None])
def test_a_function_ends_a_row_of_failures_after_which_nothing_is_decided_again(safe_action):
    async def main(runtime):
        ensemble = robot({"Up": bind(Drive(HOUR), attempts=2), "Look": lambda: None}, safe_action=safe_action)
        await runtime.start(ensemble)
        faults = probe(runtime.faults)
        for state in (0, 1, 0):
            ensemble.publish_state(state)
            await asyncio.sleep(5)
        assert len(faults) == 2
        assert not any("is given up" in fault.detail for fault in faults)

    run_virtual(main)


@pytest.mark.parametrize("then", [None, "decide"])
def test_after_a_safe_action_for_a_failure_it_is_decided_again(then):
    """Its way back was the next input alone, which may never come."""

    async def main(runtime):
        drive, safe = Drive(blocked_until=5.0), []
        ensemble = robot({"Up": bind(drive, then=then)}, safe_action=lambda: safe.append(runtime.clock.now() / 1e9))
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert safe[0] == 2.0
        if then is None:
            assert (ensemble.mode, drive.begun) == ("safe", [0.0])
        else:
            assert (ensemble.mode, drive.begun[:3], safe) == ("deciding", [0.0, 3.0, 7.0], [2.0, 5.0])

    run_virtual(main)


def test_what_is_decided_meanwhile_is_not_decided_twice():
    async def main(runtime):
        first, second = Drive(), Drive()
        ensemble = robot({"A": bind(first, then="decide"), "B": bind(second, then="decide")})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(2.5)
        ensemble.publish_state(1)
        await asyncio.sleep(7)
        assert (first.begun, second.begun) == ([0.0], [2.5, 5.5, 8.5])

    run_virtual(main)


def test_a_stop_within_the_pause_ends_it():
    async def main(runtime):
        drive = Drive()
        ensemble = robot({"A": bind(drive, then="decide")})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(2.5)
        assert ensemble.statistics().waiting == ("a pause of 1 s, for action 'A' succeeded",)
        ensemble.stop()
        await asyncio.sleep(60)
        assert (drive.begun, ensemble.statistics().waiting) == ([0.0], ())

    run_virtual(main)


def test_plain_functions_are_called_again_too():
    async def main(runtime):
        called = []
        ensemble = robot({"Beep": bind(lambda: called.append(runtime.clock.now() / 1e9), then="decide", pause=7.0)})
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(20)
        assert called == [0.0, 7.0, 14.0]

    run_virtual(main)


def test_at_a_fixed_rate_the_ticks_decide_alone():
    async def main(runtime):
        drive = Drive()
        ensemble = robot({"A": bind(drive, then="decide", pause=0.25)}, drive=FixedRate(0.2))
        await runtime.start(ensemble)
        faults = probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert drive.begun == [5.0 * n for n in range(len(drive.begun))]
        assert len(drive.begun) >= 12
        assert (ensemble.statistics().idle, list(faults)) == (0.0, [])

    run_virtual(main)


# -- Giving up ------------------------------------------------------------------------------------------------------


def test_giving_up_is_an_event_for_predicates():
    async def main(runtime):
        manager = PredicateManager()
        manager.latch("Stuck", set="Up.gave_up", reset="Round.succeeded")
        manager.define("Free", "not Stuck")
        up, round_ = Drive(blocked_until=HOUR), Drive()
        ensemble = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"Up": bind(up, then="decide", attempts=3), "Round": round_},
            predicates=manager,
            states=[StateFactor("way", ["Free", "Stuck"])],
            safe_action=lambda: None,
            on_failed_action="decide",
        )
        await runtime.start(ensemble)
        await asyncio.sleep(14)
        assert (up.begun, round_.begun) == ([0.0, 3.0, 7.0, 11.0], [9.0])
        assert ensemble.mode == "deciding"

    run_virtual(main)


@pytest.mark.parametrize("safe", [True, False])
def test_giving_up_that_nothing_heeds_is_a_cause_of_safety_or_told(safe):
    async def main(runtime):
        up = Drive(blocked_until=HOUR)
        options = {"safe_action": lambda: None} if safe else {}
        ensemble = robot({"Up": bind(up, attempts=2)}, on_failed_action="decide", **options)
        await runtime.start(ensemble)
        faults = probe(runtime.faults)
        ensemble.publish_state(0)
        await asyncio.sleep(600)
        assert up.begun == [0.0, 3.0]
        assert ensemble.mode == ("safe" if safe else "deciding")
        (told,) = [fault.detail for fault in faults if "is given up" in fault.detail]
        assert told.startswith(
            "action 'Up' is given up after 2 failures in a row; the last: action 'Up' failed: OSError"
        )
        assert len(idle_faults(faults)) == (0 if safe else 1)
        ensemble.publish_state(0)
        await asyncio.sleep(600)
        assert up.begun == [0.0, 3.0, 600.0, 603.0]

    run_virtual(main)


# -- What a repeated decision counts as -----------------------------------------------------------------------------


def test_a_repeated_decision_of_a_policy_over_beliefs_updates_no_belief_and_has_its_reward():
    """As the theory has it: a belief moves by an action and an observation; here nothing was observed."""

    async def main(runtime):
        async def listen():
            await asyncio.sleep(1)

        model = tiger()
        ensemble = Ensemble(
            "robot",
            policy=AlphaVectors(np.array([[1.0, 1.0]]), [0], num_actions=3),
            model=model,
            actions=dict.fromkeys(model.action_space.names, bind(listen, then="decide", pause=1.0)),
        )
        decisions = probe(runtime.decisions)
        await runtime.start(ensemble)
        await asyncio.sleep(5)
        assert [decision.cause for decision in decisions] == ["start", "again", "again"]
        assert [decision.epoch for decision in decisions] == [0, 1, 2]
        assert [decision.reward for decision in decisions] == [-1.0] * 3
        for decision in decisions:
            np.testing.assert_array_equal(decision.belief, [0.5, 0.5])
        ensemble.publish_observation(0)
        await asyncio.sleep(0.5)
        assert decisions[-1].cause == "observation"
        # One observation is one update, however often its action was carried out.
        np.testing.assert_allclose(decisions[-1].belief, [0.85, 0.15])

    run_virtual(main)


def test_a_repeated_decision_counts_towards_the_horizon():
    async def main(runtime):
        drive = Drive()
        ensemble = robot({"A": bind(drive, then="decide")}, horizon=3)
        decisions = probe(runtime.decisions)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(13)
        told = [(decision.cause, decision.epoch) for decision in decisions]
        assert told == [("state", 0), ("again", 1), ("again", 2), ("episode", 0), ("again", 1)]

    run_virtual(main)


# -- Idleness -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("binding", "options", "told"),
    [
        ({}, {}, 12.0),
        ({}, {"idle_after": 3.0}, 5.0),
        ({}, {"idle_after": math.inf}, None),
        ({"then": "wait"}, {}, None),
        ({"then": "wait"}, {"idle_after": 3.0}, None),
    ],
)
def test_idleness_is_counted_and_told(binding, options, told):
    async def main(runtime):
        ensemble = robot({"A": bind(Drive(), **binding), "B": bind(Drive(), then="decide")}, **options)
        faults, idles = probe(runtime.faults), probe(runtime.idles)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(52)
        assert ensemble.statistics().idle == 50.0
        assert [when for when, _ in idle_faults(faults)] == ([] if told is None else [told])
        ensemble.publish_state(1)
        await asyncio.sleep(60)
        assert ensemble.statistics().idle == 50.0
        meant = binding.get("then") == "wait"
        assert [(m.time, m.ensemble, m.idle, m.since, m.action, m.intended) for m in idles] == [
            (2_000_000_000, "robot", True, 2_000_000_000, "A", meant),
            (52_000_000_000, "robot", False, 2_000_000_000, "A", meant),
        ]

    run_virtual(main)


@pytest.mark.parametrize(("cleanup", "idle"), [(3.0, 4.0), (60.0, 6.0)])
def test_an_action_that_outlives_the_one_by_which_it_was_replaced_keeps_no_idleness_quiet(cleanup, idle):
    """The one that replaced it had ended before, and was looked at while the other still came to its end."""

    async def main(runtime):
        slow, quick = Body("slow", [], cleanup=cleanup), Body("quick", [], seconds=1.0)
        ensemble = robot({"A": bind(slow, group="arm", grace=5.0), "B": bind(quick, group="arm")})
        faults, idles = probe(runtime.faults), probe(runtime.idles)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(1.0)
        ensemble.publish_state(1)
        await asyncio.sleep(30.0)
        assert [(each.time / 1e9, each.idle, each.action) for each in idles] == [(idle, True, "B")]
        assert idle_faults(faults) == [
            (idle + 10.0, "idle for 10 s: action 'B' succeeded, and nothing has been decided since")
        ]

    run_virtual(main)


def test_what_decides_in_the_turn_of_the_end_is_no_idleness():
    async def main(runtime):
        manager = PredicateManager()
        manager.latch("There", set="Go.succeeded", reset="Back.succeeded")
        manager.define("Here", "not There")
        ensemble = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"Go": Drive(), "Back": Drive()},
            predicates=manager,
            states=[StateFactor("at", ["Here", "There"])],
        )
        idles = probe(runtime.idles)
        await runtime.start(ensemble)
        await asyncio.sleep(HOUR + 1)
        assert ensemble.action.started == 1801
        assert (list(idles), ensemble.statistics().idle) == ([], 0.0)

    run_virtual(main)


def held(seconds):
    """Return a sensor, and a robot that decides anew when the sensor has been true for so long."""
    manager = PredicateManager()
    tired = manager.sensor("tired")
    manager.define("Rest", "tired", held_for=seconds)
    ensemble = Ensemble(
        "robot",
        policy=[0, 1],
        actions={"Go": Drive(), "Sleep": Drive()},
        predicates=manager,
        states=[StateFactor("rest", {"yes": "Rest"})],
    )
    return tired, ensemble


def test_a_predicate_that_holds_is_waited_for_by_its_name():
    """At 2 s the drive has ended; its formula is true from 1 s on, and the predicate at 31 s."""

    async def main(runtime):
        tired, ensemble = held(30.0)
        faults, idles = probe(runtime.faults), probe(runtime.idles)
        await runtime.start(ensemble)
        tired.set(False)
        await asyncio.sleep(1)
        tired.set(True)
        assert ensemble.statistics().waiting == ()  # it drives
        await asyncio.sleep(2)
        assert ensemble.statistics().waiting == ("'Rest' to hold for 28 s more",)
        await asyncio.sleep(29)
        assert (ensemble.action.started, ensemble.statistics().waiting, list(idles)) == (2, (), [])
        assert idle_faults(faults) == []

    run_virtual(main)


def test_a_predicate_that_does_not_hold_in_the_end_is_no_longer_waited_for():
    async def main(runtime):
        tired, ensemble = held(30.0)
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        tired.set(True)
        await asyncio.sleep(5)
        assert ensemble.statistics().waiting
        tired.set(False)
        assert ensemble.statistics().waiting == ()
        await asyncio.sleep(55)
        assert ensemble.statistics().idle == 30.0
        assert [when for when, _ in idle_faults(faults)] == [40.0]

    run_virtual(main)


def test_what_begins_to_hold_while_it_is_idle_is_waited_for_before_that_is_told():
    async def main(runtime):
        tired, ensemble = held(30.0)
        faults, idles = probe(runtime.faults), probe(runtime.idles)
        await runtime.start(ensemble)
        tired.set(False)
        await asyncio.sleep(5)
        tired.set(True)
        await asyncio.sleep(1)
        assert (ensemble.statistics().waiting, ensemble.statistics().idle) == (("'Rest' to hold for 29 s more",), 3.0)
        tired.set(False)
        tired.set(True)
        await asyncio.sleep(31)
        assert (ensemble.action.started, idle_faults(faults), ensemble.statistics().idle) == (2, [], 3.0)
        assert [(idle.idle, idle.time // 10**9) for idle in idles] == [(True, 2), (False, 5)]

    run_virtual(main)


def test_a_plain_function_stands():
    async def main(runtime):
        ensemble = robot({"Slow": lambda: None, "Go": Drive()})
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        ensemble.publish_state(1)
        await asyncio.sleep(1)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert (ensemble.statistics().idle, list(faults)) == (0.0, [])

    run_virtual(main)


def test_a_function_that_returns_what_takes_time_is_idle_when_that_has_ended():
    """As the drives of a map are."""

    async def main(runtime):
        ensemble = robot({"Up": lambda: asyncio.sleep(2)})
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert [when for when, _ in idle_faults(faults)] == [12.0]
        assert ensemble.statistics().idle == 58.0

    run_virtual(main)


def test_a_plain_function_counts_where_that_is_asked_for():
    async def main(runtime):
        ensemble = robot({"Slow": lambda: None}, idle_after=4.0)
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(60)
        assert ensemble.statistics().idle == 60.0
        assert idle_faults(faults) == [
            (4.0, "idle for 4 s: action 'Slow' succeeded, and nothing has been decided since")
        ]

    run_virtual(main)


def test_an_unknown_state_is_waited_for_in_place_of_idleness():
    async def main(runtime):
        manager = PredicateManager()
        ready = manager.sensor("Ready", initial=True)
        manager.define("Busy", "not Ready")
        ensemble = Ensemble(
            "robot",
            policy=[0, 1],
            actions={"A": Drive(), "B": Drive()},
            predicates=manager,
            states=[StateFactor("state", ["Ready", "Busy"])],
        )
        await runtime.start(ensemble)
        await asyncio.sleep(5)
        assert ensemble.statistics().idle == 3.0
        ready.set(None)
        await asyncio.sleep(20)
        assert ensemble.statistics().idle == 3.0
        assert ensemble.statistics().waiting == ("Ready",)

    run_virtual(main)


def test_a_decision_that_cannot_be_made_is_idleness_that_is_told():
    async def main(runtime):
        ensemble = robot({"A": Drive(), "B": Drive()})
        faults = probe(runtime.faults)
        await runtime.start(ensemble)
        ensemble.publish_state(0)
        await asyncio.sleep(1)
        ensemble.channel("state", State, retain=True).publish(State(runtime.clock.now(), 7, (7,)))
        await asyncio.sleep(20)
        assert [fault.kind for fault in faults] == ["state", "idle"]

    run_virtual(main)


@pytest.mark.parametrize("after", [0, -1, "soon", True])
def test_wrong_idle_after(after):
    with refused(ConfigError):
        robot({"A": Drive()}, idle_after=after)


# -- The promise ----------------------------------------------------------------------------------------------------

STEPS = ("a", "b", "unknown", "switch", "break")


@pytest.mark.parametrize(
    ("then", "on_failed_action"), [(None, "continue"), (None, "safe"), ("decide", "safe"), ("wait", "decide")]
)
def test_after_every_sequence_the_promise_holds(then, on_failed_action):
    """What decides has a live action, or waits for what it names, or is idle: looked at after every step of each."""
    sequences = list(itertools.product(STEPS, repeat=3))

    async def main(runtime):
        for number, steps in enumerate(sequences):
            manager = PredicateManager(f"p{number}")
            at = manager.sensor("A", initial=True)
            manager.define("B", "not A")
            broken = [False]

            async def go(broken=broken):
                await asyncio.sleep(1.5)
                if broken[0]:
                    raise OSError("stuck")

            ensemble = Ensemble(
                f"robot{number}",
                policy=[0, 1],
                actions={"Go": bind(go, then=then), "Halt": bind(go, attempts=1)},
                predicates=manager,
                states=[StateFactor("at", ["A", "B"])],
                on_failed_action=on_failed_action,
                safe_action=lambda: None,
            )
            await runtime.start(ensemble)
            for step in steps:
                _take(step, ensemble, at, broken)
                await asyncio.sleep(1)
                _check(ensemble)
            await runtime.stop(ensemble)

    run_virtual(main)


def _take(step, ensemble, at, broken):
    if step in {"a", "b", "unknown"}:
        at.set({"a": True, "b": False, "unknown": None}[step])
    elif step == "switch":
        (ensemble.stop if ensemble.active else ensemble.start)()
    else:
        broken[0] = not broken[0]


def _check(ensemble):
    if ensemble.mode != "deciding":
        return
    idle = ensemble.liveness.since is not None
    waiting = bool(ensemble.statistics().waiting)
    assert bool(ensemble.action.live) + waiting + idle >= 1
    assert not (idle and (waiting or ensemble.action.live))


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_in_a_team_an_agent_does_its_part_again_and_nothing_is_decided(mode):
    model = dec_tiger()

    def build(robot, agent):
        calls = {
            name: bind(robot.act(name), then="decide", pause=2.0) for name in model.action_space.factors[agent].names
        }
        return Ensemble("joint", policy=decider(model), model=model, actions=calls, agent=agent)

    async def main(runtime):
        team = Team("tigers", ["left", "right"], mode=mode)
        robots = await started(runtime, team, Network(runtime.clock, team="tigers"), build)
        await asyncio.sleep(30)
        return robots

    for one in run_virtual(main):
        assert all(commit.time < 1e9 for commit in one.commits)
        assert 14 <= len(one.did) <= 16
        assert set(one.did) == {"listen"}
        assert one.ensemble.controller.epoch <= 1  # where another decides for it, none
        assert one.kinds() == []


def test_an_action_that_never_ends_shows_how_long_it_has_lived():
    async def forever():
        await asyncio.Event().wait()

    async def main(runtime):
        ensemble = robot({"Go": bind(forever)})
        await runtime.start(ensemble)
        assert ensemble.statistics().live == {}
        await asyncio.sleep(5)
        ensemble.publish_state(0)
        await asyncio.sleep(HOUR)
        ensemble.publish_state(0)  # the same decision: it goes on
        await asyncio.sleep(1)
        statistics = ensemble.statistics()
        assert (statistics.mode, statistics.live, statistics.idle) == ("deciding", {"Go": HOUR + 1}, 0.0)

    run_virtual(main)


@pytest.mark.parametrize(
    ("inputs", "timeout", "noted"),
    [
        (["Worked"], None, True),
        (["Worked"], 5.0, False),
        (["Worked", "Seen"], None, False),
        (["Done"], None, True),
        (["Told"], None, False),
    ],
)
def test_an_action_without_a_timeout_is_noted_where_only_ends_are_decided_on(inputs, timeout, noted):
    async def forever(): ...

    manager = PredicateManager()
    manager.sensor("Seen")
    manager.event("Call")
    manager.latch("Worked", set="Work.succeeded", reset="Rest.succeeded", initial=False)
    manager.define("Done", "Worked")
    manager.latch("Told", set="Work.succeeded", reset="Call", initial=False)
    states = [StateFactor(name, [name]) for name in inputs]
    actions = {name: bind(forever, timeout=timeout, then="decide") for name in ("Work", "Rest")}
    policy = [0, 1] * len(inputs)
    ensemble = Ensemble("guard", policy=policy, predicates=manager, states=states, actions=actions)
    told = [note for note in ensemble.notes() if "give a timeout to Work, Rest" in note]
    assert bool(told) is noted
    Ensemble("above", policy=[0], actions={"go": ensemble})
    assert not [note for note in ensemble.notes() if "timeout" in note]  # what is above may end it
