"""The player: it answers what the record says, and compares what is decided with it."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from records import decision

from mdm.replay.player import AsRecordedError, Player, StandIn
from mdm.stimuli import Began, GoesOn, Kept, Lasts, Late, Raised, Said, Ticked


def player(*stimuli, decisions=(), most=10):
    made = [(each, each.time + 1, place) for place, each in enumerate(decisions)]
    return Player(stimuli, made, tolerance=0.0, most=most, now=lambda: 7)


class Layer:
    """An action layer whose functions are stand-ins."""

    started = 0

    def substitute(self, call):
        self.call = call


class Output:
    """Where an ensemble decides."""

    ensemble = "patrol"

    def name_of(self, action):
        return "Go"

    def belief_of(self, current):
        return np.array(current)

    def wanted(self, cause, current):
        return None, None


def decide(played, number, **fields):
    """Decide what `records.decision` does."""
    told = decision(number)
    given = {
        name: getattr(told, name) for name in ("time", "epoch", "cause", "state", "observation", "action")
    } | fields
    current, reward = given.pop("current", None), 0.5
    played.on_step(
        *(Output(), given["time"], given["epoch"], given["cause"], given["state"], given["observation"], current),
        *(given["action"], reward),
    )


def test_questions_are_answered_as_they_were():
    played = player(
        GoesOn(5, "patrol", 3, True),
        Late(6, "patrol", 4, 700),
        Kept(0, "predicates", {"Near": True}, {"Near": -5}),
    )
    assert played.goes_on("patrol", 3, 5, lambda: pytest.fail("it is asked"))
    assert not played.goes_on("patrol", 3, 6, lambda: pytest.fail("it is asked"))
    assert played.latency("patrol", 4, 6, 3) == 700
    assert played.latency("patrol", 5, 6, 800) == 0
    assert played.kept("predicates", {"Near": False}, {}, 0) == ({"Near": True}, {"Near": -5})
    assert played.kept("predicates", {"Near": False}, {}, 9) == ({}, {})


def test_calls_say_raise_and_last_as_they_did():
    said = Said(1, "sensed", "SensorUpdate", None, "call", "patrol", 1)
    played = player(
        said,
        Lasts(1, "patrol", 1),
        Raised(2, "patrol", 2, "ValueError: as it was"),
        Raised(3, "patrol", 3, "a generator", unrun=True),
    )
    found = []
    played.say = found.append
    layer = Layer()
    played.acts("patrol", layer)
    layer.started = 1
    assert isinstance(layer.call(None), StandIn)
    assert found == [said]
    layer.started = 2
    with pytest.raises(AsRecordedError, match="ValueError: as it was"):
        layer.call(None)
    layer.started = 3
    assert list(layer.call(None)) == []
    layer.started = 4
    assert layer.call(None) is None
    assert found == [said]


def test_the_same_decisions_are_no_difference():
    played = player(decisions=[decision(0), decision(1)])
    for number in range(2):
        decide(played, number)
    played.missed(10_000_000)
    assert (played.differences, played.count, len(played.made)) == ([], 2, 2)


def test_it_is_known_by_when_a_difference_was_there():
    played = player(decisions=[decision(0), decision(1), decision(2)])
    decide(played, 0)
    decide(played, 1, action=0)
    played.missed(10_000_000)
    assert (played.made, played.paired) == ([7, 7], [7, 7])
    assert played.found == [7, decision(2).time + 1]
    assert played.missed_by == [decision(2).time + 1]


def test_one_that_is_never_made_comes_before_those_that_differ_later():
    stimuli = [Began(number, "robot", "start") for number in range(4)]
    played = player(decisions=[decision(0), decision(1), decision(2, ensemble="other")], most=1)
    played.since.append(stimuli[0])
    played.comes_to(0)
    played.since.append(stimuli[1])
    decide(played, 0)  # late, and no difference
    played.comes_to(1)
    played.comes_to(2)
    played.since.append(stimuli[2])
    other = Output()
    other.ensemble = "other"
    played.on_step(other, 2_000_000, 2, "state", 2, None, None, 0, 0.5)
    assert [each.number for each in played.differences] == [2]
    played.missed(10_000_000, overdue=True)
    (first,) = played.differences
    assert (first.number, first.replayed, first.since) == (1, None, (stimuli[0], stimuli[1]))


def test_differences_tell_the_number_and_what_came_before():
    played = player(decisions=[decision(0), decision(1), decision(2)])
    played.since.append(Ticked(0, "patrol/control", 0, 0, 10.0))
    decide(played, 0)
    decide(played, 1, action=2)
    played.missed(10_000_000)
    wrong, missing = played.differences
    assert (wrong.number, wrong.fields, wrong.since) == (1, ("action",), (Ticked(0, "patrol/control", 0, 0, 10.0),))
    assert (missing.number, missing.recorded, missing.replayed) == (2, decision(2), None)


def test_a_decision_more_has_the_number_of_the_next():
    played = player(decisions=[decision(0)])
    decide(played, 0)
    decide(played, 1)
    (more,) = played.differences
    assert (more.number, more.recorded, more.replayed.time) == (1, None, 1_000_000)


def test_decisions_behind_the_end_are_not_missed():
    played = player(decisions=[decision(0), decision(5)])
    decide(played, 0)
    played.missed(4_999_999)
    decide(played, 6)  # of the end of the replay itself
    assert played.differences == []


def test_so_many_differences_are_kept():
    played = player(decisions=[decision(number) for number in range(5)], most=2)
    for number in range(5):
        decide(played, number, action=0)
    assert [difference.number for difference in played.differences] == [0, 1]


def test_actors_come_to_their_steps_when_the_record_does():
    async def main():
        played = player(Began(3, "robot", "start"))
        coming = asyncio.ensure_future(played.comes("robot", "start"))
        await asyncio.sleep(0)
        assert not coming.done()
        admitting = asyncio.ensure_future(played.admit(Began(3, "robot", "start"), 1.0))
        await coming
        played.on_stimulus(Began(3, "robot", "start"))
        assert await admitting
        await played.comes("robot", "start")  # once more than it did: nobody holds it
        assert not await played.admit(Began(3, "robot", "run"), 0.001)  # and for what never comes nobody waits for ever

    asyncio.run(main())


def test_at_the_end_nobody_is_held():
    async def main():
        played = player(Began(3, "robot", "start"), Began(4, "robot", "run"))
        coming = asyncio.ensure_future(played.comes("robot", "start"))
        await asyncio.sleep(0)
        played.release()
        await coming
        await played.comes("robot", "run")

    asyncio.run(main())
