"""Snapshots of a running system, against what its actors and channels say."""

from __future__ import annotations

import asyncio
from collections import Counter

import msgspec
import numpy as np
import pytest
from decided import ensemble, nothing
from places import EXAMPLES
from sentences import refused
from shown import a_robot
from team_robots import over_states, started, two

import mdm
from mdm import Ensemble, Error
from mdm.models import MDP, Factor, Space
from mdm.policies import DeterministicPolicy
from mdm.snapshots import Frame, LiveRun, Scene
from mdm.snapshots.scenes import factors_of
from mdm.team import Network, Team
from mdm.testing import probe, run_virtual


def looked_at(file, seconds, look):
    """Run a file's system, and look at it ten times a second."""

    async def main(runtime):
        live = LiveRun(runtime, title="robot", control=True)
        live.open()
        system = mdm.load_system(file)
        await runtime.start(system)
        for _ in range(round(seconds * 10)):
            look(live, system, runtime)
            await asyncio.sleep(0.1)
        live.close()
        return live

    return run_virtual(main)


def test_factors_say_which_predicates_tell_them():
    top = mdm.load_system(EXAMPLES / "patrol" / "patrol.toml", callbacks=False).ensembles["top"]
    found = {each.name: each.told_by for each in factors_of(top.controller.symbols.state_space, top)}
    assert found == {"person": ("PersonIsWaiting",), "intruder": ("IntruderIsSeen",), "fire": ("FireIsSeen",)}


def test_a_factor_of_places_is_told_by_the_predicate_of_each_in_the_order_of_its_symbols():
    patrol = mdm.load_system(EXAMPLES / "patrol" / "patrol.toml", callbacks=False).ensembles["patrol"]
    (position,) = [
        each for each in factors_of(patrol.controller.symbols.state_space, patrol) if each.name == "position"
    ]
    assert position.told_by == tuple(f"{symbol}.reached" for symbol in position.symbols)
    assert len(position.symbols) == 6


def test_without_a_model_the_wiring_says_which_predicates_tell_a_factor(tmp_path):
    walk = mdm.load_system(a_robot(tmp_path)).ensembles["walk"]
    (factor,) = factors_of(walk.controller.symbols.state_space, walk)
    assert (factor.name, factor.told_by) == ("near", ("Near",))


def test_frames_say_what_the_actors_do(tmp_path):
    modes, changes, before = Counter(), [], {}

    def look(live, system, runtime):
        scene, frame = live.scene(), live.frame({"top", "top/walk"})
        assert [each.path for each in scene.ensembles] == ["top", "top/walk"]
        assert [each.parent for each in scene.ensembles] == [-1, 0]
        assert scene.ensembles[1].bound == "0"
        for each, ensemble_ in zip(frame.ensembles, system.ensembles.values(), strict=True):
            assert each.mode == ensemble_.mode
            assert tuple(life.action for life in each.live) == ensemble_.action.live
            assert each.decisions == ensemble_.control.decisions
            assert {cause.kind for cause in each.causes} == {cause.kind for cause in ensemble_.causes}
            modes[each.mode] += 1
        values = dict(zip([each.name for each in scene.predicates], frame.predicates, strict=True))
        assert values == system.predicates.values()
        for place, (name, value) in enumerate(values.items()):
            if name in before and before[name] is not value:
                assert frame.changed[place] == frame.time
                changes.append(name)
        before.update(values)
        assert msgspec.json.decode(msgspec.json.encode(frame), type=Frame) == frame
        assert msgspec.json.decode(live.encoded({"top", "top/walk"}), type=Frame) == live.frame({"top", "top/walk"})
        assert msgspec.json.decode(msgspec.json.encode(scene), type=Scene) == scene

    looked_at(a_robot(tmp_path), 30, look)
    assert modes["safe"] > 2  # the sensor was silent for a while
    assert modes["deciding"] > 100
    assert {"Low", "Near", "Quiet"} == set(changes)


def test_each_fault_mode_and_lasting_action_is_an_event(tmp_path):
    heard = {}

    def look(live, system, runtime):
        live.frame()
        if not heard:
            heard["faults"] = probe(runtime.faults)
            heard["lives"] = probe(system.ensembles["walk"].channel("lives", mdm.messages.ActionLife))
            heard["modes"] = probe(runtime.modes)

    live = looked_at(a_robot(tmp_path), 30, look)
    events = list(live.ring)
    assert [event.number for event in events] == list(range(1, live.ring.number + 1))
    faults = [event for event in events if event.kind == "fault"]
    assert [(event.source, event.name) for event in faults] == [(each.source, each.kind) for each in heard["faults"]]
    assert all(event.remedy for event in faults)
    lives = [event for event in events if event.kind == "life" and event.source == "top/walk"]
    expected = [(each.action, each.status, each.life) for each in heard["lives"]]
    seen = [(event.name, event.status, event.life) for event in lives]
    assert seen[0] == ("0", "running", 1)  # which began before anybody looked
    assert seen[1:] == expected[: len(seen) - 1]
    assert len(seen) > 20
    modes = [(event.source, event.name) for event in events if event.kind == "mode"]
    expected = [(each.ensemble, each.mode) for each in heard["modes"]]
    assert modes[2:] == expected[: len(modes) - 2]
    assert len(modes) > 10


def test_a_state_is_that_which_was_decided_on_though_another_has_come():
    space = Space([Factor("door", ["open", "closed"]), Factor("lamp", ["off", "on"])])
    model = MDP([np.eye(4)], np.zeros((4, 1)), discount=0.9, states=space)

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot = mdm.Ensemble("robot", policy=DeterministicPolicy([0] * 4), model=model, actions={0: nothing})
        await runtime.start(robot)
        robot.publish_state(1)
        robot.stop()
        robot.publish_state(2)
        detail = live.frame({"robot"}).details["robot"]
        assert detail.factors == (("door", "open"), ("lamp", "on"))
        assert detail.state == space.names[1]

    run_virtual(main)


def test_each_decision_is_an_event_with_the_state_or_the_observation_that_it_was_made_at():
    space = Space([Factor("door", ["open", "closed"]), Factor("lamp", ["off", "on"])])
    model = MDP([np.eye(4)], np.zeros((4, 1)), discount=0.9, states=space)
    policy = DeterministicPolicy([0] * 4)
    robots = {
        "named": mdm.Ensemble("named", policy=policy, model=model, actions={0: nothing}),
        "plain": mdm.Ensemble("plain", policy=policy, actions={0: nothing}, drive=2.0),
        "hidden": ensemble(drive=2.0),
    }

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        for robot in robots.values():
            await runtime.start(robot)
        live.frame()
        robots["named"].publish_state(1)
        robots["plain"].publish_state(2)
        live.frame()
        await asyncio.sleep(0.6)
        live.frame()
        robots["hidden"].publish_observation("hear-right")
        await asyncio.sleep(0.5)
        live.frame()
        return [(each.source, each.at) for each in live.ring if each.kind == "decision"]

    told = run_virtual(main)
    assert [at for source, at in told if source == "named"] == ["in state door open, lamp on"]
    assert {at for source, at in told if source == "plain"} == {"in state 2"}
    assert [at for source, at in told if source == "robot"] == ["", "on observing hear-right"]


def test_a_belief_is_that_which_was_decided_on():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot = ensemble()
        await runtime.start(robot)
        robot.publish_observation("hear-left")
        frame = live.frame({"robot"})
        detail = frame.details["robot"]
        believed = robot.control.controller.decided_by
        names = robot.controller.model.state_space.names
        assert dict(detail.belief.top) == pytest.approx(dict(zip(names, believed, strict=True)))
        assert detail.observation == "hear-left"
        assert detail.reward == pytest.approx(believed @ robot.controller.model.rewards[:, 0])
        assert detail.value == pytest.approx(robot.controller.policy.value(believed))
        assert live.frame({"robot"}).details["robot"] is detail  # nothing has changed

    run_virtual(main)


def test_decisions_cost_nothing_on_the_way_to_the_action():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot = ensemble()
        await runtime.start(robot)
        live.frame({"robot"})
        assert not runtime.decisions.heard
        for name in ("action", "belief", "reward", "lives", "state", "observation"):
            channel = next((each for each in runtime.channels if each.name == f"robot/{name}"), None)
            own = 1 if name in {"action", "observation"} else 0  # the layers'
            assert channel is None or channel.statistics().subscribers == own
        for _ in range(5):
            robot.publish_observation("hear-left")
        live.frame()
        decisions = [event for event in live.ring if event.kind == "decision"]
        assert [(event.life, event.count) for event in decisions] == [(0, 1), (5, 5)]  # by the last of each look

    run_virtual(main)


def test_commands_and_predicates_reach_the_robot(tmp_path):
    done = []

    def look(live, system, runtime):
        if done:
            return
        done.append(True)
        live.scene()
        live.command("stop", "top")
        assert system.ensembles["top"].mode == "stopped"
        live.command("start", "top")
        assert system.ensembles["top"].mode == "deciding"
        live.sense("Low", value=True)
        assert system.predicates.value("Low") is True
        for wrong in (
            lambda: live.command("stop", "nobody"),
            lambda: live.command("explode", "top"),
            lambda: live.sense("Near", value=True),  # a sensor tells it
            lambda: live.sense("Nothing", value=True),
        ):
            with refused(Error):
                wrong()

    looked_at(a_robot(tmp_path), 1, look)


def test_actors_that_come_later_make_another_scene():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        assert live.scene().ensembles == ()
        first = live.generation
        await runtime.start(ensemble())
        assert [each.path for each in live.scene().ensembles] == ["robot"]
        assert live.generation == first + 1
        live.scene()
        assert live.generation == first + 1

    run_virtual(main)


def test_of_a_thousand_ensembles_changes_are_seen_at_once_and_all_others_in_their_turn():
    robots = [
        Ensemble(
            f"robot{number:03}",
            policy=DeterministicPolicy([0, 1]),
            actions={0: lambda: None, 1: lambda: None},
            safe_action=lambda: None,
        )
        for number in range(300)
    ]

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        for robot in robots:
            await runtime.start(robot)
        live.frame()
        robots[7].publish_state(1)
        robots[299].publish_state(1)
        robots[150].stop()
        robots[151].safety.alarm(mdm.messages.Fault(runtime.now(), "robot151", "policy", "it is torn"))
        await asyncio.sleep(0.05)
        frames = live.frame().ensembles
        assert {place for place, each in enumerate(frames) if each.decisions} == {7, 299}
        assert (frames[150].mode, frames[151].mode) == ("stopped", "safe")
        looks = dict.fromkeys(range(300), 0)
        for place, each in enumerate(live._ensembles):

            def look(now, place=place, look=each.frame):
                looks[place] += 1
                return look(now)

            each.frame = look
        for _ in range(20):
            await asyncio.sleep(0.05)
            live.frame({"robot200"})
        return looks

    looks = run_virtual(main)
    assert min(looks.values()) >= 1
    assert max(looks.values()) == looks[200] == 20
    assert sum(looks.values()) < 20 * 40


@pytest.mark.slow
def test_a_thousand_ensembles_that_all_decide_are_looked_at_some_at_a_time_and_a_mode_or_what_is_close_at_once():
    robots = [
        Ensemble(f"robot{number:03}", policy=DeterministicPolicy([0, 1]), actions={0: lambda: None, 1: lambda: None})
        for number in range(1000)
    ]

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        for robot in robots:
            await runtime.start(robot)
        for _ in range(3):
            live.frame()
            await asyncio.sleep(0.05)
        for round_ in range(3):
            for robot in robots:
                robot.publish_state(round_ % 2)
        robots[777].stop()
        told = []
        for _ in range(10):
            frames = live.frame({"robot500"}).ensembles
            told.append({place for place, each in enumerate(frames) if each.decisions == 3})
            assert frames[777].mode == "stopped"
            await asyncio.sleep(0.05)
        return told, [each for each in live.ring if each.kind == "decision"]

    told, decisions = run_virtual(main)
    assert {500, 777} <= told[0]
    assert 100 < len(told[0]) < 160
    assert told[-1] == set(range(1000))
    assert sum(each.count for each in decisions) == 3000


def test_observations_are_told_with_their_times_and_how_often_each_came():
    robot = ensemble()

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(robot)
        live.frame({"robot"})
        for word in ["hear-left"] * 9 + ["hear-right"]:
            await asyncio.sleep(1)
            robot.publish_observation(word)
            frame = live.frame({"robot"})
        return frame.details["robot"]

    detail = run_virtual(main)
    assert detail.observations == tuple(
        [(float(second), "hear-left") for second in range(3, 10)] + [(10.0, "hear-right")]
    )
    assert detail.tally == (("hear-left", 9), ("hear-right", 1))


def test_an_actor_that_comes_later_leaves_predicates_as_they_were_and_unknown_is_told_from_the_start():
    manager = mdm.PredicateManager()
    manager.sensor("Near", initial=True)
    manager.sensor("Lit")

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(manager)
        live.frame()
        await asyncio.sleep(5.0)
        await runtime.start(ensemble())
        frame = live.frame()
        manager.sense("Lit", False)
        await asyncio.sleep(1.0)
        live.frame()
        return frame, [(each.time, each.name, each.status) for each in live.ring if each.kind == "predicate"]

    frame, told = run_virtual(main)
    assert frame.predicates == (True, None)
    assert frame.changed == (0.0, 0.0)
    assert told == [(0.0, "Near", "true"), (0.0, "Lit", "unknown"), (6.0, "Lit", "false")]


def test_of_a_team_it_says_in_words_how_each_agent_and_its_agreement_are():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await two(runtime)
        await asyncio.sleep(3.0)
        return live.frame().team

    told = run_virtual(main)
    assert told["agent right"] == {"is": "this agent"}  # the last one that tells, of two in one runtime
    assert told["agent left"]["link"] == "live"
    assert float(told["agent left"]["last heard"].removesuffix(" s ago")) < 1
    assert told["agent left"]["messages lost"].startswith("0 of ")
    (ensemble_,) = [facts for of, facts in told.items() if of.startswith("ensemble ")]
    assert set(ensemble_) >= {"this agent is", "led by", "the leader's term", "step"}
    assert ensemble_["this agent is"] in {"leading", "following"}


def test_a_follower_that_carries_out_what_was_decided_does_not_know_in_which_state():
    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        team = Team("rooms", ["a", "b"], mode="centralised")
        robots = await started(runtime, team, Network(runtime.clock, team="rooms"), over_states)
        live.frame()
        for robot in robots:
            robot.lab.set(True)
        await asyncio.sleep(1.0)
        live.frame()
        return {each.source: each.at for each in live.ring if each.kind == "decision"}

    assert run_virtual(main) == {"a/joint": "in state room_a lab, room_b lab", "b/joint": ""}


def test_an_ensemble_that_has_decided_and_begun_once_more_between_two_frames_is_shown():
    async def main(runtime):
        robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions={"Go": nothing})
        live = LiveRun(runtime)
        live.open()
        await runtime.start(robot)
        live.frame()
        robot.publish_state(0)
        await runtime.stop(robot)
        await runtime.start(robot)
        [before] = live.frame().ensembles
        robot.publish_state(0)
        [after] = live.frame().ensembles
        live.close()
        return before.action, after.action, [event.name for event in live.ring if event.kind == "decision"]

    assert run_virtual(main) == ("", "Go", ["Go"])


def test_who_looks_late_does_not_say_how_an_action_has_ended_that_nobody_saw():
    async def fails():
        await asyncio.sleep(0.3)
        raise ValueError("no way")

    async def main(runtime):
        actions = {"Go": mdm.Binding(fails, then="decide", pause=0.5)}
        robot = Ensemble("robot", policy=DeterministicPolicy([0]), actions=actions, on_failed_action="decide")
        await runtime.start(robot)
        robot.publish_state(0)
        await asyncio.sleep(0.4)
        live = LiveRun(runtime)
        live.open()
        found = []
        for _ in range(3):
            found.append(live.frame({"robot"}).details["robot"].cause)
            await asyncio.sleep(1.0)
        live.close()
        return found

    unseen, seen = "again, for its action had ended or it was asked to", "again, for Go had ended (failed)"
    assert run_virtual(main) == ["on a change of its state", unseen, seen]


def test_messages_that_are_lost_on_the_way_are_caught_up_with_at_the_next_look():
    async def go():
        await asyncio.sleep(1.0)

    class Deaf(LiveRun):
        def fails(self, _):
            raise MemoryError

        on_mode = on_life = on_idle = fails

    async def main(runtime):
        robot = Ensemble("robot", policy=DeterministicPolicy([0, 1]), actions={"Go": go, "Halt": nothing})
        live = Deaf(runtime)
        live.open()
        seen = []
        for step in (lambda: runtime.start(robot), lambda: robot.publish_state(0), robot.stop, robot.start):
            done = step()
            if done is not None:
                await done
            await asyncio.sleep(0.1)
            [frame] = live.frame().ensembles
            seen.append((frame.mode, [life.action for life in frame.live]))
            assert seen[-1] == (robot.mode, list(robot.action.live))
        await asyncio.sleep(2.0)
        [frame] = live.frame().ensembles
        assert (frame.idle is not None) == (robot.status().idle_since is not None)
        live.close()
        return seen

    assert run_virtual(main) == [("deciding", []), ("deciding", ["Go"]), ("stopped", []), ("deciding", ["Go"])]


def test_predicates_that_flicker_while_nobody_looks_are_kept_and_pulses_are_told_as_such():
    manager = mdm.PredicateManager("predicates")
    flickers, pulses = (manager.sensor(name, initial=False) for name in ("Flickers", "Pulses"))

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(manager)
        live.frame()
        for step in range(40):
            if step % 2 == 0:
                flickers.set(step % 4 == 0)
            if step == 20:
                pulses.set(True)
                pulses.set(False)
            await asyncio.sleep(0.05)
            live.glance()
        return [each for each in live.ring if each.kind == "predicate"]

    events = run_virtual(main)
    flickered = [each.status for each in events if each.name == "Flickers"]
    assert flickered == ["false", *["true", "false"] * 10][: len(flickered)]
    assert len(flickered) >= 20
    pulsed = [(each.status, each.count > 1) for each in events if each.name == "Pulses"]
    assert pulsed[-2:] == [("several", True), ("false", False)]


def test_a_predicate_flickers_by_the_time_for_which_it_is_held_whichever_of_several_managers_has_it():
    one, two = mdm.PredicateManager("one"), mdm.PredicateManager("two")
    one.sensor("Near", initial=False)
    near = two.sensor("Near", initial=False)
    two.define("Close", "Near", held_for=2.0)

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        await runtime.start(one)
        await runtime.start(two)
        live.frame()
        for step in range(14):
            near.set(step % 2 == 0)
            await asyncio.sleep(2.1 if step % 2 == 0 else 0.1)
            live.glance()
        return live.frame().judgements

    (judgement,) = run_virtual(main)
    assert (judgement.rule, judgement.of) == ("flickers", "two/Close")
