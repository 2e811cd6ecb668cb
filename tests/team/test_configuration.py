"""What must be the same at every agent of a team, and how a difference is told."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from team_robots import Robot, decider, over_beliefs

from mdm import problems
from mdm.policies import AlphaVectors
from mdm.team.configuration import ANY, Configuration, difference
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.testing import run_virtual

MODEL = problems.dec_tiger()
SIZES = "AlphaVectors of 2 states, 9 actions"
POLICY = decider(MODEL)
SHORT = AlphaVectors(POLICY.vectors[:2], POLICY.actions[:2], 9)
OTHER = AlphaVectors(POLICY.vectors + 1.0, POLICY.actions, 9)
TURNED = AlphaVectors(np.asarray(POLICY.vectors)[:, ::-1], POLICY.actions, 9)


def tigers(**options):
    return Team("tigers", ["left", "right"], **options)


def test_the_first_difference_is_told_in_words():
    here = {"horizon": "2", "safe_action": ANY, "hash": "1"}
    assert difference(here, "a", dict(here), "b") is None
    assert difference(here, "a", here | {"safe_action": "'listen'"}, "b") is None
    assert difference(here, "a", here | {"hash": "2", "horizon": "3"}, "b") == "horizon is 2 at a and 3 at b"
    assert difference(here, "a", here | {"more": "1"}, "b") == "more is None at a and 1 at b"


def pair():
    """Two agents whose team is the same, and whose ensemble has other horizons."""
    a, b = Configuration("a", {"drive": "events"}), Configuration("b", {"drive": "events"})
    a.add("joint", {"horizon": "2"})
    b.add("joint", {"horizon": "3"})
    return a, b


def test_only_what_both_have_is_compared():
    a, b = pair()
    assert a.difference("b", b.facts).startswith("configuration of ensemble 'joint' is ")
    assert a.ensemble(b.facts) == "joint"
    assert a.explain("b", "joint", {"horizon": "3"}) == "horizon is 2 at a and 3 at b"
    assert a.difference("b", {"drive": "events"}) is None
    assert a.token("joint") != b.token("joint")
    assert a.difference("b", {"drive": "a period of 1 s"}) == "drive is events at a and a period of 1 s at b"


STANDINGS = [((False, 1), (False, 1)), ((True, 1), (False, 3)), ((False, 1), (False, 2)), ((True, 2), (True, 2))]


@pytest.mark.parametrize(("first", "second"), STANDINGS)
def test_of_two_that_differ_exactly_one_is_refused(first, second):
    a, b = pair()
    assert a.part("b", 7, "told", first, second, 0)
    assert not a.part("b", 7, "told", first, second, 1)
    assert b.part("a", 3, "told", second, first, 0)
    assert a.refuses("b") == (second > first)
    assert b.refuses("a") != a.refuses("b")
    assert (a.refusal is None) == (first >= second)


def test_an_agent_is_refused_until_the_other_agrees_or_is_silent():
    _, b = pair()
    for way in ("agrees", "is silent", "returns"):
        b.part("a", 3, "told", (False, 1), (True, 1), 0)
        assert (b.refusal, b.differing) == ("told", {"a": 3})
        if way == "agrees":
            assert b.agree("a")
            assert not b.agree("a")
        elif way == "is silent":
            assert not b.expire(0)
            assert b.expire(1)
        else:
            assert b.part("a", 4, "told", (True, 1), (False, 1), 2)
            assert b.differing == {"a": 4}
        assert (b.refusal, b.last_refusal) == (None, "told")


@pytest.mark.parametrize(
    ("team", "options", "policy", "told"),
    [
        ({"deadline": 0.2}, {}, None, "team's deadline is 0.1 s at {} and 0.2 s at {}"),
        ({"lease": 2.0}, {}, None, "team's lease is 1 s at {} and 2 s at {}"),
        ({"quorum": "majority"}, {}, None, "team's quorum is continue at {} and majority at {}"),
        ({}, {"safe_action": "open-left"}, None, "safe_action is 'listen' at {} and 'open-left' at {}"),
        ({}, {"on_lost_teammate": "hold"}, None, "on_lost_teammate is continue at {} and hold at {}"),
        ({}, {}, SHORT, f"policy is {SIZES}, 9 vectors at {{}} and {SIZES}, 2 vectors at {{}}"),
        ({}, {}, OTHER, "policy's value of the initial belief is 16 at {} and 17 at {}"),
        ({}, {}, TURNED, "hash of the policy is "),
        ({}, {"initial_belief": [0.25, 0.75]}, None, "policy's value of the initial belief is "),
    ],
)
@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_an_agent_that_differs_is_refused_with_the_first_difference(mode, team, options, policy, told):
    if mode == "centralised" and ("quorum" in team or "deadline" in team):
        team = {"max_age": 3.0}
        told = "team's max_age is 1 s at {} and 3 s at {}"

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        build = over_beliefs(MODEL, POLICY)
        left = await Robot(tigers(mode=mode), "left", network, build, safe_action="listen").start_alone(runtime)
        await asyncio.sleep(1.0)
        other = Robot(
            tigers(mode=mode, **team),
            "right",
            network,
            over_beliefs(MODEL, policy or POLICY),
            **({"safe_action": "listen"} | options),
        )
        await other.start(runtime)
        await asyncio.sleep(1.0)
        left.observe("hear-left", None)
        await asyncio.sleep(2.0)
        assert other.role == "refused"
        assert other.commits == []
        assert other.did in ([], ["listen"], ["open-left"])
        assert other.kinds() == ["refused"]
        detail = other.faults[0].detail
        assert detail.startswith("right cannot take part in the team: ")
        reason = detail.removeprefix("right cannot take part in the team: ")
        assert any(reason_.startswith(told.format("left", "right")) for reason_ in (reason, _turned(reason)))
        assert left.commits[-1].missing == ("right",)
        assert [fault.detail for fault in left.faults] == [detail]

    run_virtual(main)


def _turned(reason):
    """A difference as the other of the two agents tells it."""
    fact, values = reason.split(" is ", 1)
    one, other = values.removesuffix(" at left").split(" at right and ")
    return f"{fact} is {other} at left and {one} at right"
