"""Causes of decisions, states and observations in words: a running system tells the same as its record."""

from __future__ import annotations

import asyncio
from collections import Counter

import msgspec
import pytest
from hypothesis import given, strategies as st

import mdm
from mdm import Ensemble, PredicateManager, StateFactor
from mdm.models import Factor, Space
from mdm.policies import DeterministicPolicy
from mdm.recording import Record
from mdm.snapshots import Event, LiveRun, RecordedRun
from mdm.snapshots.judgement import Ended
from mdm.snapshots.words import Wiring, at_state, cause_in_words, changes, most_frequent, observed, on_observing, wired
from mdm.testing import run_virtual

ROOMS = Space([Factor("room", ["hall", "lab", "shop"]), Factor("fire", ["no", "yes"])])
SOURCES = {"room": ("InHall", "InLab", "InShop"), "fire": ("not FireIsSeen", "FireIsSeen")}


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ((0, 0), (1, 0), "room lab (InLab)"),
        ((0, 1), (0, 0), "fire no (not FireIsSeen)"),
        ((2, 0), (0, 1), "room hall (InHall), fire yes (FireIsSeen)"),
        ((2, 1), (2, 1), ""),
    ],
)
def test_what_has_changed_of_a_state_is_told_with_the_predicate_that_it_stands_for(before, after, words):
    indices = [ROOMS.shape[1] * room + fire for room, fire in (before, after)]
    assert changes(Wiring(ROOMS, SOURCES), *indices) == words
    assert changes(Wiring(None, {}), *indices) == changes(Wiring(ROOMS, SOURCES), None, indices[1]) == ""


def test_many_changes_are_counted():
    space = Space([Factor(f"f{place}", ["no", "yes"]) for place in range(5)])
    assert changes(Wiring(space, {}), 0, 31) == "f0 yes, f1 yes, f2 yes and 2 more"


def test_a_cause_has_what_is_known_of_it():
    assert cause_in_words("observation", observed="hear-left") == "on observing hear-left"
    assert cause_in_words("again", ended=Ended("Up", 1.0, "timed_out")) == "again, for Up had ended (timed out)"
    assert cause_in_words("again", ended=Ended("Up", 1.0, "succeeded")) == "again, for Up had ended"
    assert cause_in_words("again") == "again, for its action had ended or it was asked to"
    assert cause_in_words("something new") == "something new"


def test_a_running_system_and_its_record_tell_the_same_causes(tmp_path):
    def built():
        manager = PredicateManager()
        for name in ("InHall", "InLab"):
            manager.sensor(name, initial=name == "InHall")
        fire = manager.sensor("FireIsSeen", initial=False)

        async def go():
            await asyncio.sleep(0.3)

        robot = Ensemble(
            "robot",
            policy=DeterministicPolicy([0, 1, 0, 1]),
            actions={"Go": mdm.Binding(go, then="decide", pause=0.1), "Halt": lambda: None},
            predicates=manager,
            states=[
                StateFactor("room", {"hall": "InHall", "lab": "InLab"}),
                StateFactor("fire", {"yes": "FireIsSeen"}),
            ],
        )
        ticks = Ensemble("ticks", policy=DeterministicPolicy([0]), actions={0: lambda: None}, drive=2.0)
        return manager, fire, robot, ticks

    manager, fire, robot, ticks = built()
    assert wired(robot).sources["fire"] == ("not FireIsSeen", "FireIsSeen")
    events = []

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        for actor in (manager, robot, ticks):
            await runtime.start(actor)
        ticks.publish_state(0)

        async def happen():
            await asyncio.sleep(0.95)
            with manager.batch():
                manager.sense("InHall", False)
                manager.sense("InLab", True)
            await asyncio.sleep(1.0)
            fire.set(True)
            await asyncio.sleep(1.0)
            fire.set(False)

        task = asyncio.get_running_loop().create_task(happen())
        for _ in range(400):
            live.frame({"robot"})
            await asyncio.sleep(0.01)
        await task
        events.extend(live.ring)
        return live.frame({"robot"}).details["robot"].cause

    last = run_virtual(main, record=tmp_path / "run.mcap")
    assert last.startswith("again, for Go had ended")
    run = RecordedRun(Record(tmp_path / "run.mcap"), robot, ensembles={"robot": robot, "ticks": ticks})
    recorded = [msgspec.json.decode(each, type=Event) for each in run.after(0, 10**9)[0]]
    told = [
        {(each.source, each.life, each.detail) for each in which if each.kind == "decision"}
        for which in (events, recorded)
    ]
    assert told[0] == told[1]
    words = {detail for _, _, detail in told[0]}
    assert words >= {
        "again, for Go had ended",
        "at a tick of its rate",
        "on a change of its state: room lab (InLab)",
        "on a change of its state: fire yes (FireIsSeen)",
        "on a change of its state: fire not yes (not FireIsSeen)",
    }


@given(st.lists(st.sampled_from("abcdefghijklmnop")))
def test_the_most_frequent_come_first(names):
    counts = Counter(names)
    found = most_frequent(counts)
    assert [count for _, count in found] == sorted(counts.values(), reverse=True)[:8]
    assert dict(found).items() <= counts.items()


def test_an_observation_is_named_by_its_index_or_its_components():
    space = Space([Factor("left", ["wall", "free"]), Factor("right", ["wall", "free"])])
    assert observed(space, (1, None)) == "left free, right ?"
    assert observed(space, 1) == space.names[1]
    assert observed(space, None) is None
    assert observed(None, 3) is None


def test_a_decision_is_in_a_state_or_on_an_observation():
    space = Space([Factor("person", ["yes", "no"]), Factor("fire", ["yes", "no"])])
    assert at_state(space, 1) == "in state person yes, fire no"
    assert at_state(Space.single("state", ["hall", "lab"]), 1) == "in state lab"
    assert at_state(None, 7) == "in state 7"
    assert on_observing("hear-left") == "on observing hear-left"
    assert on_observing(None) == ""
