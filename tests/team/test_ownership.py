"""Whose factors are whose, and who carries out what."""

from __future__ import annotations

from types import SimpleNamespace

from sentences import refused
from team_robots import over_beliefs, over_states

import mdm
from mdm import problems
from mdm.team.ownership import Ownership, Placement, acting
from mdm.team.team import Team


def joint(agent=0, **options):
    robot = SimpleNamespace(act=lambda name: lambda: None)
    return over_beliefs(problems.dec_tiger())(robot, agent, **options)


def states(agent=0):
    return over_states(SimpleNamespace(act=lambda name: lambda: None), agent)


def tigers():
    return Team("tigers", ["left", "right"])


def test_observations_belong_to_the_agents_in_their_order_where_names_say_nothing():
    ownership = Ownership(tigers(), joint())
    assert ownership.names == ("agent0", "agent1")
    assert ownership.owners == ("left", "right")
    assert ownership.of == {"left": (0,), "right": (1,)}
    assert ownership.named("right") == ("agent1",)
    assert ownership.index((1, 0)) == 2
    assert ownership.index((1, None)) is None


def test_a_name_or_an_owner_says_whose_a_factor_is():
    assert Ownership(Team("t", ["agent1", "agent0"]), joint()).owners == ("agent0", "agent1")
    assert Ownership(Team("rooms", ["a", "b"]), states()).owners == ("a", "b")
    assert Ownership(Team("rooms", ["a", "b"]), states(1)).names == ("room_a", "room_b")


def test_a_placement_gives_factors_to_an_agent_that_nobody_else_owns():
    ownership = Ownership(tigers(), joint(), Placement(inputs="right"))
    assert ownership.owners == ("right", "right")


def test_factors_of_nobody_are_refused():
    with refused(mdm.ConfigError):
        Ownership(Team("t", ["a", "b", "c"]), joint())
    with refused(mdm.ConfigError):
        Ownership(tigers(), states())
    with refused(mdm.ConfigError):
        Ownership(tigers(), mdm.Ensemble("e", policy=[0, 1], actions={0: print, 1: print}))


def test_facts_tell_what_must_be_the_same():
    facts = Ownership(Team("rooms", ["a", "b"]), states()).facts()
    assert facts["state factor 'room_a'"] == "2 values, of a, idle None, held"


def test_components_are_carried_out_by_name_or_in_order():
    assert acting(tigers(), joint()) == ("left", "right")
    assert acting(Team("t", ["agent1", "agent0"]), joint()) == ("agent0", "agent1")
    assert acting(tigers(), joint(), Placement(actions={"agent0": "right", "agent1": "left"})) == ("right", "left")
    with refused(mdm.ConfigError):
        acting(Team("t", ["a", "b", "c"]), joint())
    with refused(mdm.ConfigError):
        acting(tigers(), joint(), Placement(actions="left"))


def test_agents_that_the_model_and_the_team_have_only_in_part_in_common_are_refused():
    with refused(mdm.ConfigError):
        acting(Team("tigers", ["left", "agent1"]), joint())
    placement = Placement(actions={"agent0": "left", "agent1": "agent1"})
    assert acting(Team("tigers", ["left", "agent1"]), joint(), placement) == ("left", "agent1")
