"""Circles of plain actions that a file shows by itself."""

from __future__ import annotations

from itertools import product

import pytest

import mdm
from mdm.actors.safety.notes import circles


async def takes_time():
    """Take time."""


def ensemble(policy, *, back=lambda: None, held=False, **options):
    """Return an ensemble that goes back and forth while it has power, by latches on the ends of its actions."""
    predicates = mdm.PredicateManager("predicates")
    predicates.sensor("Power")
    predicates.sensor("Far")
    predicates.latch("At", set="Go.succeeded", reset="Back.succeeded")
    predicates.define("There", "At" if not held else "At and Far")
    actions = {"Go": lambda: None, "Back": back, "Rest": lambda: None}
    return mdm.Ensemble(
        "robot",
        policy=policy,
        predicates=predicates,
        states=[mdm.StateFactor("power", ["Power"]), mdm.StateFactor("there", ["There"])],
        actions=dict(list(actions.items())[: max(policy) + 1]),
        **options,
    )


def endless(policy, start, power):
    """Whether the actions of a policy lead to each other without end, by a walk over states of its own."""
    at, seen = start, set()
    while (at,) not in seen:
        seen.add((at,))
        action = policy[2 * power + at]
        new = {0: 1, 1: 0}.get(action, at)
        if new == at:
            return False
        at = new
    return True


@pytest.mark.parametrize("policy", list(product(range(3), repeat=4)))
def test_a_circle_is_found_where_plain_actions_lead_to_each_other(policy):
    expected = any(endless(policy, 0, power) for power in (0, 1))
    (*found,) = circles(ensemble(list(policy)))
    assert bool(found) == expected
    for note in found:
        assert "ensemble 'robot': Go and Back are plain functions" in note
        assert "in place of Back.succeeded, Go.succeeded" in note


@pytest.mark.parametrize(
    ("options", "found"), [({"back": takes_time}, 0), ({"drive": 10.0}, 0), ({"held": True}, 1), ({}, 1)]
)
def test_there_is_none_where_an_action_takes_time_or_decisions_come_at_ticks(options, found):
    assert len(list(circles(ensemble([2, 2, 0, 1], **options)))) == found


def test_the_notes_of_an_ensemble_have_its_circle():
    assert any("one turn without end" in note for note in ensemble([0, 1, 0, 1]).notes())
